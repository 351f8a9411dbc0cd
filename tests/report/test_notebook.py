"""What a notebook and a terminal show of a diagnosis."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from loose_env.report import diagnosis_headline, diagnosis_html, diagnosis_text
from loose_env.report.pages.notebook import bar
from tests.report.diagnosis_case import CASES


@pytest.mark.parametrize("case", CASES)
def test_every_diagnosis_is_shown_with_the_same_content_as_text_and_as_html(case: str) -> None:
    arm, found = CASES[case]()
    text, shown = diagnosis_text(found, arm), diagnosis_html(found, arm)
    first, _, row, *_ = text.splitlines()
    assert first == diagnosis_headline(found, arm)
    whole = ElementTree.fromstring(f"<div>{shown}</div>")  # every element is closed
    assert "".join(whole.find("p").itertext()) == first  # type: ignore[union-attr]
    cells = ["".join(cell.itertext()) for cell in whole.findall(".//tr")[1]]
    assert all(cell in row for cell in cells)
    assert len(whole.findall(".//svg")) == len(whole.findall(".//tr")) - 1 <= 6
    assert ("warning: " in text) == ("Warnings" in shown) == bool(found.warnings)
    assert ("open: " in text) == bool(found.open_because)
    measured = found.next is not None
    assert ("  pose: " in text) == ("<li>pose: " in shown) == measured
    assert ("  shake: " in text) == ("<li>shake: " in shown) == measured


def test_commands_that_correct_the_model_are_shown_where_it_is_another_one() -> None:
    arm, found = CASES["another model"]()
    text, shown = (
        show(found, arm, folder="cell/recording") for show in (diagnosis_text, diagnosis_html)
    )
    for command in ("loose gap cell/recording --out", "loose diagnose cell/recording --model"):
        assert f"\n  {command}" in text and command in shown


def test_free_travel_has_its_unit() -> None:
    arm, found = CASES["loose link in space"]()
    assert "0.12 (0.08 to 0.21) mm" in diagnosis_text(found, arm)
    arm, found = CASES["play in a joint"]()
    assert "2.8 arc minutes" in diagnosis_text(found, arm)


def test_bars_stay_within_their_frame() -> None:
    assert 'width="0.0"' in bar(-0.5) and 'width="120.0"' in bar(7.0)
