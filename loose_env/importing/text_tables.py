"""Text tables of loggers: any names or none, separators, decimal commas, dates, lines to skip."""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.importing.mapping import CsvLayout, Encoding, quoted
from loose_env.importing.samples import ChannelKey, Log, Table, unreadable
from loose_env.importing.units import unit_in
from loose_env.recording import MOST_VALUES
from loose_env.typing import Array

_LOOKED_AT = 200  # lines
_PREAMBLE = 40  # lines above a table, at most
_HEAD = 2 * (_LOOKED_AT + _PREAMBLE)  # lines, blank ones among them
_LONGEST_LINE = 2**20
_MOST_COLUMNS = 10_000
_EXACT = 2**53
"""Whole numbers beyond which a float has no room for all digits."""
_ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE | re.ASCII)
_MISSING = ("", "nan", "NaN", "NAN", "null", "None", "N/A")
_VECTOR = re.compile(r"\s*[\[(]\s*[-+.\d].*[\])]\s*")


@dataclass(frozen=True)
class _Head:
    """Beginning of a table: its layout, names, and first rows."""

    layout: CsvLayout
    names: list[str]
    rows: list[list[str]]
    units: list[str]
    """Units of the line below the names, where there is one."""
    numbers: int = 0


def open_text_table(path: Path, name: str, layout: CsvLayout | None) -> Log:
    """Open a text table; without a layout it is found out."""
    head = _recognised(path, name) if layout is None else _told(path, name, layout)

    def tables(_: str, __: Sequence[ChannelKey] | None) -> list[Table]:
        return [_table(path, name, head)]

    options = tuple(_options(head.layout))
    return Log(name=name, kind="csv", words="table", tables=tables, options=options)


# ------------------------------------------------------------------------- values


def _table(path: Path, name: str, head: _Head) -> Table:
    """Whole table: by pyarrow where every row is as it should be, else cell by cell."""
    layout, names = head.layout, head.names
    read = _by_arrow(path, head) or _by_cells(path, name, layout, names)
    cells, lines = read
    keys = [n if n and names.count(n) == 1 else f"#{i + 1}" for i, n in enumerate(names)]
    columns: dict[str, NDArray[Any]] = {}
    texts: dict[str, Sequence[str]] = {}
    for key, own in zip(keys, cells, strict=True):
        if isinstance(own, np.ndarray):
            columns[key] = own
            continue
        numbers = _numbers_of(own, layout)
        if numbers is None:
            texts[key] = own
        else:
            columns[key] = numbers
    size = len(lines)
    if size * max(len(keys), 1) > MOST_VALUES:
        raise InvalidData(f"{name}: more than {MOST_VALUES} values; split the file")
    aliases = {f"#{i + 1}": key for i, key in enumerate(keys)}
    for key in [k for k, own in texts.items() if own and _VECTOR.fullmatch(own[0])]:
        vectors = _vectors(texts[key])
        if vectors is not None:
            del texts[key]
            columns |= {f"{key}[{j}]": vectors[:, j] for j in range(vectors.shape[1])}
    if not layout.header:
        columns, texts = _labelled(columns, texts)
    units = {k: u for k, u in zip(keys, head.units, strict=False) if u}
    units |= {k: unit for k, n in zip(keys, names, strict=True) if (unit := unit_in(n))}
    return Table(
        place=name,
        columns=columns,
        texts=texts,
        units=units,
        words={k: "nameless" for k, n in zip(keys, names, strict=True) if not n},
        aliases={a: k for a, k in aliases.items() if k in columns or k in texts},
        doubles={
            n: [f"#{i + 1}" for i, other in enumerate(names) if other == n]
            for n in names
            if names.count(n) > 1
        },
        rows=lines,
        row_word="line",
        column_word="column",
        kind=f"{len(names)} columns",
    )


Cells = tuple[list[NDArray[Any] | list[str]], NDArray[np.int64]]
"""Columns, each as numbers or as text, and the lines of the rows."""


