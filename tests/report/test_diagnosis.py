"""The report of a diagnosis: no surer than the numbers, the same in terminal, notebook and page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.instrument import Diagnosis, Fault
from loose_env.io import sentence
from loose_env.report import (
    diagnosis_headline,
    diagnosis_html,
    diagnosis_text,
    write_page,
)
from loose_env.report.words import percent, short_name
from tests.report.diagnosis_case import CASES, desk, diagnosis, flat
from tests.report.page_checks import checked, words


def page_of(found: Diagnosis, arm: Arm, out: Path, **more: str) -> str:
    return write_page(out / "new" / "report.html", found, arm, **more).read_text("utf-8")


@pytest.mark.parametrize(
    "case", ["not decided", pytest.param("long names", marks=pytest.mark.slow)]
)
def test_the_page_is_whole_and_has_every_record(case: str, tmp_path: Path) -> None:
    arm, found = CASES[case]()
    page = page_of(found, arm, tmp_path, recording="cell <4>")
    assert [each.name for each in (tmp_path / "new").iterdir()] == ["report.html"]
    checked(page)
    assert "cell &lt;4&gt;" in page and "cell <4>" not in page
    assert page.index("What to do next") < page.index("Hypotheses") < page.index("<svg")
    joints = {s.joint for s in found.spectra if found.records[s.record].condition == "suspect"}
    drawn = 2 + (found.next is not None) + sum(bool(r.loops) for r in found.records)
    assert page.count("<svg") == drawn + min(2, len(joints))
    said = words(page)
    assert diagnosis_headline(found, arm) in said and percent(found.probability) in said
    for record in found.records:
        assert all(part in said for part in (record.file, *record.notes))
    assert all(sentence(warning) in said for warning in found.warnings)
    for line in diagnosis_text(found, arm).splitlines()[1:4]:
        assert line.split("  ")[1] in said


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=[pytest.mark.slow] * (c == "long names")) for c in CASES]
)
def test_terminal_and_notebook_say_the_same(case: str) -> None:
    arm, found = CASES[case]()
    text, shown = diagnosis_text(found, arm), diagnosis_html(found, arm)
    first, _, row, *_ = text.splitlines()
    assert first == diagnosis_headline(found, arm)
    best = max(found.posterior, key=lambda name: found.posterior[name])
    assert short_name(arm, best) in row.lower() and percent(found.probability) in row
    whole = ElementTree.fromstring(f"<div>{shown}</div>")  # every element is closed
    assert "".join(whole.find("p").itertext()) == first  # type: ignore[union-attr]
    cells = ["".join(cell.itertext()) for cell in whole.findall(".//tr")[1]]
    assert all(cell in row for cell in cells)
    assert len(whole.findall(".//svg")) == len(whole.findall(".//tr")) - 1 <= 6
    assert all(sentence(warning) in text for warning in found.warnings)
    assert ("warning: " in text) == ("Warnings" in shown) == bool(found.warnings)
    assert ("open: " in text) == bool(found.open_because)
    measured = found.next is not None
    assert ("  pose: " in text) == ("<li>pose: " in shown) == measured
    assert ("  shake: " in text) == ("<li>shake: " in shown) == measured


@pytest.mark.parametrize(
    ("course", "settled", "said"),
    [
        ((0.7, 0.985), True, "Link 2 is loose."),
        ((0.985,), False, "Probably link 2 is loose."),
        ((0.8,), False, "Probably link 2 is loose."),
        ((0.45,), False, "Not decided. Most likely so far: link 2 is loose."),
    ],
)
def test_headline_and_steps_are_no_surer_than_what_is_settled(
    course: tuple[float, ...], settled: bool, said: str
) -> None:
    found = diagnosis(flat(), course=course)
    assert found.settled == settled
    assert diagnosis_headline(found, flat()) == said
    assert ("bolts" in diagnosis_text(found, flat())) == settled
    assert ("further poses" in diagnosis_text(found, flat())) != settled
    following = diagnosis_text(diagnosis(flat(), course=course, following=True), flat())
    assert "Measure once more" in following and "joint 1 and joint 2 in turn" in following


def test_free_travel_is_in_the_unit_of_what_moves_and_a_healthy_arm_has_its_limit(
    tmp_path: Path,
) -> None:
    arm = flat()
    assert "0.12 (0.08 to 0.21) mm" in diagnosis_text(diagnosis(arm), arm)
    assert "2.8 arc minutes" in diagnosis_text(diagnosis(arm, kind="backlash"), arm)  # 0.8 mrad
    assert "not identified" in diagnosis_text(diagnosis(arm, known=False), arm)
    healthy = replace(diagnosis(arm, kind="healthy", course=(0.8, 0.99)), spectra=())
    assert diagnosis_headline(healthy, arm) == "Nothing is loose."
    said = words(page_of(healthy, arm, tmp_path))
    assert "kept shut" in said and "one record of the healthy arm" in said
    assert "mm" not in diagnosis_text(healthy, arm)


def test_a_model_of_another_arm_is_sent_to_its_correction_with_commands(tmp_path: Path) -> None:
    arm, found = CASES["another model"]()
    said = words(page_of(found, arm, tmp_path, recording="cell-4", folder="runs/cell 4"))
    text = diagnosis_text(found, arm, folder="runs/cell 4")
    assert text.startswith("The model is not that of this arm: correct it first.")
    for command in (
        "loose gap 'runs/cell 4' --out 'runs/cell 4-gap'",
        "loose diagnose 'runs/cell 4' --model 'runs/cell 4-gap/model.xml' --out",
    ):
        assert command in said and f"\n  {command}" in text
    assert "bolts" not in said and "31 % of the record" in said
    assert "One run alone makes the fault probable" in said
    assert "Measured 2026-03-18T14:05:00+00:00. Diagnosed by loose-env 0.1.0" in said
    assert "SHA-256 0123456789abcdef" in said


def test_what_the_arm_does_not_have_is_refused_with_what_it_has(tmp_path: Path) -> None:
    found = diagnosis(flat())
    with pytest.raises(InvalidData, match=r"link2.*it has column, upper_arm"):
        page_of(found, desk(), tmp_path)
    healthy = Fault(kind="healthy")
    other = replace(found, fault=healthy, posterior={"healthy": 1.0}, spectra=())
    with pytest.raises(InvalidData, match=r"joints .*joint1.*it has base, shoulder"):
        page_of(other, desk(), tmp_path)
