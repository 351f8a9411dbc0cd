"""The table of a run as its file holds it, and what its numbers have to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = [
    "FEWEST_SAMPLES",
    "MOST_MISSING",
    "MOST_VALUES",
    "CheckHeader",
    "Table",
    "check_numbers",
    "place",
    "refuse_size",
]


CheckHeader = Callable[[Sequence[str]], None]
"""Is given the names of the columns before a number is read, and raises if they are wrong."""

FEWEST_SAMPLES = 10
"""Shortest run of the format."""
MOST_VALUES = 100_000_000
"""Largest table that is read, rows times columns: 0.8 GB."""
MOST_MISSING = 0.2
"""Share of its samples that a column may miss [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of a run's file, with what is needed to say where in the file something stands."""

    file: str
    """Name of the file, as errors give it."""
    columns: Mapping[str, Array]
    """Values of each column, shape (rows,)."""
    lines: NDArray[np.int64] | None = None
    """Line of the file on which each row stands, from 1; None where a file has no lines."""

    def place(self, column: str, row: int) -> str:
        """Words for a place: file, column, and the row, counted from 1 below the header."""
        line = None if self.lines is None else int(self.lines[row])
        return place(self.file, column, row, line)


def place(file: str, column: str, row: int, line: int | None) -> str:
    """Words for a place of a file; ``row`` is counted from 0 here, and from 1 in the words."""
    counted = "counted from 1" if line is None else f"line {line} of the file"
    return f"{file}: column {column!r}, row {row + 1} ({counted})"


def refuse_size(file: str, rows: int, columns: int) -> None:
    """Refuse a table that would not fit into the memory of a desk computer."""
    if rows * columns > MOST_VALUES:
        raise InvalidData(
            f"{file}: {rows} rows of {columns} columns are {rows * columns} values; at most "
            f"{MOST_VALUES} are read. Split the run into several"
        )


def check_numbers(table: Table) -> None:
    """Refuse a table whose numbers are none of a run.

    Raises
    ------
    InvalidData
        If it is shorter than `FEWEST_SAMPLES`, its time is missing somewhere or does not
        increase, a value is infinite, or a column misses more than `MOST_MISSING`.
    """
    time = table.columns["time"]
    rows = len(time)
    if rows < FEWEST_SAMPLES:
        last = table.place("time", rows - 1) if rows else f"{table.file}: column 'time', row 0"
        raise InvalidData(
            f"{last} is the last: the run has {rows} samples; it needs at least {FEWEST_SAMPLES}"
        )
    for name, values in table.columns.items():
        infinite = np.flatnonzero(np.isinf(values))
        if infinite.size:
            row = int(infinite[0])
            raise InvalidData(
                f"{table.place(name, row)}: {values[row]} is not finite; leave a sample that is "
                "missing as NaN"
            )
    missing = np.flatnonzero(np.isnan(time))
    if missing.size:
        raise InvalidData(
            f"{table.place('time', int(missing[0]))}: the time is missing; every row needs one, "
            "so leave the row out"
        )
    still = np.flatnonzero(np.diff(time) <= 0)
    if still.size:
        row = int(still[0]) + 1
        here, before = float(time[row]), float(time[row - 1])
        raise InvalidData(
            f"{table.place('time', row)}: time has to increase strictly, and {here!r} s follows "
            f"{before!r} s; delete the row, or give times in finer steps"
        )
    for name, values in table.columns.items():
        missing = np.flatnonzero(np.isnan(values))
        if missing.size > MOST_MISSING * rows:
            raise InvalidData(
                f"{table.place(name, int(missing[0]))} is the first of {missing.size} missing "
                f"samples, {missing.size / rows:.1%} of {rows}; a column may miss "
                f"{100 * MOST_MISSING:g} %. Leave the column out, cut the run to where it was "
                "recorded or, where its sensor is slower than the others, interpolate it at their "
                "times, as 'loose import' does"
            )
