from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.arms import vera
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidData
from loose_env.evaluation import standings, who_won
from loose_env.faults import hypotheses
from loose_env.report.comparison.confusion_matrix import (
    confusion_counts,
    confusion_matrix,
    ordered_hypotheses,
)
from loose_env.report.comparison.episode_timeline import EpisodeTimeline, episode_timeline
from loose_env.report.comparison.page import render_page
from loose_env.report.comparison.report import write_comparison
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.figures import success_against_records, success_bars
from loose_env.report.pages.palette import AGENTS, agent_colours
from loose_env.report.pages.svg import THEMED, inline, to_svg
from loose_env.report.pages.table import PageTable
from loose_env.report.pages.template import write_whole

PNG = b"\x89PNG\r\n\x1a\nrest"
SVG = b'<svg width="5" height="4"><defs><g id="a"/></defs><use href="#a"/></svg>'


def rows_of(agent: str, rights: int, of: int = 20, records: int = 3) -> list[dict[str, Any]]:
    """Rows of an agent that is right on its first ``rights`` arms."""
    names = hypotheses(vera())
    rows = []
    for k in range(of):
        truth, right = names[k % len(names)], k < rights
        rows.append(
            {
                "agent": agent,
                "seed": k,
                "truth": truth,
                "verdict": truth if right else (None if k == of - 1 else "healthy"),
                "success": right,
                "link_success": right,
                "poses": 2,
                "records": records + k % 2,
                "seconds": 1.2 * records,
                "reward": (1.0 if right else -1.0) - 0.1 * records,
                "truncated": k == of - 1 and not right,
            }
        )
    return rows


ROWS = [*rows_of("first <one>", 18), *rows_of("second & two", 9, records=5)]


class Guesser:
    """Shakes joint 2 twice, then names the last hypothesis."""

    def __init__(self, verdict: int = 5) -> None:
        self.verdict = verdict

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        taken = 0 if state is None or episode_start[0] else state
        action = np.array([[2, 2, 0, 2, 0, self.verdict if taken == 2 else 0]])
        return action, taken + 1


@pytest.fixture(scope="module")
def timeline() -> EpisodeTimeline:
    return episode_timeline(Guesser(), vera(), DiagnosisSettings(), seed=0)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, timeline: EpisodeTimeline) -> str:
    path = tmp_path_factory.mktemp("page") / "new" / "comparison.html"
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
    assert written == path
    assert [p.name for p in path.parent.iterdir()] == ["comparison.html"]
    return path.read_text(encoding="utf-8")


def simple(**changes: Any) -> dict[str, Any]:
    return {"title": "T", "table": [{"Agent": "a"}], "figures": [], "text": "words"} | changes


def test_the_page_loads_nothing_from_elsewhere(page: str) -> None:
    assert not re.search(r"""(?:src|href)\s*=\s*["']?\s*(?:https?:)?//""", page)
    assert not re.search(r"url\(\s*[\"']?(?!#)", page)
    assert "@import" not in page
    assert "<script" not in page
    assert "<link" not in page


def test_the_page_holds_every_agent_figure_and_step(page: str, timeline: EpisodeTimeline) -> None:
    assert page.count("first &lt;one&gt;") >= 3
    assert page.count("second &amp; two") >= 3
    # Bars, costs, curves, kinds of fault, a matrix for each agent, and the timeline.
    assert page.count("<svg") == 6 + len(timeline.cards)
    assert page.count("<figure") == page.count("</figure>") == page.count("<svg")
    for word in ("Two agents, twenty arms.", "Made by: make run", timeline.words, "90 %", "45 %"):
        assert word in page


