"""Channels read from a logger's text table: any names, separators, decimal commas, dates."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from decimal import Decimal
from itertools import chain
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import CsvLayout, TimeSource
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.readers.csv_lines import cells, header_of, open_text
from loose_env.importing.samples import ChannelKey, Samples, checked
from loose_env.importing.timing.dates import date_format_of, date_ns, looks_like_a_date
from loose_env.recording import MOST_VALUES, nearest

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE | re.ASCII)
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d{1,3})?", re.IGNORECASE | re.ASCII)
_LATEST_NS = 2**63
_WHOLE = re.compile(r"\d{1,5}", re.ASCII)


def read_csv_logger(
    path: Path, name: str, keys: Sequence[ChannelKey], layout: CsvLayout, time: TimeSource
) -> dict[ChannelKey, Samples]:
    """Read columns of a table, row by row; only the columns asked for are kept."""
    for key in keys:
        if key.topic:
            raise InvalidData(f"{name}: a table has no topics; leave out topic = {key.topic!r}")
    if not time.column and time.rate_hz is None:
        raise InvalidData(
            f"{name}: its time is not known. Name its column, time = {{ column = 'Time' }}, or "
            "give the recorder's sampling rate where the samples are evenly spaced, "
            "time = { rate_hz = ... } [Hz]; no rate is assumed"
        )
    wanted = list(dict.fromkeys(key.channel for key in keys))
    values: list[array[float]] = [array("d") for _ in wanted]
    stamps, lines = array("d"), array("q")
    origin = 0
    stamp_of: Callable[[str, str], tuple[int, float]] | None = None
    with open_text(path, name, layout.encoding) as file:
        rows: Iterator[tuple[int, list[str]]] = cells(file, name, layout)
        first = next(rows, None)
        if first is None:
            raise InvalidData(f"{name}: there is no table after {layout.skip} lines skipped")
        header = header_of(first[1], layout)
        if not layout.header and len(header) != len(first[1]):
            raise InvalidData(
                f"{name}: line {first[0]}: {len(first[1])} cells, and names of the source gives "
                f"{len(header)} columns (a vector of RTDE counts as its entries)"
            )
        indices = [column_index(name, header, channel) for channel in wanted]
        time_index = -1
        if time.rate_hz is None:
            time_index = column_index(name, header, time.column)
            stamp_of = _stamps(path, name, layout, time, time_index)
        for _ in range(layout.skip_after_header):
            next(rows, None)
        if not layout.header:
            rows = chain([first], rows)
        most = MOST_VALUES // (len(wanted) + 2)
        for line, row in rows:
            if len(row) < len(header) and not _only_ending(row, header):
                raise InvalidData(
                    f"{name}: line {line}: {len(row)} cells, and {len(header)} columns are named; "
                    "the row was cut short, or the separator is another"
                )
            if len(lines) == most:
                raise InvalidData(f"{name}: more than {most} rows; split the file")
            lines.append(line)
            if stamp_of is not None:
                whole, rest = stamp_of(_cell(row, time_index), f"{name}: line {line}")
                if len(lines) == 1:
                    origin = whole
                stamps.append((whole - origin) * 1e-9 + rest)
            for into, index in zip(values, indices, strict=True):
                into.append(number_of(_cell(row, index), layout, name, header[index], line))
    if time.rate_hz is not None:
        at = np.arange(len(lines)) / time.rate_hz
    else:
        at = np.frombuffer(stamps, dtype=np.float64)
    columns = dict(zip(wanted, values, strict=True))
    found = {}
    for key in keys:
        column = np.frombuffer(columns[key.channel], dtype=np.float64)
        place = f"{name}: column {key.channel!r}"
        found[key] = checked(place, at, column, origin_ns=origin, rows=lines, row_word="line")
    return found


def column_index(name: str, header: Sequence[str], channel: str) -> int:
    """Place of a column by its name, or by its number as "#3"."""
    if channel in header:
        if header.count(channel) > 1:
            numbers = [f"#{i + 1}" for i, each in enumerate(header) if each == channel]
            raise InvalidData(
                f"{name}: column {channel!r} is there {len(numbers)} times; take one by its "
                f"number, {' or '.join(numbers)}"
            )
        return list(header).index(channel)
    if channel.startswith("#") and _WHOLE.fullmatch(channel[1:]):
        number = int(channel[1:])
        if 1 <= number <= len(header):
            return number - 1
    shown = ", ".join(map(repr, header[:20]))
    raise InvalidData(
        f"{name}: there is no column {channel!r}; there are {shown[:600]}{nearest(channel, header)}"
    )


def number_of(cell: str, layout: CsvLayout, name: str, column: str, line: int) -> float:
    """Read a cell; NaN for a missing sample."""
    plain = cell.strip()
    if not plain or plain in layout.missing:
        return float("nan")
    if layout.decimal == ",":
        if "." in plain:
            raise InvalidData(
                f"{name}: line {line}, column {column!r}: {cell[:40]!r} has a point, and the "
                "source's decimal is ','"
            )
        plain = plain.replace(",", ".")
    if not _NUMBER.fullmatch(plain):
        hint = "; give decimal = ','" if "," in plain else ""
        raise InvalidData(
            f"{name}: line {line}, column {column!r}: {cell[:40]!r} is no number{hint}"
        )
    return float(plain)


def _stamps(
    path: Path, name: str, layout: CsvLayout, time: TimeSource, index: int
) -> Callable[[str, str], tuple[int, float]]:
    """Parser of a cell of time: whole nanoseconds, and the rest in seconds."""
    date_format = time.date_format
    if not date_format:
        column = time_cells(path, name, layout, index)
        first = next(column, "")
        if looks_like_a_date(first):
            date_format = date_format_of(chain([first], column), f"{name}: column {time.column!r}")
    if date_format:
        return lambda cell, place: (date_ns(cell, date_format, place), 0.0)
    nanos = round(unit_named(time.unit, f"{name}: time.unit").factor * 1e9)

    def number(cell: str, place: str) -> tuple[int, float]:
        plain = cell.strip()
        if layout.decimal == ",":
            plain = plain.replace(",", ".")
        # Seconds since 1970 with their microseconds have more digits than a float holds.
        value = Decimal(plain) * nanos if _PLAIN.fullmatch(plain) else None
        if value is None or not abs(value) < _LATEST_NS:
            raise InvalidData(f"{place}, column {time.column!r}: {cell[:40]!r} is no time")
        whole = int(value)
        return whole, float(value - whole) * 1e-9

    return number


def time_cells(path: Path, name: str, layout: CsvLayout, index: int) -> Iterator[str]:
    """Cells of one column of a table, top down."""
    with open_text(path, name, layout.encoding) as file:
        rows = cells(file, name, layout)
        for _ in range(layout.skip_after_header + (1 if layout.header else 0)):
            next(rows, None)
        for _, row in rows:
            yield _cell(row, index)


def _cell(row: list[str], index: int) -> str:
    return row[index] if index < len(row) else ""


def _only_ending(row: list[str], header: Sequence[str]) -> bool:
    """True if a row lacks only a nameless last column, left by a separator at the end."""
    return len(row) == len(header) - 1 and not header[-1]
