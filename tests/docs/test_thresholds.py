"""The thresholds in the tables of the pages are those in the code."""

from __future__ import annotations

import re
from pathlib import Path

from loose_agents.execution.study import write_between

from loose_env.diagnosis import LinkFindingSettings
from loose_env.gap import settings
from scripts.dev.threshold_table import PAGE, SOURCE, threshold_table
from tests.docs.pages import ROOT

METHOD_ROW = re.compile(r"^\| [^|]+ \| ([^|]+) \| `(\w+)` \|", re.MULTILINE)


def part(page: str, begins: str) -> str:
    """Text of a page from a line on, up to the next heading."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.split(r"\n##+ ", text[text.index(begins) :].removeprefix("## "))[0]


def number(cell: str) -> float:
    found = re.match(r"[\d.]+(e-?\d+)?", cell)
    assert found is not None, f"{cell!r} begins with no number"
    return float(found[0])


def test_thresholds_of_the_gap_page_are_those_in_force(tmp_path: Path) -> None:
    table = threshold_table(SOURCE.read_text(encoding="utf-8"))
    constants = [name for name in vars(settings) if name.isupper() and not name.startswith("_")]
    assert len(constants) > 50
    assert all(f"| `{name}` | {getattr(settings, name)} |" in table for name in constants)
    page = PAGE.read_text(encoding="utf-8")
    again = tmp_path / "gap.md"
    again.write_text(page, encoding="utf-8")
    write_between(again, table)
    assert page == again.read_text("utf-8"), "python -m scripts.dev.threshold_table --docs"


def test_thresholds_of_link_finding_are_the_defaults() -> None:
    rows = METHOD_ROW.findall(part("method.md", "| threshold | default |"))
    assert len(rows) == 7
    for cell, name in rows:
        assert number(cell) == getattr(LinkFindingSettings(), name), name
