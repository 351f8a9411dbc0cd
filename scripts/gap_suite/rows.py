"""Rows of the suite in one file: published beside the tables, and taken over on another machine."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.shard_store import ShardStore
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.files import written_beside

from .one_case import Row, grade_of, shard_for

__all__ = ["take_rows", "write_rows"]

FORMAT = "gap-suite-rows/1"


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


def take_rows(path: Path, store: ShardStore) -> int:
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
        If the file is no such file, or a line of it is broken.
    """
    try:
        first, *lines = path.read_text(encoding="utf-8").splitlines() or [""]
        if not first:
            raise ValueError("it is empty")
        head = json.loads(first)
        if head["format"] != FORMAT:
            raise ValueError(f"format {head['format']!r}")
        made = head["configuration"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidData(
            f"{path} is no file of rows as this command writes it: {error}"
        ) from error
    unlike = store.unlike(made)
    if unlike:
        raise InvalidSetting(f"other code made the rows of {path}: {unlike}")
    taken = 0
    for number, line in enumerate(lines, start=2):
        try:
            row = json.loads(line)
            grade_of(row)
            shard = shard_for(int(row["number"]))
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidData(f"{path}, line {number} is no row: {error!r}") from error
        if store.missing([shard]):
            store.write(shard, [row])
            taken += 1
    return taken
