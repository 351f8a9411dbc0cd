"""The report of a comparison of agents: tables in the terminal, page, figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.arms import vera
from loose_env.envs import DiagnosisSettings
from loose_env.report import (
    EpisodeTimeline,
    comparison_text,
    episode_timeline,
    write_comparison,
)
from loose_env.report.comparison import confusion_counts, confusion_matrix, ordered_hypotheses
from tests.report.page_checks import checked
from tests.report.test_evaluation import rows_of


def played(agent: str, right: int, records: int = 3) -> list[dict[str, Any]]:
    """Twenty rows of an agent; one that is wrong on the last arm gives no verdict there."""
    *rows, last = rows_of(agent, right=right, episodes=20, records=records)
    if not last["success"]:
        last |= {"verdict": None, "truncated": True}
    return [*rows, last]


PLAYS = ("backlash@joint1", "backlash@joint2")
ROWS = [*played("first <one>", 18), *played("second & two", 9, records=5)]
WHOLE = [
    *played("net/greedy#1", 18),
    *played("net/greedy#2", 17),
    *played("net/random", 12),
    *played("thesis", 6),
]


class Guesser:
    """Shakes joint 2 twice, then names the last hypothesis."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        taken = 0 if state is None or episode_start[0] else state
        return np.array([[2, 2, 0, 2, 0, 5 if taken == 2 else 0]]), taken + 1


@pytest.fixture(scope="module")
def timeline() -> EpisodeTimeline:
    return episode_timeline(Guesser(), vera(), DiagnosisSettings(), seed=0)


def test_the_page_holds_every_agent_figure_and_step(
    tmp_path: Path, timeline: EpisodeTimeline
) -> None:
    path = tmp_path / "new" / "comparison.html"
    written = write_comparison(
        path,
        ROWS,
        title="Who finds it? <b>",
        played="Two agents, twenty arms.",
        chance=1 / 3,
        timeline=timeline,
        timeline_agent="first <one>",
        notes="Made by: make run",
    )
    assert written == path and [p.name for p in path.parent.iterdir()] == ["comparison.html"]
    page = path.read_text(encoding="utf-8")
    assert "Who finds it? &lt;b&gt;" in page and "<one>" not in page
    assert page.count("first &lt;one&gt;") >= 3 and page.count("second &amp; two") >= 3
    for word in ("Two agents, twenty arms.", "Made by: make run", timeline.words, "90 %", "45 %"):
        assert word in page
    # Bars, costs, three strata, reliability, a matrix for each agent, and the timeline.
    assert page.count("<svg") == 8 + len(timeline.cards)
    parsed = checked(page)
    assert parsed.headings == [
        "Accuracy",
        "Accuracy by stratum",
        "Calibration",
        "Confusion matrices",
        "One episode, step by step",
    ]


def test_terminal_and_page_hold_the_same_tables(tmp_path: Path) -> None:
    given: dict[str, Any] = {
        "forced": [{**row, "records": 3} for row in played("net/random", 12)],
        "reference": "net/random",
        "said": ["At least 1.2 records are needed."],
    }
    file = write_comparison(
        tmp_path / "page.html", WHOLE, title="All of it", played="Words.",
        rng=np.random.default_rng(0), **given,
    )  # fmt: skip
    page = file.read_text(encoding="utf-8")
    text = comparison_text(WHOLE, rng=np.random.default_rng(0), **given)
    assert text == comparison_text(WHOLE, rng=np.random.default_rng(0), **given)
    assert max(map(len, text.splitlines())) <= 120
    checked(page)
    for words in (
        "reference",
        "At least 1.2 records are needed.",
        "Policies (lines) and estimators (columns)",
        "By seat drive over friction",
        "By what was hidden",
        "By difficulty",
        "after so many records, without stopping",
        "Interquartile mean over trainings",
        "expected calibration error",
    ):
        assert words in text.replace("\n", " ") and words in page, words
    assert "Most frequent mistakes of net/greedy#1" in text
    numbers = {cell for line in text.splitlines() for cell in line.split() if "(" not in cell}
    for cell in numbers:
        if cell.replace(".", "").isdigit() and "." in cell:
            assert cell in page, cell


def test_the_confusion_matrix_counts_every_arm() -> None:
    rows = [{**row, "verdict": "unsure"} if k < 5 else row for k, row in enumerate(ROWS)]
    rows.append({**ROWS[0], "truth": "several_faults", "verdict": "healthy"})
    names = ordered_hypotheses(rows)
    assert names == ("healthy", "structural_looseness@link1", *PLAYS, "several_faults")
    counts = confusion_counts(rows, names)
    assert counts.sum() == len(rows)
    assert np.trace(counts) == sum(row["truth"] == row["verdict"] for row in rows)
    assert counts[:, -2].sum() == 5  # unsure
    assert counts[:, -1].sum() == 2  # without a verdict
    assert counts[-1].tolist() == [1] + [0] * (len(names) + 1)
    axes = confusion_matrix(rows, names, "#0173b2").axes[0]
    shown = [t.get_text() for t in (*axes.get_xticklabels(), *axes.get_yticklabels())]
    assert shown.count("several") == shown.count("link 1") == shown.count("joint 2") == 2
    assert {"healthy", "unsure", "none"} <= set(shown)
    assert sum(int(t.get_text() or 0) for t in axes.texts) == len(rows)


def test_the_timeline_shows_each_record_and_the_end(timeline: EpisodeTimeline) -> None:
    captions = [card.caption for card in timeline.cards]
    assert captions == ["The first pose", "Record 1", "Record 2", "Verdict and truth"]
    assert timeline.words.startswith("After 2 records the verdict was: joint 2 has play.")
    drawn = [card.image.decode("utf-8") for card in timeline.cards if isinstance(card.image, bytes)]
    assert "Verdict: joint 2 has play" in drawn[-1]
    assert not any("Verdict" in each for each in drawn[:-1])
