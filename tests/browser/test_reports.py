"""Reports in a browser: at a desk, on a phone, in the dark, on paper."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

import loose_env
from loose_env.arms import SIX_AXIS_SERVO_ARM, vera
from loose_env.envs import DiagnosisSettings
from loose_env.instrument import PlanSettings, plan, trend
from loose_env.io import write_text
from loose_env.report import (
    FigureCard,
    episode_timeline,
    new_figure,
    render_gap_page,
    write_comparison,
    write_plan_page,
    write_trend_page,
)
from scripts.example_recording import loose_arm
from tests.browser.chromium import WIDTHS, Page, browser, fits_on_paper, is_in_order, pictures
from tests.gap.cases.gap_case import record, solution_for
from tests.report.test_comparison import ROWS, Guesser
from tests.scripts.test_reproduce_thesis import FAILED, outcome, render

__all__ = ["browser"]


pytestmark = pytest.mark.slow


def gap_page(suffix: str = "") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        solution = solution_for(record(folder / "arm", suffix=suffix))
        return write_text(folder / "gap.html", render_gap_page(solution))

    return write


def comparison_page(folder: Path) -> Path:
    return write_comparison(
        folder / "comparison.html",
        ROWS,
        title="Who finds it?",
        played="Two agents, twenty arms.",
        chance=1 / 3,
        timeline=episode_timeline(Guesser(), vera(), DiagnosisSettings(), seed=0),
        timeline_agent="first <one>",
        notes="Made by: make run",
    )


def thesis_page(folder: Path) -> Path:
    figure = new_figure(3.0)
    figure.subplots().plot([1.0, 2.0, 1.5])
    bars = FigureCard(image=figure, caption="Bars", title="A name")
    section = outcome("first", cards=[bars])
    return write_text(folder / "thesis.html", render(section, outcome("second", cards=[]), FAILED))


def session_of(folder: Path) -> Path:
    return loose_arm(folder / "recording", reference=True).folder


def diagnosis_page(folder: Path) -> Path:
    return loose_env.diagnose(session_of(folder)).write(folder / "found")[0]


def trend_page(folder: Path) -> Path:
    sessions = [loose_arm(folder / f"{month}" / "recording", loose=month > 1) for month in range(3)]
    found = trend(sessions, ["May", "June", "July"])
    return write_trend_page(folder / "trend.html", found)


def plan_page(folder: Path) -> Path:
    made, _ = plan(SIX_AXIS_SERVO_ARM, PlanSettings(controller="ros2_jtc", reference=True))
    # Paths as long as people have them: no command may push the page out of a phone's window.
    long = "measurements/2026-03-18 cell 4 after the collision/session one of three"
    paths = {"folder": Path(long), "model": Path(f"{long}/the arm of cell 4.xml")}
    return write_plan_page(folder / "plan.html", made, **paths)


REPORTS: dict[str, tuple[Callable[[Path], Path], int]] = {
    "gap": (gap_page(), 3),
    "gap: long names": (gap_page("_of_the_left_arm_beside_the_conveyor"), 3),
    "trend": (trend_page, 1),
    "comparison": (comparison_page, 6),
    "thesis": (thesis_page, 1),
    "plan": (plan_page, 0),
    "diagnosis": (diagnosis_page, 2),
}
"""Report -> how it is written, and how many pictures it has at least."""
SCROLLING = """
[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1).length
"""
"""How many boxes hold more than they show."""


@pytest.fixture(scope="module", params=list(REPORTS))
def report(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, int]:
    write, least = REPORTS[request.param]
    return write(tmp_path_factory.mktemp("report")), least


def test_it_loads_quietly_and_fits_its_window(browser: Page, report: tuple[Path, int]) -> None:
    file, least = report
    for width in WIDTHS:
        is_in_order(browser, file, width=width)
        assert len(pictures(browser)) >= least
        # Nobody scrolls sideways, not even within a table, but for the thesis's.
        if 'class="held"' not in file.read_text("utf-8"):
            assert not browser.value(SCROLLING)


def test_it_can_be_read_in_the_dark(browser: Page, report: tuple[Path, int]) -> None:
    is_in_order(browser, report[0], width=390, dark=True)
    paper, ink = (
        browser.value(f"getComputedStyle(document.body).{name}")
        for name in ("backgroundColor", "color")
    )
    bright = [sum(map(int, each[4:-1].split(","))) for each in (paper, ink)]
    assert bright[0] < 150 and bright[1] > 600


def test_it_can_be_printed(browser: Page, report: tuple[Path, int], tmp_path: Path) -> None:
    fits_on_paper(browser, report[0])
    browser.paper(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
