"""Text tables of loggers: any names or none, separators, decimal commas, dates, lines to skip.

How a table is laid out is found out from its first lines; pyarrow reads it.
"""

from __future__ import annotations

import csv
import itertools
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.importing.samples import ChannelKey, Log, Table
from loose_env.importing.units import NUMBER, dates_ns, unit_in
from loose_env.recording import MOST_VALUES
from loose_env.typing import Array

_LOOKED_AT = 200  # lines
_PREAMBLE = 40  # lines above a table, at most
_HEAD = 2**22  # bytes that are looked at
_LONGEST_LINE = 2**20
_MOST_COLUMNS = 10_000
_WHOLE = re.compile(r"[+-]?\d{16,19}", re.ASCII)
"""Whole numbers for whose digits a float has no room."""
_MISSING = ("", "nan", "NaN", "NAN", "null", "None", "N/A")
_VECTOR = re.compile(r"\s*[\[(]\s*[-+.\d].*[\])]\s*")


@dataclass(frozen=True)
class _Head:
    """Layout of a table, and its first rows."""

    separator: str
    decimal: str
    names: list[str]
    first: int
    """Line of the first row, from 0."""
    rows: list[list[str]]
    units: list[str]
    """Units of the line below the names, where there is one."""
    named: bool
    numbers: int = 0


def open_text_table(path: Path, name: str) -> Log:
    """Open a text table."""
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raw = raw.decode("utf-16", "replace").encode()
    raw = raw.removeprefix(b"\xef\xbb\xbf")
    try:
        raw.isascii() or raw.decode()
    except UnicodeDecodeError:
        raw = raw.decode("latin-1").encode()
    raw = raw if b"\n" in raw else raw.replace(b"\r", b"\n")
    head = _recognised(raw[:_HEAD].decode("utf-8", "replace").split("\n"), name)

    def tables(_: str, __: Sequence[ChannelKey] | None) -> list[Table]:
        return [_table(raw, name, head)]

    return Log(name=name, tables=tables)


# ------------------------------------------------------------------------- values


def _table(raw: bytes, name: str, head: _Head) -> Table:
    cells, lines = _cells(raw, name, head)
    keys = [n if n and head.names.count(n) == 1 else f"#{i + 1}" for i, n in enumerate(head.names)]
    columns: dict[str, NDArray[Any]] = {}
    texts: dict[str, Sequence[str]] = {}
    units = {key: unit for key, name, below in zip(keys, head.names, head.units, strict=True)
             if (unit := unit_in(name) or below)}  # fmt: skip
    for key, own in zip(keys, cells, strict=True):
        if isinstance(own, np.ndarray):
            columns[key] = own
        elif own and _VECTOR.fullmatch(own[0]) and (vectors := _vectors(own)) is not None:
            columns |= {f"{key}[{j}]": each for j, each in enumerate(vectors.T)}
        elif (numbers := _numbers_of(own, head.decimal)) is not None:
            columns[key] = numbers
        elif (dates := dates_ns(own)) is not None:
            columns[key], units[key] = dates, "ns"
        else:
            texts[key] = own
    if not head.named:
        columns, texts = _labelled(columns, texts)
    return Table(place=name, columns=columns, texts=texts, units=units, rows=lines,
                 row_word="line", column_word="column")  # fmt: skip


