"""Tables of runs read from and written to CSV and Parquet; paths kept inside a recording."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.typing import Array

CheckHeader = Callable[[Sequence[str]], None]
"""Is given the names of the columns before a number is read, and raises if they are wrong."""

FEWEST_SAMPLES = 10
"""Shortest run of the format."""
MOST_VALUES = 100_000_000
"""Largest table that is read, rows times columns: 0.8 GB."""
MOST_MISSING = 0.2
"""Share of its samples that a column may miss [1]."""

_MOST_BYTES = 2**31
_ROWS_AT_ONCE = 16_384  # cells wait as Python strings, which are seven times their numbers
_NUMBER = re.compile(
    r"\s*[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan)\s*", re.IGNORECASE | re.ASCII
)


def inside(folder: Path, given: str, place: str) -> Path:
    """Find where a path of a recording leads."""
    if not given or not given.isprintable() or "\\" in given:
        raise InvalidData(
            f"{place}: {given!r:.200} is no path; give one from the recording's folder, with / "
            "between its parts"
        )
    if PurePosixPath(given).is_absolute() or PureWindowsPath(given).drive:
        raise InvalidData(f"{place}: {given!r:.200} is absolute; give a path from the folder")
    try:
        found = (folder / given).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidData(f"{place}: {given!r:.200} leads nowhere: {error}") from None
    if not found.is_relative_to(folder):
        raise InvalidData(
            f"{place}: {given!r:.200} leaves the folder of the recording; copy the file into it"
        )
    return found


def existing_file(folder: Path, given: str, place: str, hint: str = "") -> Path:
    """Find a file that is there, as `inside`."""
    found = inside(folder, given, place)
    try:
        there = found.is_file()
    except OSError as error:
        raise InvalidData(f"{place}: {given!r:.200} cannot be read: {error.strerror}") from None
    if not there:
        raise InvalidData(f"{place}: there is no file {given!r:.200} in {folder}{hint}")
    return found


def read_text(file: Path, name: str, most: int) -> str:
    """Read a file of UTF-8, with or without the byte order mark that some programs put first.

    Raises
    ------
    InvalidData
        If it is not UTF-8, longer than ``most`` bytes, or cannot be read.
    """
    try:
        size = file.stat().st_size
        if size > most:
            raise InvalidData(f"{name}: {size} bytes; at most {most} are read")
        raw = file.read_bytes()
        return raw.decode("utf-8-sig")
    except OSError as error:
        raise InvalidData(f"{name}: it cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        other = ", the file looks like UTF-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else ""
        raise InvalidData(
            f"{name}: line {line} is not UTF-8{other}: byte {error.start + 1} is "
            f"0x{raw[error.start]:02x}; save the file as UTF-8"
        ) from None


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
    """Refuse a table whose numbers are none of a run."""
    time = table.columns["time"]
    rows = len(time)
    if rows < FEWEST_SAMPLES:
        last = table.place("time", rows - 1) if rows else f"{table.file}: column 'time', row 0"
        raise InvalidData(
            f"{last} is the last: the run has {rows} sample{'s' * (rows != 1)}; it needs at least "
            f"{FEWEST_SAMPLES}"
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


def read_csv(path: Path, name: str, check_header: CheckHeader) -> Table:
    """Read a CSV file: a line of names, then a line a sample, commas between the cells."""
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


def read_parquet(path: Path, name: str, check_header: CheckHeader) -> Table:
    """Read a Parquet file: a column of numbers each, nulls as missing samples."""
    import pyarrow.parquet

    if path.stat().st_size == 0:
        raise InvalidData(f"{name}: the file is empty; a run has at least 10 samples")
    try:
        file = pyarrow.parquet.ParquetFile(path, page_checksum_verification=True)
        header = file.schema_arrow.names
        rows = file.metadata.num_rows
    except Exception as error:  # pyarrow raises OSError, ValueError and its own
        raise _broken(name, error) from None
    with file:
        check_header(header)
        refuse_size(name, rows, len(header))
        try:
            # Threads of pyarrow would not survive a fork of the caller, and save nothing here.
            table = file.read(use_threads=False)
        except (Exception, MemoryError) as error:
            raise _broken(name, error) from None
        if table.num_rows != rows or table.column_names != header:
            raise _broken(name, f"it announces {rows} rows and holds {table.num_rows}")
        columns = {column: _numbers_of(table.column(column), name, column) for column in header}
    return Table(file=name, columns=columns)


def write_parquet(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns of one length as Parquet, with checksums."""
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table({name: pyarrow.array(values) for name, values in columns.items()})
    # Measured numbers hardly repeat: bytes of like rank beside each other pack better and faster.
    pyarrow.parquet.write_table(table, path, compression="zstd", write_page_checksum=True,
                                use_dictionary=False, use_byte_stream_split=True)  # fmt: skip


def _broken(name: str, error: object) -> InvalidData:
    words = " ".join(str(error).split())[:200] or type(error).__name__
    return InvalidData(
        f"{name}: not a whole Parquet file: {words}. It may be cut short, damaged or of another "
        "kind; copy it again, or give a CSV file the ending .csv"
    )


def _numbers_of(column: Any, name: str, title: str) -> Array:
    import pyarrow
    import pyarrow.types as types

    try:
        if types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        kind = column.type
        if types.is_null(kind):
            return np.full(len(column), np.nan)
        if types.is_float64(kind):  # a cast loads all functions of pyarrow, a quarter of a second
            return np.asarray(column.to_numpy())
        if types.is_floating(kind) or types.is_integer(kind) or types.is_decimal(kind):
            values = column.cast(pyarrow.float64(), safe=False).to_numpy()
            return np.asarray(values, dtype=np.float64)
    except Exception as error:
        raise _broken(name, f"column {title!r}: {error}") from None
    row = next((i for i, value in enumerate(column) if value.is_valid), 0)
    shown = _shown(column[row]) if len(column) and column[row].is_valid else ""
    raise InvalidData(
        f"{place(name, title, row, None)}: {shown or 'nothing'} of type {kind} where a number "
        "belongs; store the column as float64 in SI units"
    )


def _shown(value: Any) -> str:
    try:
        return repr(value.as_py())[:40]
    except Exception:  # times finer than Python's, text that is not UTF-8
        return "a value"
