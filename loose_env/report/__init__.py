"""Reports and figures.

Data flow: pages -> comparison -> diagnosis -> plan -> gap -> studies.
"""

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report.comparison.episode_timeline import episode_timeline
from loose_env.report.comparison.report import write_comparison
from loose_env.report.comparison.text import comparison_text
from loose_env.report.diagnosis.notebook import diagnosis_html, diagnosis_text
from loose_env.report.diagnosis.page import write_page
from loose_env.report.diagnosis.text import headline as diagnosis_headline
from loose_env.report.diagnosis.trend_page import trend_headline, write_trend_page
from loose_env.report.diagnosis.write import write_diagnosis
from loose_env.report.gap.notebook import gap_html, gap_text
from loose_env.report.gap.quick import quick_text
from loose_env.report.gap.rerun_file import require_rerun, write_rerun
from loose_env.report.gap.text import headline as gap_headline
from loose_env.report.gap.write import write_gap_report
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.figures import WIDTH, new_figure, quiet_axes
from loose_env.report.pages.palette import AGENTS
from loose_env.report.pages.style import DARK, FONT, LIGHT
from loose_env.report.pages.svg import standalone, to_svg
from loose_env.report.pages.template import paragraphs, shown, template, write_whole
from loose_env.report.plan.plan_page import write_plan_page
from loose_env.report.plan.plan_text import summary
from loose_env.report.plan.tool_plan_page import tool_summary, write_tool_page
from loose_env.report.studies import (
    pyplot,
    read_study,
    rounded,
    save_figure,
    stored_rows,
    study_head,
    write_study,
)

__all__ = [
    "AGENTS",
    "DARK",
    "FAINT",
    "FONT",
    "INK",
    "LIGHT",
    "MUTED",
    "WIDTH",
    "FigureCard",
    "comparison_text",
    "diagnosis_headline",
    "diagnosis_html",
    "diagnosis_text",
    "episode_timeline",
    "gap_headline",
    "gap_html",
    "gap_text",
    "new_figure",
    "paragraphs",
    "pyplot",
    "quick_text",
    "quiet_axes",
    "read_study",
    "require_rerun",
    "rounded",
    "save_figure",
    "shown",
    "standalone",
    "stored_rows",
    "study_head",
    "summary",
    "template",
    "to_svg",
    "tool_summary",
    "trend_headline",
    "write_comparison",
    "write_diagnosis",
    "write_gap_report",
    "write_page",
    "write_plan_page",
    "write_rerun",
    "write_study",
    "write_tool_page",
    "write_trend_page",
    "write_whole",
]
