"""The page builder: sections, figures and colours of every report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.report import (
    AGENTS,
    DARK,
    LIGHT,
    PAPER,
    THEMED,
    FigureCard,
    Section,
    Table,
    new_figure,
    render_page,
    standalone,
    to_svg,
)
from tests.report.page_checks import checked

SVG = b'<svg width="5" height="4"><defs><g id="a"/></defs><use href="#a"/></svg>'


def drawn() -> Any:
    figure = new_figure(2.0)
    figure.text(0.5, 0.5, "words", color=LIGHT["ink"])
    return figure


def test_a_page_holds_its_sections_in_order_and_leaves_empty_ones_out() -> None:
    cards = [FigureCard(image=SVG, caption="drawing"), FigureCard(image=drawn(), caption="figure")]
    table = Table(rows=[{"Agent": "a", "Accuracy": "-0.5"}], title="In it", note="Five.")
    page = render_page(
        "T",
        [
            Section(tables=[table]),
            Section(heading="First", intro=["Why."], tables=[table], cards=cards),
            Section(heading="Empty", intro=["Nothing."]),
            Section(heading="Last", points=["one"], code="a < b"),
        ],
        kicker=["k", "", "l"],
        text="before",
        notes=["foot"],
        colours={"a": "#123456"},
    )
    assert checked(page).headings == ["First", "Last"]
    order = ["k · l", "before", "First", "Why.", "In it", "Five.", "drawing</fig", "figure</fig"]
    places = [page.rindex(word) for word in [*order, "Last", "a &lt; b", "foot"]]
    assert places == sorted(places)
    # On a narrow screen every number carries its own label.
    assert 'data-label="Accuracy"' in page and "−0.5" in page and page.count("#123456") == 2


def test_values_are_escaped() -> None:
    bad = "<script>x</script>"
    page = render_page(
        bad,
        [
            Section(heading=bad, answers={bad: [bad]}, points=[bad], code=bad),
            Section(
                tables=[Table(rows=[{bad: bad}], title=bad, note=bad)],
                cards=[FigureCard(caption=f'">{bad}', image=SVG, title=bad)],
            ),
        ],
        text=bad,
        notes=bad,
    )
    assert "<script>" not in page
    assert page.count("&lt;script&gt;") > 12


def test_figures_follow_the_colours_of_the_page_and_stay_the_same() -> None:
    assert to_svg(drawn()) == to_svg(drawn())
    page = render_page("T", [Section(cards=[FigureCard(image=drawn(), caption="c")] * 2)])
    checked(page)
    assert page.count(f"var(--ink,{LIGHT['ink']})") == 2
    assert not set(AGENTS) & set(THEMED)
    for role in THEMED.values():
        assert page.count(f"--{role}:") == 3  # light, dark, printed
    assert set(LIGHT) == set(DARK) == set(PAPER) >= set(THEMED.values())


def contrast(one: str, other: str) -> float:
    """Contrast ratio of the web's accessibility guidelines, 1 to 21."""

    def light(colour: str) -> float:
        channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((light(one), light(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("colours", [LIGHT, DARK, PAPER], ids=["light", "dark", "paper"])
def test_words_stand_out_from_what_they_stand_on(colours: Mapping[str, str]) -> None:
    for ground in ("paper", "page"):
        for words in ("ink", "muted", "measured"):
            assert contrast(colours[words], colours[ground]) >= 4.5, (words, ground)
        assert contrast(colours["truth"], colours[ground]) >= 3.0  # large or bold where it is used
    # Numbers on joints.
    assert contrast(colours["ink"], colours["body"]) >= 4.5
    assert contrast(colours["paper"], colours["edge"]) >= 4.5


def test_a_figure_that_stands_alone_is_an_svg_with_its_own_colours() -> None:
    text = standalone(b'<svg viewBox="0 0 4 3"><path fill="#1b2128" d="M0 0"/></svg>', "p")
    assert ElementTree.fromstring(text).tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(--ink,#1b2128)" in text and text.count("--ink:") == 2
    assert "prefers-color-scheme: dark" in text