def test_the_page_of_a_whole_comparison_holds_every_section(tmp_path: Path) -> None:
    rows: list[dict[str, Any]] = []
    for agent, rights in (("net/greedy#1", 18), ("net/greedy#2", 17), ("net/random", 12)):
        rows += rows_of(agent, rights)
    for k, row in enumerate(rows):
        row["difficulty"] = "hard" if row["seed"] % 2 else "easy"
        row["friction_ratio"] = None if row["truth"] == "healthy" else 0.3 * (1 + k % 40)
        row["trail_best"] = [row["verdict"]] * row["records"]
        row["trail_confidence"] = row["trail_truth"] = [0.8] * row["records"]
    forced = [{**row, "records": 3} for row in rows if row["agent"] == "net/random"]
    path = write_comparison(
        tmp_path / "page.html",
        rows,
        title="All of it",
        played="Words.",
        forced=forced,
        reference="net/random",
        rng=np.random.default_rng(0),
        said=["At least 1.2 records are needed."],
    )
    page = path.read_text(encoding="utf-8")
    for words in (
        "Return against net/random",
        "At least 1.2 records are needed.",
        "Accuracy",
        "Estimator and choice of poses",
        "Accuracy by stratum",
        "By seat drive over friction",
        "By what was hidden",
        "By difficulty",
        "Calibration",
        "Variation over training seeds",
        "Agarwal",
        "Confusion matrices",
    ):
        assert words in page, words
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    # On a narrow screen every number carries its own label.
    assert 'data-label="False alarms"' in page


def test_tables_stand_in_the_section_of_their_heading() -> None:
    parts = [
        FigureCard(image=SVG, caption="picture", heading="First"),
        PageTable(rows=[{"Agent": "a", "Accuracy": "5 %"}], title="In it", note="Five."),
        PageTable(rows=[{"Agent": "b"}], heading="Second", intro="Why."),
    ]
    shown = render_page(**simple(figures=parts))
    order = ["First", "In it", "5 %", "Five.", "picture</fig", "Second", "Why."]
    places = [shown.index(word) for word in order]
    assert places == sorted(places)


def test_values_are_escaped(page: str) -> None:
    assert "Who finds it? &lt;b&gt;" in page
    assert "<one>" not in page
    shown = render_page(**simple(table=[{"<i>": "<script>x</script>"}], text="a < b"))
    assert "<script>" not in shown and "<i>" not in shown
    assert "a &lt; b" in shown
    captioned = render_page(**simple(figures=[FigureCard(caption='"><script>', image=PNG)]))
    assert "<script>" not in captioned


def test_no_id_stands_twice(page: str) -> None:
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', page))
    assert used <= set(ids)


def test_a_failing_render_leaves_the_old_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_comparison(path, ROWS, title="t", played="p")
    old = path.read_bytes()
    broken = EpisodeTimeline(
        cards=(FigureCard(caption="no picture", image=b"GIF89a"),),
        truth="healthy",
        verdict=None,
        records=0,
        words="",
    )
    with pytest.raises(InvalidData):
        write_comparison(path, ROWS, title="t", played="p", timeline=broken)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_a_failing_write_leaves_the_old_file_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "page.html"
    write_whole(path, "old")
    old = path.read_bytes()

    def fail(self: Path, target: Path) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_whole(path, "other")
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_figures_may_be_figures_svgs_or_pngs() -> None:
    figures = [
        FigureCard(caption=caption, image=image)
        for caption, image in (
            ("a figure", success_bars(ROWS)),
            ("a drawing", SVG),
            ("a photo", PNG),
        )
    ]
    shown = render_page(**simple(figures=figures))
    assert shown.count("<svg") == 2
    assert 'src="data:image/png;base64,' in shown
    assert 'alt="a photo"' in shown


def test_figures_stand_below_their_headings() -> None:
    cards = [
        FigureCard(image=SVG, caption="one", heading="Before", intro="why"),
        FigureCard(image=SVG, caption="two"),
        FigureCard(image=SVG, caption="three", heading="After"),
    ]
    shown = render_page(**simple(figures=cards))
    order = ["Before", "why", "one</fig", "two</fig", "After", "three</fig"]
    places = [shown.index(word) for word in order]
    assert places == sorted(places)


@pytest.mark.parametrize(
    "svg",
    [
        b"no svg at all",
        b"<svg><script>alert(1)</script></svg>",
        b'<svg onload="x()"></svg>',
        b'<svg><image href="https://example.org/a.png"/></svg>',
        b"<svg><style>g { fill: url(//example.org/a.svg) }</style></svg>",
    ],
)
def test_an_svg_that_is_none_or_reaches_out_is_refused(svg: bytes) -> None:
    with pytest.raises(InvalidData):
        inline(svg, "f")


