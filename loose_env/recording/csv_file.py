"""The table of a run in a CSV file."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.recording.folder import read_text
from loose_env.recording.table import CheckHeader, Table, place, refuse_size
from loose_env.typing import Array

__all__ = ["read_csv", "write_csv"]


_MOST_BYTES = 2**31
_ROWS_AT_ONCE = 16_384  # cells wait as Python strings, which are seven times their numbers
_NUMBER = re.compile(
    r"\s*[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan)\s*", re.IGNORECASE | re.ASCII
)


def read_csv(path: Path, name: str, check_header: CheckHeader) -> Table:
    r"""Read a CSV file: a line of names, then a line a sample, commas between the cells.

    A byte order mark and lines that end in ``\r\n`` are taken as they come; an empty cell is a
    missing sample.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What errors call it.
    check_header : callable
        Is given the names of the columns before any row is read.

    Raises
    ------
    InvalidData
        If it is not UTF-8, not CSV, has a row of another length than its header, or a cell that
        holds no number.
    """
    text = read_text(path, name, _MOST_BYTES)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    lines: list[int] = []
    parts: list[list[Array]] = []
    try:
        header = next(reader, [])
        _refuse_header(name, header)
        check_header(header)
        for rows, places in _batches(reader, name, header):
            refuse_size(name, len(lines) + len(rows), len(header))
            parts.append(
                [
                    _numbers(cells, name, column, len(lines), places)
                    for column, cells in zip(header, zip(*rows, strict=True), strict=True)
                ]
            )
            lines += places
    except csv.Error as error:
        raise InvalidData(
            f"{name}: line {reader.line_num}: not CSV: {error}; look for a quote that is not closed"
        ) from None
    columns = {
        column: np.concatenate([part[i] for part in parts]) if parts else np.empty(0)
        for i, column in enumerate(header)
    }
    return Table(file=name, columns=columns, lines=np.array(lines, dtype=np.int64))


def write_csv(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns of one length as CSV; each number reads back as it was, to the last bit."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(columns)
        table = np.column_stack(list(columns.values()))
        for start in range(0, len(table), _ROWS_AT_ONCE):
            rows = table[start : start + _ROWS_AT_ONCE].tolist()
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows)


def _refuse_header(name: str, header: Sequence[str]) -> None:
    if not header or not any(cell.strip() for cell in header):
        raise InvalidData(
            f"{name}: line 1: no column is named; a CSV file starts with a line of names"
        )
    if len(header) == 1:
        for mark, word in ((";", "semicolons"), ("\t", "tabs")):
            if mark in header[0]:
                raise InvalidData(
                    f"{name}: line 1: column {header[0]!r}: the cells are parted by {word}; write "
                    "commas between them, and points in the numbers"
                )


def _batches(
    reader: Iterator[list[str]], name: str, header: Sequence[str]
) -> Iterator[tuple[list[list[str]], list[int]]]:
    """Rows and their lines, many at a time; every row as long as the header."""
    rows: list[list[str]] = []
    lines: list[int] = []
    blank = None
    count = 0
    for cells in reader:
        line: int = reader.line_num  # type: ignore[attr-defined]
        if not cells:
            blank = blank or line
            continue
        if blank:
            raise InvalidData(
                f"{place(name, header[0], count, blank)}: the line is blank, and more follow; "
                "take it out"
            )
        if len(cells) != len(header):
            short = len(cells) < len(header)
            column = header[len(cells)] if short else header[-1]
            raise InvalidData(
                f"{place(name, column, count, line)}: the row has {len(cells)} cells, the header "
                f"{len(header)}; an empty cell still needs its comma, and a number its point"
            )
        rows.append(cells)
        lines.append(line)
        count += 1
        if len(rows) == _ROWS_AT_ONCE:
            yield rows, lines
            rows, lines = [], []
    if rows:
        yield rows, lines


def _numbers(
    cells: Sequence[str], name: str, column: str, first: int, lines: Sequence[int]
) -> Array:
    together = "".join(cells)
    # Python also takes 1_000 and digits of other scripts for numbers; a recording does not.
    if together.isascii() and "_" not in together:
        try:
            return np.array(list(map(float, cells)))
        except ValueError:
            pass  # an empty cell, or text: found below
    values = []
    for i, cell in enumerate(cells):
        if not cell.strip():
            values.append(math.nan)
        elif _NUMBER.fullmatch(cell):
            values.append(float(cell))
        else:
            shown = cell if len(cell) <= 40 else cell[:40] + "..."
            raise InvalidData(
                f"{place(name, column, first + i, lines[i])}: {shown!r} is no number; write NaN, "
                "or nothing, where a sample is missing"
            )
    return np.array(values)