def _cells(
    raw: bytes, name: str, head: _Head
) -> tuple[list[NDArray[Any] | list[str]], NDArray[np.int64]]:
    """Columns, each as numbers or as text, and the lines of the rows."""
    import pyarrow as pa
    from pyarrow import csv as pacsv

    start, end = 0, len(raw)
    for _ in range(head.first):
        start = raw.find(b"\n", start) + 1
    while end > start and raw[end - 1] in b"\r\n":
        end -= 1
    body = raw[start:end]
    if head.separator == " ":
        body = re.sub(rb"[ \t]*(\r?\n)[ \t]*", rb"\1", re.sub(rb"[ \t]+", b" ", body.strip(b" \t")))
    lines = np.arange(body.count(b"\n") + 1) + head.first + 1
    if len(lines) * len(head.names) > MOST_VALUES:
        raise InvalidData(f"{name}: more than {MOST_VALUES} values; split the file")
    names = [str(i) for i in range(len(head.names))]
    kinds, cut = {}, list[Any]()
    for i, each in enumerate(names):
        first = [r[i] for r in head.rows if i < len(r) and r[i].strip() not in _MISSING]
        own = _numbers_of(first or ["0"], head.decimal)
        kinds[each] = pa.string() if own is None else pa.from_numpy_dtype(own.dtype)

    def noted(row: Any) -> str:
        cut.append(row)
        return "skip"

    def read(kinds: dict[str, Any]) -> Any:
        cut.clear()
        return pacsv.read_csv(
            pa.BufferReader(body),
            pacsv.ReadOptions(column_names=names, use_threads=False,
                              block_size=max(len(body), 1)),
            pacsv.ParseOptions(delimiter=head.separator, invalid_row_handler=noted,
                               quote_char='"' if b'"' in body else False),
            pacsv.ConvertOptions(column_types=kinds, null_values=_MISSING, check_utf8=False,
                                 decimal_point=head.decimal, strings_can_be_null=False),
        )  # fmt: skip

    try:
        try:
            found = read(kinds)
        except (pa.ArrowInvalid, pa.ArrowKeyError):  # a text in a column of numbers
            found = read(dict.fromkeys(names, pa.string()))
    except pa.ArrowInvalid as error:
        raise InvalidData(f"{name}: not a table: {' '.join(str(error).split())[:200]}") from None
    if found.num_rows + len(cut) != len(lines):  # blank lines
        lines = lines[[bool(line.strip()) for line in body.split(b"\n")]]
    if cut:
        line = lines[cut[0].number - 1] if cut[0].number else head.first + 1
        raise InvalidData(
            f"{name}: line {line}: {cut[0].actual_columns} cells, and {len(names)} columns are "
            "named; the row was cut short, or the separator is another"
        )
    cells: list[NDArray[Any] | list[str]] = []
    for column in found.columns:
        whole = pa.types.is_integer(column.type) and not column.null_count
        plain = np.int64 if whole else np.float64
        text = pa.types.is_string(column.type)
        cells.append(column.to_pylist() if text else np.asarray(column.to_numpy(), dtype=plain))
    return cells, lines


def _numbers_of(cells: Sequence[str], decimal: str) -> NDArray[Any] | None:
    """Cells as numbers; None where one is none."""
    plain = ["nan" if cell.strip() in _MISSING else cell.strip() for cell in cells]
    if decimal == ",":
        plain = [cell.replace(".", "?").replace(",", ".") for cell in plain]
    if not all(map(NUMBER.fullmatch, plain)):
        return None
    whole = plain and all(map(_WHOLE.fullmatch, plain))
    return np.array([*map(int, plain)]) if whole else np.array([*map(float, plain)])


def _vectors(cells: Sequence[str]) -> Array | None:
    """Lists in cells, such as "[0.1, 0.2]", as columns; None where they differ in length."""
    text = ",".join(cells).replace("(", "[").replace(")", "]")
    try:
        found = np.array(json.loads(f"[{text.replace('nan', 'NaN')}]"), dtype=np.float64)
    except (ValueError, RecursionError):
        return None
    return found if found.ndim == 2 and len(found) == len(cells) else None


def _labelled(
    columns: dict[str, NDArray[Any]], texts: dict[str, Sequence[str]]
) -> tuple[dict[str, NDArray[Any]], dict[str, Sequence[str]]]:
    """Columns of ``ros2 topic echo --csv``, whose names stand in cells before their values."""
    order = sorted([*columns, *texts], key=lambda key: int(re.findall(r"\d+", key)[0]))
    names = [key for key in order if key in texts and all(texts[key])]
    rest = [key for key in order[order.index(names[-1]) + 1 :] if key in columns] if names else []
    before = [key for key in order[: order.index(names[0])] if key in columns] if names else []
    # A frame may stand before the names, each of which has one to three values.
    counts = (n for n in range(len(names), 0, -1) if len(rest) in (n, 2 * n, 3 * n))
    count = next(counts, 0)
    if not count or len(before) < 2:
        return columns, texts
    label = np.array([texts[key] for key in names[-count:]])
    found: dict[str, NDArray[Any]] = {"sec": columns[before[0]], "nanosec": columns[before[1]]}
    for block, role in zip(range(0, len(rest), count), ("position", "velocity", "effort"),
                           strict=False):  # fmt: skip
        values = np.array([columns[key] for key in rest[block : block + count]])
        for each in dict.fromkeys(label.ravel().tolist()):
            there = label == each
            own = np.where(there, values, 0.0).sum(axis=0)
            found[f"{role}[{each}]"] = np.where(there.any(axis=0), own, np.nan)
    return found, {}


