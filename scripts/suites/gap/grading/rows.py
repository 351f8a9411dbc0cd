"""Rows of the suite in one file: published beside the tables, and taken over on another machine."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from loose_agents.jobs import Store

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import restored, whole_of, written_beside
from loose_env.recording import read_text
from scripts.suites.gap.cases.cases import OUT, name_of, role_of
from scripts.suites.gap.effects.catalogue import CATALOGUE, OUTSIDE
from scripts.suites.gap.grading.grade import Grade
from scripts.suites.gap.grading.one_case import Row, shard_for

__all__ = ["take_rows", "write_rows"]

FORMAT = "gap-suite-rows/1"
_MOST_BYTES = 50_000_000  # a case has some five hundred


def write_rows(path: Path, configuration: Any, rows: Sequence[Row]) -> Path:
    """Write rows to a file of JSON lines, the first of which says what made them.

    Parameters
    ----------
    path : Path
        The file; it is written beside its place and renamed.
    configuration : mapping
        Everything that the rows depend on.
    rows : sequence of Row
        The cases.
    """
    lines = [json.dumps({"format": FORMAT, "configuration": configuration}, sort_keys=True)]
    lines += [json.dumps(row) for row in rows]
    text = "\n".join(lines) + "\n"
    return written_beside(path, lambda beside: beside.write_text(text, encoding="utf-8") and None)


def take_rows(path: Path, store: Store) -> int:
    """Take the rows of a file over into a store, those that it lacks.

    Returns
    -------
    int
        How many were taken.

    Raises
    ------
    InvalidSetting
        If other code made them.
    InvalidData
        If the file is no such file, or a line of it is broken; then none is taken.
    """
    first, *lines = read_text(path, str(path), _MOST_BYTES).splitlines() or [""]
    try:
        head = whole_of(first, format=FORMAT, noun="first line")
        made = restored(dict[str, Any], head.get("configuration"), "configuration")
    except InvalidData as error:
        raise InvalidData(f"{path} is no file of rows as this command writes it: {error}") from None
    unlike = store.unlike(made)
    if unlike:
        raise InvalidSetting(f"other code made the rows of {path}: {unlike}")
    # all are looked at before one is stored: the store is what later runs go on from
    rows = [_row(line, f"{path}, line {number}") for number, line in enumerate(lines, start=2)]
    taken = 0
    for row in rows:
        shard = shard_for(row["number"])
        if store.missing([shard]):
            store.write(shard, [row])
            taken += 1
    return taken


@dataclass(frozen=True, kw_only=True)
class _Stored:
    """What a row holds."""

    number: int
    case: str
    role: str
    error: str
    grade: Grade
    times: dict[str, float]


def _row(line: str, place: str) -> Row:
    """Read one row.

    Raises
    ------
    InvalidData
        If it is not one of a case of this suite.
    """
    try:
        found = restored(_Stored, json.loads(line), "row")
        if not 0 <= found.number < OUT + 1000:
            raise ValueError(f"there is no case {found.number}")
        own = (name_of(found.number), role_of(found.number))
        if not own == (found.case, found.role) == (found.grade.case, found.grade.role):
            raise ValueError(
                f"case {found.number} is {own[0]!r} and {own[1]!r}, the line has others"
            )
        unknown = {kind for kind, _ in found.grade.truth} - {*CATALOGUE, *OUTSIDE}
        if unknown:
            raise ValueError(f"the suite hides no {' or '.join(map(repr, sorted(unknown)))}")
    except (ValueError, RecursionError) as error:
        raise InvalidData(
            f"{place} is no row: {error}; "
            "copy the file again, or take the line out and run its case"
        ) from None
    return asdict(found)
