"""Reports: comparison of agents, diagnosis, trend, plan, model error.

Data flow: page, figures, words -> comparison, diagnosis, trend, plan, gap -> rerun.
"""

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report.comparison import (
    EpisodeTimeline,
    comparison_text,
    episode_timeline,
    write_comparison,
)
from loose_env.report.diagnosis import (
    diagnosis_headline,
    diagnosis_html,
    diagnosis_text,
    write_diagnosis,
)
from loose_env.report.figures import AGENTS, WIDTH, new_figure, quiet_axes
from loose_env.report.gap import (
    check_text,
    gap_headline,
    gap_html,
    gap_text,
    render_gap_page,
    write_gap_report,
)
from loose_env.report.page import (
    DARK,
    FONT,
    LIGHT,
    PAPER,
    THEMED,
    FigureCard,
    Section,
    Table,
    paragraphs,
    render_page,
    shown,
    standalone,
    template,
    to_svg,
)
from loose_env.report.plan import plan_commands, summary, write_plan_page
from loose_env.report.rerun import require_rerun, write_rerun
from loose_env.report.trend import trend_text, write_trend_page

__all__ = [
    "AGENTS",
    "DARK",
    "FAINT",
    "FONT",
    "INK",
    "LIGHT",
    "MUTED",
    "PAPER",
    "THEMED",
    "WIDTH",
    "EpisodeTimeline",
    "FigureCard",
    "Section",
    "Table",
    "check_text",
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
    "plan_commands",
    "quiet_axes",
    "render_gap_page",
    "render_page",
    "require_rerun",
    "shown",
    "standalone",
    "summary",
    "template",
    "to_svg",
    "trend_text",
    "write_comparison",
    "write_diagnosis",
    "write_gap_report",
    "write_plan_page",
    "write_rerun",
    "write_trend_page",
]