# ------------------------------------------------------------------------- layout


def _recognised(lines: list[str], name: str) -> _Head:
    """Layout of a table: the split that reads most cells as numbers is the one meant."""
    long = next((i for i, line in enumerate(lines) if len(line) > _LONGEST_LINE), None)
    if long is not None:
        raise InvalidData(
            f"{name}: line {long + 1} is longer than {_LONGEST_LINE} characters; is it a table in "
            "text?"
        )
    heads = [
        found
        for separator, decimal in itertools.product((",", ";", "\t", "|", " "), ".,")
        if (found := _split(lines, separator, decimal)) is not None
    ]
    if not heads:
        raise InvalidData(
            f"{name}: there is no table of numbers in its first {_LOOKED_AT} lines; separators "
            "tried are comma, semicolon, tab, | and space; look for a quote that is not closed"
        )
    best = max(heads, key=lambda head: head.numbers)
    if len(best.names) > _MOST_COLUMNS:
        raise InvalidData(f"{name}: {len(best.names)} columns; at most {_MOST_COLUMNS} are read")
    return best


def _split(lines: list[str], separator: str, decimal: str) -> _Head | None:
    """Head of a table by a separator; None where no row of numbers is followed by its like."""
    rows: list[tuple[int, list[str]]] = []
    for skip in range(_PREAMBLE):  # a quote in the words above the table may not be closed
        try:
            rows = list(itertools.islice(_rows(lines, skip, separator), _LOOKED_AT))
            break
        except csv.Error:
            if _count(lines[skip].split(separator)[:1], decimal):
                return None  # a row of the table, and no words
    for i, (_, row) in enumerate(rows):
        width = len(row)
        if width < 2 or (numbers := _count(row, decimal)) < 1 or 2 * numbers < width - 1:
            continue
        alike = [r for _, r in rows[i : i + 5]]
        if any(len(r) != width or 2 * _count(r, decimal) < numbers for r in alike):
            continue
        off = 1 if width > 3 else 0  # names may lack one, or end with a separator
        above = [j for j in range(i) if abs(len(rows[j][1]) - width) <= off]
        above = [j for j in above if not _count(rows[j][1], decimal)]
        above = [j for j in above if len(rows[j][1]) == width] or above
        counted = [[str(k + n) for k in range(width)] for n in (0, 1)]
        broken = any("." in cell for cell in rows[i + 1][1]) if i + 1 < len(rows) else False
        if not above and [cell.strip() for cell in row] in counted and broken:
            above, i = [i], i + 1  # columns that were given numbers for names
        own = [r for _, r in rows[i:]]
        numbered = [str(k + 1) for k in range(width)]
        head = _Head(separator, decimal, numbered, rows[i][0], own, [""] * width, False, numbers)
        if not above:
            return head
        at = above[0] if above[0] >= i - 3 else above[-1]
        names = [" ".join(cell.split()).lstrip("#").strip() for cell in rows[at][1]]
        below = rows[at + 1][1] if i > at + 1 else []
        units = [unit_in(f"[{cell.strip().strip('[]()')}]") for cell in below]
        names, units = ((own + [""] * width)[:width] for own in (names, units))
        return replace(head, names=names, units=units, named=True)
    return None


def _rows(lines: list[str], skip: int, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Rows of a table, each with its line from 0; blank lines are left out."""
    reader = csv.reader(itertools.islice(lines, skip, None), delimiter=separator,
                        skipinitialspace=separator == " ", strict=True)  # fmt: skip
    for row in reader:
        if any(cell.strip() for cell in row):
            ended = separator == " " and not row[-1]
            marked = row[0].strip() in ("#", "%")  # a comment that has the names
            yield skip + reader.line_num - 1, row[marked : -1 if ended else None]


def _count(row: list[str], decimal: str) -> int:
    """Numbers in cells, those of a vector in one cell each."""
    return sum(
        cell.count(",") + 1
        if _VECTOR.fullmatch(cell)
        else bool(cell.strip()) and _numbers_of([cell], decimal) is not None
        for cell in row
    )
