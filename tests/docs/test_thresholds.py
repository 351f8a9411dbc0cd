"""The thresholds that a command and the pages print are those in the code."""

from __future__ import annotations

import re
from ast import literal_eval
from types import ModuleType

import pytest

from loose_env.diagnosis import LinkFindingSettings
from loose_env.doctor import thresholds as doctor
from loose_env.gap import settings
from loose_env.instrument.settings import thresholds
from scripts.dev.threshold_table import PARTS, threshold_table
from tests.docs.pages import ROOT

ROW = re.compile(r"^\| `(\w+)` \| ([^|]+) \|", re.MULTILINE)
METHOD_ROW = re.compile(r"^\| [^|]+ \| ([\d.]+)°? \| `(\w+)` \|", re.MULTILINE)


@pytest.mark.parametrize(
    ("part", "module", "fewest"),
    [("doctor", doctor, 70), ("gap", settings, 50), ("instrument", thresholds, 40)],
)
def test_the_table_of_a_part_has_every_threshold_in_force(
    part: str, module: ModuleType, fewest: int
) -> None:
    table = threshold_table(PARTS[part].read_text(encoding="utf-8"))
    constants = [name for name in vars(module) if name.isupper() and not name.startswith("_")]
    assert len(constants) > fewest
    shown = {name: literal_eval(cell) for name, cell in ROW.findall(table)}
    assert {name: getattr(module, name) for name in constants} == shown


def test_every_threshold_of_the_doctor_has_a_reason_and_is_used() -> None:
    folder = ROOT / "loose_env" / "doctor"
    source = (folder / "thresholds.py").read_text("utf-8")
    code = "".join(
        path.read_text("utf-8") for path in folder.rglob("*.py") if path.name != "thresholds.py"
    )
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| (.+) \|$", threshold_table(source), re.MULTILINE)
    assert len(rows) > 70
    for name, meaning in rows:
        assert re.search(rf"\b{name}\b", code), f"{name} is not used"
        assert ":" in meaning or ". " in meaning, f"{name} has no reason: {meaning}"


def test_thresholds_of_link_finding_are_the_defaults() -> None:
    rows = METHOD_ROW.findall((ROOT / "docs" / "method.md").read_text(encoding="utf-8"))
    assert len(rows) == 7
    for cell, name in rows:
        assert float(cell) == getattr(LinkFindingSettings(), name), name
