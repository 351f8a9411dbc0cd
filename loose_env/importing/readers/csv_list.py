"""Columns of a logger's table listed, with its detected layout: separator, names, units, time."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import CsvLayout
from loose_env.importing.mapping.units import UNITS, unit_named
from loose_env.importing.readers.csv_file import number_of
from loose_env.importing.readers.csv_lines import cells, header_of, open_text
from loose_env.importing.readers.rtde_names import recipe_of_width
from loose_env.importing.samples import Channel, ChannelKey, FileList, Stream
from loose_env.importing.timing.dates import date_format_of, looks_like_a_date

_LOOKED_AT = 200  # lines
_PREAMBLE = 40  # lines above a table, at most
_ENCODINGS = ("utf-8", "utf-16", "cp1252", "latin-1")
_MARKED = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_TAILED = re.compile(r"_([a-zA-Z/0-9^]+)$")
_TIME_UNITS = ((1e5, "ns"), (100.0, "us"), (0.9, "ms"), (0.0, "s"))
"""Smallest step of a column of times -> its unit, for rates from 1 Hz to 10 kHz."""
_TIME_NAMES = ("time", "t", "timestamp", "stamp", "zeit", "datetime", "date", "temps", "tid")


def list_csv(path: Path, name: str) -> FileList:
    """List the columns of a table, and how it seems to be written."""
    encoding = _encoding(path, name)
    best: tuple[int, CsvLayout, list[str], list[list[str]]] | None = None
    for separator in (",", ";", "\t", "|", " "):
        for decimal in (".", ","):
            if separator == decimal:
                continue
            layout = CsvLayout(separator=separator, decimal=decimal, encoding=encoding)
            found = _table(path, name, layout)
            if found is None:
                continue
            skip, header, rows, width, after = found
            layout = CsvLayout(
                separator=separator,
                decimal=decimal,
                encoding=encoding,
                skip=skip,
                header=bool(header),
                skip_after_header=after,
                names=() if header else recipe_of_width(len(rows[0])),
            )
            names = header_of(header or rows[0], layout)
            # The split that reads most cells as numbers is the one meant.
            if best is None or width > best[0]:
                best = (width, layout, names, rows)
    if best is None:
        raise InvalidData(
            f"{name}: no table of numbers in its first {_LOOKED_AT} lines; separators tried are "
            "comma, semicolon, tab, | and space"
        )
    _, layout, names, rows = best
    time = _time_line(names, rows, layout)
    channels = tuple(
        Channel(
            key=ChannelKey(each if each and names.count(each) == 1 else f"#{i + 1}"),
            first=_numbers([row[i] for row in rows[:3] if i < len(row)], layout),
            unit=_unit_in(each),
            words="" if each else "nameless",
        )
        for i, each in enumerate(names)
    )
    stream = Stream(kind=f"{len(names)} columns", channels=channels)
    return FileList(
        name=name, kind="csv", words="table", streams=(stream,), options=(*_options(layout), time)
    )


def _encoding(path: Path, name: str) -> str:
    for encoding in _ENCODINGS[:-1]:
        try:
            with open_text(path, name, encoding) as file:
                for _ in range(_LOOKED_AT):
                    if not file.readline(2**16):
                        break
            return encoding
        except InvalidData:
            continue
    return _ENCODINGS[-1]


def _table(
    path: Path, name: str, layout: CsvLayout
) -> tuple[int, list[str], list[list[str]], int, int] | None:
    """Lines to skip, names, rows, numbers a row, and lines between names and numbers."""
    lines: list[tuple[int, list[str]]] = []
    for skip in range(_PREAMBLE):  # a quote in the words above the table may not be closed
        try:
            with open_text(path, name, layout.encoding) as file:
                rows_of = cells(file, name, replace(layout, skip=skip))
                lines = list(itertools.islice(rows_of, _LOOKED_AT))
            break
        except InvalidData:
            continue
    # The table starts where a row of numbers is followed by its like.
    for i, (_, row) in enumerate(lines):
        width = len(row)
        numbers = len(_numbers(row, layout))
        if width < 2 or numbers < 1 or 2 * numbers < width - 1:
            continue
        alike = [r for _, r in lines[i : i + 5]]
        if any(len(r) != width or len(_numbers(r, layout)) < numbers - 1 for r in alike):
            continue
        rows = [r for _, r in lines[i:]]
        off = 1 if width > 3 else 0  # names may lack one, or end with a separator
        above = [j for j in range(i) if abs(len(lines[j][1]) - width) <= off]
        above = [j for j in above if not _numbers(lines[j][1], layout)]
        if not above:
            return lines[i][0] - 1, [], rows, numbers, 0
        names = above[0] if above[0] >= i - 3 else above[-1]
        return lines[names][0] - 1, lines[names][1], rows, numbers, i - names - 1
    return None


def _numbers(row: list[str], layout: CsvLayout) -> tuple[float, ...]:
    found = []
    for cell in row:
        try:
            if cell.strip():
                found.append(number_of(cell, layout, "", "", 0))
        except InvalidData:
            continue
    return tuple(found)


def _time_line(names: list[str], rows: list[list[str]], layout: CsvLayout) -> str:
    for i, each in enumerate(names):
        bare = _MARKED.sub("", each).strip().lower()
        bare = _TAILED.sub("", bare) if _unit_in(each) else bare
        if bare not in _TIME_NAMES and i > 0 and "time" not in bare:
            continue
        cell = rows[0][i] if i < len(rows[0]) else ""
        if _numbers([cell], layout):
            unit = _unit_in(each)
            known = bool(unit) and unit_named(unit, each).quantity == "time" if unit else False
            if known:
                return f'time = {{ column = {quoted(each)}, unit = "{unit}" }}'
            if bare in _TIME_NAMES or "time" in bare:
                return _unit_by_steps(each, [row[i] for row in rows if i < len(row)], layout)
            continue
        if not looks_like_a_date(cell):
            continue
        column = f"time = {{ column = {quoted(each)}"
        try:
            found = date_format_of((row[i] for row in rows if i < len(row)), "")
        except InvalidData as error:
            return f"{column} }}  # {str(error).removeprefix(': ')}"
        return f"{column}, date_format = {quoted(found)} }}"
    return (
        "# no column of time was found; name it, or give the recorder's rate: "
        "time = { rate_hz = ... } [Hz]"
    )


def _unit_by_steps(name: str, column: list[str], layout: CsvLayout) -> str:
    """Line for times without a unit: that which their steps tell."""
    steps = np.diff(_numbers(column, layout))
    steps = steps[steps > 0]
    step = float(np.median(steps)) if steps.size else 0.0
    unit, words = time_unit(step), f"by its median step of {step:.4g}: no unit is stated"
    return f'time = {{ column = {quoted(name)}, unit = "{unit}" }}  # {unit} {words}'


def time_unit(step: float) -> str:
    """Unit of a column of times by its step.

    Examples
    --------
    >>> time_unit(0.002), time_unit(2.0), time_unit(2e6)
    ('s', 'ms', 'ns')
    """
    return next(unit for least, unit in _TIME_UNITS if step >= least)


def _options(layout: CsvLayout) -> list[str]:
    plain = CsvLayout()
    lines = []
    for key in ("separator", "decimal", "encoding"):
        if getattr(layout, key) != getattr(plain, key):
            lines.append(f"{key} = {quoted(getattr(layout, key))}")
    for key in ("skip", "skip_after_header"):
        if getattr(layout, key):
            lines.append(f"{key} = {getattr(layout, key)}")
    if not layout.header:
        lines.append("header = false")
    if layout.names:
        lines.append(f"names = [{', '.join(map(quoted, layout.names))}]  # of RTDE's recorder")
    return lines


def quoted(words: str) -> str:
    """Quote text for TOML, whose strings are JSON's but for one control character."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")


def _unit_in(name: str) -> str:
    """Unit that a column's name ends with, such as "[deg]" or "_ms"."""
    for pattern in (_MARKED, _TAILED):
        found = pattern.search(name)
        if found is None:
            continue
        try:
            unit_named(found.group(1), "")
        except InvalidData:
            continue
        # One letter after an underscore is more often an axis or a number than a unit.
        if pattern is _MARKED or (found.group(1) in UNITS and len(found.group(1)) > 1):
            return found.group(1)
    return ""
