"""The thresholds in the tables of the pages are those in the code."""

from __future__ import annotations

import ast
import re

import pytest

from loose_env.diagnosis import LinkFindingSettings
from tests.docs.pages import ROOT

GAP_ROW = re.compile(r"^\| [^|]+ \| ([^|]+) \| `([\w/.]+\.py)` `([\w.]+)` \|", re.MULTILINE)
METHOD_ROW = re.compile(r"^\| [^|]+ \| ([^|]+) \| `(\w+)` \|", re.MULTILINE)


def part(page: str, begins: str) -> str:
    """Text of a page from a line on, up to the next heading."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.split(r"\n##+ ", text[text.index(begins) :].removeprefix("## "))[0]


def value(module: str, name: str) -> float:
    """Value of a constant, or of a field of a settings class, as the source gives it."""
    tree = ast.parse((ROOT / "loose_env" / "gap" / module).read_text(encoding="utf-8"))
    owner, _, last = name.rpartition(".")
    if module == "settings.py":
        owner = owner or "NamingSettings"
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    body = next(node.body for node in classes if node.name == owner) if owner else tree.body
    for node in body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            words = [each.id for each in names if isinstance(each, ast.Name)]
            if last in words:
                given = ast.literal_eval(node.value)
                return float(given[words.index(last)] if isinstance(given, tuple) else given)
    raise KeyError(f"{module} has no {name}")


def number(cell: str) -> float:
    found = re.match(r"[\d.]+(e-?\d+)?", cell)
    assert found is not None, f"{cell!r} begins with no number"
    return float(found[0])


@pytest.mark.parametrize(
    ("cell", "module", "name"),
    GAP_ROW.findall(part("gap.md", "## Decision thresholds")),
    ids=lambda each: each,
)
def test_thresholds_of_the_gap_page_are_those_in_force(cell: str, module: str, name: str) -> None:
    assert number(cell) == value(module, name)


def test_no_row_of_the_gap_page_goes_unchecked() -> None:
    table = part("gap.md", "## Decision thresholds")
    rows = [
        row for row in table.splitlines() if row.startswith("| ") and not row.startswith("| **")
    ]
    assert len(rows) - 1 == len(GAP_ROW.findall(table)) > 0  # the first is the head


def test_thresholds_of_link_finding_are_the_defaults() -> None:
    rows = METHOD_ROW.findall(part("method.md", "| threshold | default |"))
    assert len(rows) == 7
    for cell, name in rows:
        assert number(cell) == getattr(LinkFindingSettings(), name), name
