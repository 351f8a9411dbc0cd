"""The look that all pages share: one set of colours, legible by day, in the dark and in print."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import pytest

from loose_env.report.pages import style as styles
from loose_env.report.pages.style import DARK, LIGHT, PAPER
from loose_env.report.pages.svg import THEMED, standalone

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"


def light(colour: str) -> float:
    channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Contrast ratio of the web's accessibility guidelines, 1 to 21."""
    high, low = sorted((light(one), light(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("colours", [LIGHT, DARK, PAPER], ids=["light", "dark", "paper"])
def test_words_stand_out_from_what_they_stand_on(colours: Mapping[str, str]) -> None:
    for ground in ("paper", "page"):
        for words in ("ink", "muted", "measured"):
            assert contrast(colours[words], colours[ground]) >= 4.5, (words, ground)
        # Large or bold where it is used.
        assert contrast(colours["truth"], colours[ground]) >= 3.0
    # Numbers on joints.
    assert contrast(colours["ink"], colours["cap"]) >= 4.5
    assert contrast(colours["paper"], colours["edge"]) >= 4.5
    assert contrast(colours["paper"], colours["held-cap"]) >= 4.5


def test_every_role_has_its_colour_in_every_light() -> None:
    assert set(LIGHT) == set(DARK) == set(PAPER) >= set(THEMED.values())


def test_only_style_declares_colours() -> None:
    rules = (Path(styles.__file__).parents[1] / "page.css").read_text(encoding="utf-8")
    assert not re.search(r"#[0-9a-fA-F]{3,8}\b|rgb\(", rules)
    for file in (Path(styles.__file__).parents[2]).rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        assert "<style>" not in text or file.name == "shared.html", file
        assert not re.search(r"#[0-9a-fA-F]{6}\b", text), file


def test_every_brace_of_the_rules_is_closed() -> None:
    sheet = re.sub(r"/\*.*?\*/", "", styles.style(), flags=re.DOTALL)
    depth = 0
    for sign in re.findall(r"[{}]", sheet):
        depth += 1 if sign == "{" else -1
        assert 0 <= depth <= 2
    assert depth == 0


def test_a_picture_that_stands_alone_is_an_svg_with_its_own_colours() -> None:
    text = standalone(b'<svg viewBox="0 0 4 3"><path fill="#1b2128" d="M0 0"/></svg>', "p")
    root = ElementTree.fromstring(text)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(--ink,#1b2128)" in text and text.count("--ink:") == 2
    assert "prefers-color-scheme: dark" in text


@pytest.mark.parametrize("name", ["method_loops", "method_turning", "method_seat"])
def test_the_pictures_of_the_method_are_whole(name: str) -> None:
    root = ElementTree.parse(FIGURES / f"{name}.svg").getroot()
    words = {text.strip() for node in root.iter() if (text := node.text)}
    assert len(list(root.iter())) > 30
    assert {"method_loops": "loose link", "method_turning": "first pose"}.get(
        name, "a dead zone between two stops"
    ) in words