def test_figures_follow_the_colours_of_the_page() -> None:
    svg = to_svg(success_bars(ROWS))
    assert svg == to_svg(success_bars(ROWS))
    shown = inline(svg, "f")
    assert "var(--ink,#" in shown
    assert not set(AGENTS) & set(THEMED)
    template = render_page(**simple())
    for role in THEMED.values():
        assert template.count(f"--{role}:") == 3  # light, dark, printed


def test_rows_of_a_table_need_the_same_columns() -> None:
    with pytest.raises(InvalidData, match="columns"):
        render_page(**simple(table=[{"Agent": "a"}, {"Name": "b"}]))


def test_each_agent_keeps_its_colour() -> None:
    colours = agent_colours(["b", "a", "b", "c"])
    assert list(colours) == ["b", "a", "c"]
    assert len(set(colours.values())) == 3
    svg = to_svg(success_bars(ROWS, colours={"first <one>": "#123456", "second & two": "#654321"}))
    assert b"#123456" in svg and b"#654321" in svg


def test_the_best_agent_stands_first() -> None:
    found = standings([*rows_of("worse", 9), *rows_of("better", 18)])
    assert [s.agent for s in found] == ["better", "worse"]
    assert found[0].success == 0.9
    assert found[0].low < 0.9 < found[0].high


def test_no_episodes_are_refused() -> None:
    with pytest.raises(InvalidData, match="no episodes"):
        standings([])


def test_the_words_say_who_won_and_whether_it_may_be_sampling_error() -> None:
    first, then, lead = who_won([*rows_of("a", 18), *rows_of("b", 17), *rows_of("c", 2)])
    assert first.startswith("The best by return was a: right on 18 of 20 arms (90 %)")
    assert then == "Then came b (17 of 20, 3.5 records) and c (2 of 20, 3.5 records)."
    assert "sampling error" in lead and "p = 1.00" in lead
    assert "exceeds sampling error" in who_won([*rows_of("a", 18), *rows_of("c", 2)])[-1]
    assert len(who_won(rows_of("a", 18))) == 1


def test_the_curve_ends_at_the_success_rate() -> None:
    axes = success_against_records(ROWS).axes[0]
    curves = [np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_ydata()) > 2]
    assert sorted(float(c[-1]) for c in curves) == [0.45, 0.9]
    assert all(np.all(np.diff(c) >= 0) for c in curves)


def test_the_confusion_matrix_counts_every_arm() -> None:
    rows = rows_of("a", 12)
    names = ordered_hypotheses(rows)
    assert names == hypotheses(vera())
    counts = confusion_counts(rows, names)
    assert counts.sum() == 20
    assert np.trace(counts) >= 12
    assert counts[:, -1].sum() == 1  # the one without a verdict
    shown = [text.get_text() for text in confusion_matrix(rows).axes[0].texts]
    headings = {"healthy", "link loose", "joint play", "unsure", "none", "truth", "verdict"}
    assert headings <= set(shown)


def test_unsure_verdicts_and_truths_beyond_the_hypotheses_are_counted() -> None:
    rows = [{**row, "verdict": "unsure"} if k < 5 else row for k, row in enumerate(ROWS)]
    rows.append({**ROWS[0], "truth": "several_faults", "verdict": "healthy"})
    names = ordered_hypotheses(rows)
    assert names == (*hypotheses(vera()), "several_faults")
    counts = confusion_counts(rows, names)
    assert counts.sum() == len(rows)
    assert counts[:, -2].sum() == 5
    assert counts[-1].tolist() == [1] + [0] * (len(names) + 1)
    shown = [text.get_text() for text in confusion_matrix(rows).axes[0].texts]
    assert shown.count("several") == 2
    with pytest.raises(InvalidData, match="several_faults"):
        confusion_counts(rows, names[:-1])


def test_the_timeline_shows_each_record_and_the_end(timeline: EpisodeTimeline) -> None:
    captions = [card.caption for card in timeline.cards]
    assert captions == ["The first pose", "Record 1", "Record 2", "Verdict and truth"]
    assert timeline.records == 2
    assert timeline.verdict == "backlash@joint2"
    assert "joint 2 has play" in timeline.words
    last = timeline.cards[-1].image
    assert isinstance(last, bytes)
    assert "Verdict: joint 2 has play" in last.decode("utf-8")
    for card in timeline.cards[:-1]:
        assert isinstance(card.image, bytes)
        assert "Verdict" not in card.image.decode("utf-8")