def _by_arrow(path: Path, head: _Head) -> Cells | None:
    """Columns of a regular table; None where a row is not like the others."""
    import pyarrow as pa
    from pyarrow import csv as pacsv

    layout = head.layout
    if layout.separator == " " or layout.encoding == "utf-16":
        return None
    raw = path.read_bytes()
    start, skip = 0, layout.skip + (1 if layout.header else 0) + layout.skip_after_header
    for _ in range(skip):
        start = raw.find(b"\n", start) + 1
        if not start:
            return None
    body = raw[start:].strip(b"\r\n")
    if not body or b"\n\n" in body or b"\n\r\n" in body or b"\r" in body.replace(b"\r\n", b""):
        return None
    names = [str(i) for i in range(len(head.names))]
    kinds = {}
    for i, each in enumerate(names):
        first = [row[i].strip() if i < len(row) else "" for row in head.rows]
        first = [c for c in first if c not in _MISSING and c not in layout.missing]
        if not all(_NUMBER.fullmatch(c.replace(layout.decimal, ".")) for c in first):
            kinds[each] = pa.string()
        elif first and all(re.fullmatch(r"[+-]?\d{16,19}", c) for c in first):
            kinds[each] = pa.int64()
        else:
            kinds[each] = pa.float64()
    try:
        found = pacsv.read_csv(
            pa.BufferReader(body),
            pacsv.ReadOptions(column_names=names, use_threads=False, encoding=layout.encoding),
            pacsv.ParseOptions(delimiter=layout.separator),
            pacsv.ConvertOptions(
                column_types=kinds,
                null_values=[*_MISSING, *layout.missing],
                decimal_point=layout.decimal,
                strings_can_be_null=False,
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError):
        return None
    cells: list[NDArray[Any] | list[str]] = []
    for each in names:
        column = found.column(each)
        if kinds[each] == pa.string():
            cells.append(column.to_pylist())
        elif kinds[each] == pa.int64() and not column.null_count:
            cells.append(column.to_numpy())
        else:
            cells.append(np.asarray(column.to_numpy(), dtype=np.float64))
    return cells, skip + 1 + np.arange(found.num_rows, dtype=np.int64)


def _by_cells(path: Path, name: str, layout: CsvLayout, names: list[str]) -> Cells:
    lines: list[int] = []
    whole: list[list[str]] = []
    rows = _rows(_text(path, name, layout.encoding), name, layout)
    above = layout.skip_after_header + (1 if layout.header else 0)
    for line, row in itertools.islice(rows, above, None):
        # A nameless last column is left by a separator at the end.
        if len(row) < len(names) and not (len(row) == len(names) - 1 and not names[-1]):
            raise InvalidData(
                f"{name}: line {line}: {len(row)} cells, and {len(names)} columns are named; "
                "the row was cut short, or the separator is another"
            )
        lines.append(line)
        whole.append(row)
    cells: list[NDArray[Any] | list[str]] = [
        [row[i] if i < len(row) else "" for row in whole] for i in range(len(names))
    ]
    return cells, np.array(lines, dtype=np.int64)


def _numbers_of(cells: list[str], layout: CsvLayout) -> NDArray[Any] | None:
    """Cells as numbers; None where one is none."""
    found, whole = np.empty(len(cells)), True
    for i, cell in enumerate(cells):
        plain = cell.strip()
        if not plain or plain in layout.missing or plain in _MISSING:
            found[i], whole = np.nan, False
            continue
        if layout.decimal == ",":
            if "." in plain:
                return None
            plain = plain.replace(",", ".")
        if not _NUMBER.fullmatch(plain):
            return None
        found[i] = float(plain)
        whole = whole and plain.lstrip("+-").isdigit()
    if whole and len(found) and np.max(np.abs(found)) > _EXACT:
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    return found


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
    count = len(names)
    if not count or len(rest) not in (count, 2 * count, 3 * count) or len(before) < 2:
        return columns, texts
    label = np.array([texts[key] for key in names])
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


def _told(path: Path, name: str, layout: CsvLayout) -> _Head:
    """Names and first rows of a table whose layout a mapping states."""
    found = _rows(_text(path, name, layout.encoding), name, layout)
    rows = [row for _, row in itertools.islice(found, _LOOKED_AT)]
    if not rows:
        raise InvalidData(f"{name}: there is no table after {layout.skip} lines skipped")
    names = _header_of(rows[0], layout)
    if not layout.header and len(names) != len(rows[0]):
        raise InvalidData(
            f"{name}: line {layout.skip + 1}: {len(rows[0])} cells, and names of the source gives "
            f"{len(names)} columns"
        )
    head = 1 if layout.header else 0
    units = _units_below(rows[head]) if layout.skip_after_header and len(rows) > head else []
    return _Head(layout, names, rows[head + layout.skip_after_header :], units)


def _recognised(path: Path, name: str) -> _Head:
    """Layout of a table, found out: the split that reads most cells as numbers is the one meant."""
    start, best = "", None
    for encoding in _ENCODINGS:
        try:
            start = "".join(itertools.islice(_lines(_text(path, name, encoding), name), _HEAD))
            break
        except InvalidData:
            if encoding == _ENCODINGS[-1]:
                raise
    for separator in (",", ";", "\t", "|", " "):
        for decimal in (".", ","):
            if separator == decimal:
                continue
            layout = CsvLayout(separator=separator, decimal=decimal, encoding=encoding)
            found = _split(start, name, layout)
            if found is not None and (best is None or found.numbers > best.numbers):
                best = found
    if best is None:
        raise InvalidData(
            f"{name}: no table of numbers in its first {_LOOKED_AT} lines; separators tried are "
            "comma, semicolon, tab, | and space"
        )
    return best


def _split(text: str, name: str, layout: CsvLayout) -> _Head | None:
    """Head of a table by a layout; None where no row of numbers is followed by its like."""
    lines: list[tuple[int, list[str]]] = []
    for skip in range(_PREAMBLE):  # a quote in the words above the table may not be closed
        try:
            rows_of = _rows(text, name, replace(layout, skip=skip))
            lines = list(itertools.islice(rows_of, _LOOKED_AT))
            break
        except InvalidData:
            continue
    for i, (_, row) in enumerate(lines):
        width, numbers = len(row), _count(row, layout)
        if width < 2 or numbers < 1 or 2 * numbers < width - 1:
            continue
        alike = [r for _, r in lines[i : i + 5]]
        if any(len(r) != width or 2 * _count(r, layout) < numbers for r in alike):
            continue
        rows = [r for _, r in lines[i:]]
        off = 1 if width > 3 else 0  # names may lack one, or end with a separator
        above = [j for j in range(i) if abs(len(lines[j][1]) - width) <= off]
        above = [j for j in above if not _count(lines[j][1], layout)]
        counted = [[str(k + n) for k in range(width)] for n in (0, 1)]
        broken = any("." in cell for cell in lines[i + 1][1]) if i + 1 < len(lines) else False
        if not above and [cell.strip() for cell in row] in counted and broken:
            above, i = [i], i + 1  # columns that were given numbers for names
            rows = rows[1:]
        if not above:
            layout = replace(layout, skip=lines[i][0] - 1, header=False)
            return _Head(layout, _header_of(rows[0], layout), rows, [], numbers)
        at = above[0] if above[0] >= i - 3 else above[-1]
        layout = replace(layout, skip=lines[at][0] - 1, skip_after_header=i - at - 1)
        units = _units_below(lines[at + 1][1]) if i > at + 1 else []
        return _Head(layout, _header_of(lines[at][1], layout), rows, units, numbers)
    return None


def _count(row: list[str], layout: CsvLayout) -> int:
    """Numbers in cells, those of a vector in one cell each."""
    return sum(
        cell.count(",") + 1
        if _VECTOR.fullmatch(cell)
        else bool(cell.strip()) and _numbers_of([cell], layout) is not None
        for cell in row
    )


def _units_below(row: list[str]) -> list[str]:
    return [unit_in(f"[{cell.strip().strip('[]()')}]") for cell in row]


def _header_of(row: list[str], layout: CsvLayout) -> list[str]:
    if not layout.header:
        return [*layout.names] or [str(i + 1) for i in range(len(row))]
    return [" ".join(cell.split()).lstrip("#").strip() or "" for cell in row]


def _text(path: Path, name: str, encoding: str) -> str:
    """Text of a file; what cannot be read or decoded is refused."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable(name, error) from None
    if (raw[:2] in (b"\xff\xfe", b"\xfe\xff")) != (encoding == "utf-16"):
        raise InvalidData(f"{name}: the file looks like UTF-16; give encoding = 'utf-16'"
                          if encoding != "utf-16" else f"{name}: it is not UTF-16")  # fmt: skip
    try:
        return raw.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeError as error:
        raise InvalidData(
            f"{name}: it is not {encoding}: {str(error)[:120]}; give encoding = 'latin-1', "
            "'cp1252' or 'utf-16' with the source"
        ) from None


def _rows(text: str, name: str, layout: CsvLayout) -> Iterator[tuple[int, list[str]]]:
    """Rows of a table from its line of names on, each with its line; blank lines are left out.

    Lines that the layout skips may be anything; they are not looked at as a table.
    """
    lines = _lines(text, name)
    reader = csv.reader(
        itertools.islice(lines, layout.skip, None),
        delimiter=layout.separator,
        skipinitialspace=layout.separator == " ",
        strict=True,
    )
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                number = layout.skip + reader.line_num
                if len(row) > _MOST_COLUMNS:
                    raise InvalidData(
                        f"{name}: line {number}: {len(row)} cells; at most {_MOST_COLUMNS} are read"
                    )
                yield number, row
    except csv.Error as error:
        raise InvalidData(
            f"{name}: line {layout.skip + reader.line_num}: not a table: {error}; look for a quote "
            "that is not closed, or skip lines of words before the table"
        ) from None


def _lines(text: str, name: str) -> Iterator[str]:
    for number, line in enumerate(io.StringIO(text, newline="")):
        if len(line) > _LONGEST_LINE:
            raise InvalidData(
                f"{name}: line {number + 1} is longer than {_LONGEST_LINE} characters; is it a "
                "table in text?"
            )
        yield line


def _options(layout: CsvLayout) -> Iterator[str]:
    plain = CsvLayout()
    for key in ("separator", "decimal", "encoding"):
        if getattr(layout, key) != getattr(plain, key):
            yield f"{key} = {quoted(getattr(layout, key))}"
    for key in ("skip", "skip_after_header"):
        if getattr(layout, key):
            yield f"{key} = {getattr(layout, key)}"
    if not layout.header:
        yield "header = false"
