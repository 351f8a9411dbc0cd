"""Reports in a browser: at a desk, on a phone, in the dark, on paper."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.arms import vera
from loose_env.envs import DiagnosisSettings
from loose_env.instrument import (
    Maintenance,
    NextSettings,
    PlanFiles,
    PlanSettings,
    Trend,
    change_since,
    plan,
)
from loose_env.io import write_text
from loose_env.report import (
    FigureCard,
    episode_timeline,
    new_figure,
    render_gap_page,
    write_comparison,
    write_page,
    write_plan_page,
    write_trend_page,
)
from tests.browser.chromium import WIDTHS, Page, browser, fits_on_paper, is_in_order, pictures
from tests.gap.cases.gap_case import record, solution_for
from tests.instrument.arms import SERVOED, named, session, written
from tests.report.diagnosis_case import CASES, LONG
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


def diagnosis_page(case: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        arm, found = CASES[case]()
        return write_page(folder / "report.html", found, arm, recording="cell-4")

    return write


def trend_page(folder: Path) -> Path:
    factor = {"elbow": 1.3}
    many = [*named(8), *((f"session {k}", session(k, factor=factor)) for k in range(8, 12))]
    work = [Maintenance(date="2025-01-05", joint="base", work="belt tightened")]
    found = change_since(session(12, factor=factor), many, maintenance=work)
    text = found.to_json()
    for name in ("base", "shoulder", "elbow"):
        text = text.replace(f'"{name}"', f'"{LONG.format(name)}"')
    return write_trend_page(folder / "trend.html", Trend.from_json(text), recording="cell-4")


def plan_page(in_turn: int) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        model = written(folder, SERVOED)
        settings = NextSettings(poses=2, seconds=1.0, most_tool=2.5, in_turn=in_turn)
        own = PlanSettings(pose_deg=(20.0, -60.0, 70.0), reference=True)
        made = plan(model, choice=settings, own=own)
        files = PlanFiles(folder / "session", made.arm.recording_model.xml)
        planned = files.runs_of(made)
        # Paths as long as people have them: no command may push the page out of a phone's window.
        long = "measurements/2026-03-18 cell 4 after the collision/session one of three"
        paths = {"folder": long, "model": f"{long}/the arm of cell 4.xml"}
        return write_plan_page(folder / "plan.html", made, planned, **paths)

    return write


REPORTS: dict[str, tuple[Callable[[Path], Path], int]] = {
    "gap": (gap_page(), 3),
    "gap: long names": (gap_page("_of_the_left_arm_beside_the_conveyor"), 3),
    "trend": (trend_page, 2),
    "comparison": (comparison_page, 6),
    "thesis": (thesis_page, 1),
    "plan: one joint": (plan_page(1), 2),
    "plan: two joints": (plan_page(2), 3),
    **{f"diagnosis: {case}": (diagnosis_page(case), 4) for case in CASES},
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
