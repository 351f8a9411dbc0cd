"""Times of a table: which column they are, and what may be done to put their rows in order.

A column of times is taken as it is where it increases. A counter that overflowed is continued, and
rows that came late are put back, where nothing contradicts it: every one of these is told with its
count. Anything else is refused with the column, the row and both values. A clock that was set back
is no row that came late: the time that it runs through twice holds twice as many rows.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.importing.mapping import TimeSource
from loose_env.importing.samples import Samples, Table, printable, quoted
from loose_env.importing.units import NUMBER, quantity_of, unit_in, unit_named
from loose_env.recording import nearest
from loose_env.typing import Array

_MODULI = (*(float(2**bits) for bits in (8, 12, 16, 24, 31, 32)), 1e6, 1e9)
"""Counts at which counters of loggers start again."""
_OVERFLOW = 5.0
"""Most median steps across an overflow, which hides how many rows were lost there."""
_LATE = 0.3
"""Largest share of rows that come late, one row in three being no order any more."""
_TWICE = 0.25
"""Rows beyond the even rate, as a share of a stretch, from which the clock ran through it twice."""
_FEWEST = 10
"""Rows from which a rate is known that tells late rows from a clock that was set back."""
_JITTER = 0.2
"""Share of the median step by which most steps of a nameless column of times may differ."""
_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e9, "s"))
"""Least count of a date since 1970, from the year 2001 on, in each unit."""
_STEPS = ((1e5, "ns"), (100.0, "us"), (0.9, "ms"), (0.0, "s"))
"""Smallest step of a column of times -> its unit, for rates from 1 Hz to 10 kHz."""
_NAMES = {"time", "t", "ts", "timestamp", "timestamps", "stamp", "zeit", "datetime", "date",
          "temps", "tid", "tick", "ticks", "clock", "timer"}  # fmt: skip
_STEADY = {"monotonic", "mono", "steady", "boot", "uptime", "elapsed", "relative", "since"}
_SECONDS, _NANOS = {"sec", "secs", "seconds"}, {"nanosec", "nsec", "nsecs", "nanosecs", "nanos",
                                                "nanoseconds"}  # fmt: skip


class _Clock(NamedTuple):
    """Times of all rows of a table, as the file has them."""

    label: str
    """Column and unit, as errors say them."""
    raw: NDArray[Any]
    factor: float
    """Seconds of one of the raw values."""


def samples_of(table: Table, channel: str, time: TimeSource) -> Samples:
    """Samples of a channel on its table's times; refused where there is no order to them."""
    values = np.asarray(_numbers(table, channel, "number"), dtype=np.float64)
    place = f"{table.place}: {table.column_word} {channel!r}"
    if np.isfinite(values).all():
        at, origin, keep, done = _all_times(table, time)
    else:
        at, origin, keep, done = _ordered(table, time, np.flatnonzero(~np.isnan(values)))
        if (infinite := np.flatnonzero(np.isinf(values))).size:
            raise InvalidData(f"{table.row(int(infinite[0]))}: the value is infinite, {channel!r}")
    if len(keep) < 2:
        raise InvalidData(f"{place}: it has {len(keep)} samples; at least 2 needed")
    return Samples(
        place=place,
        origin_ns=origin,
        time=at,
        values=values[keep],
        unit=table.units.get(channel, ""),
        done=(*table.done, *done),
    )


def chosen_time(tables: Sequence[Table]) -> tuple[TimeSource, str]:
    """Time of the tables of all files, by their format or as it orders all rows; and why."""
    first = tables[0]
    candidates = ([TimeSource()] if first.time else []) + _named(first)
    if first.rate_hz is not None and not candidates:
        return TimeSource(), "by the format"
    refused: list[str] = []
    for each in itertools.chain(candidates, _nameless(first, counts=not candidates)):
        done: dict[str, None] = {}
        try:
            for table in tables:
                raw = np.asarray(_clock(table, each).raw, dtype=np.float64)
                done |= dict.fromkeys(_ordered(table, each, np.flatnonzero(~np.isnan(raw)))[-1])
        except InvalidData as error:
            refused.append(str(error))
            continue
        stated = not each.column or each.fine or first.units.get(each.column)
        unit = "" if stated or unit_in(each.column) else (
            f"{each.unit} by the size of its steps: no unit is stated")  # fmt: skip
        passed = [f"not {_short(words)}" for words in refused]
        return each, "; ".join(filter(None, [unit, *done, *passed]))
    if refused:
        more = "" if len(refused) == 1 else f"; nor can the next, {_short(refused[1])}"
        raise InvalidData(f"{refused[0]}; no other column orders the rows{more}")
    raise InvalidData(
        f"{first.place}: its times are not known: none of its columns "
        f"({', '.join(map(repr, [*first.columns][:6]))[:200]}) advances in even steps; is it a "
        "log? Then give the sampling rate by --rate-hz, or a mapping with time = { column = ... }"
    )


def time_line(time: TimeSource, words: str = "") -> str:
    """Line of a mapping for a time."""
    parts = [f"column = {quoted(time.column)}"] if time.column else []
    parts += [f'unit = "{time.unit}"'] if time.unit else []
    parts += [f"fine = {quoted(time.fine)}"] if time.fine else []
    parts += [f"rate_hz = {time.rate_hz:.12g}"] if time.rate_hz is not None else []
    return f"time = {{ {', '.join(parts)} }}{f'  # {printable(words)}' if words else ''}"


def time_unit(step: float, value: float = 0.0) -> str:
    """Unit of a column of times by its size, where that is a date, else by its step.

    Examples
    --------
    >>> time_unit(0.002), time_unit(2.0), time_unit(2e6), time_unit(2e6, 1.7e18)
    ('s', 'ms', 'ns', 'ns')
    """
    if value >= _EPOCHS[-1][0]:
        return next(unit for least, unit in _EPOCHS if value >= least)
    return next(unit for least, unit in _STEPS if step >= least)


# ------------------------------------------------------------------------- candidates


def _named(table: Table) -> list[TimeSource]:
    """Columns that their names or units call a time, those of a clock that is never set first."""
    found: list[tuple[bool, TimeSource]] = []
    for name in [each for each in table.columns if each != table.time]:
        words = set(re.findall(r"[a-zäöü]+\d*", name.lower()))
        unit = table.units.get(name) or unit_in(name)
        timed = quantity_of(unit) == "time"
        fine = next((n for n in table.columns if words & _SECONDS and _same_but(name, n)), "")
        called = words & (_NAMES | _STEADY) or any("time" in word for word in words)
        other = words & {"task", "index", "lag", "delay", "duration", "execution"}
        rest = words & _NANOS and not words & _NAMES  # of another column's seconds
        if fine:
            found.append((True, TimeSource(column=name, fine=fine)))
        elif (timed or (called and not other)) and not rest:
            found.append((not words & _STEADY, _with_unit(table, name, unit if timed else "")))
    return [each for _, each in sorted(found, key=lambda pair: pair[0])]


def _nameless(table: Table, *, counts: bool) -> Iterator[TimeSource]:
    """Column, or seconds and nanoseconds in two, that advances in even steps and counts no rows.

    Beside a time that is refused a count may have gaps, too.
    """
    columns = {name: np.asarray(v, dtype=np.float64) for name, v in table.columns.items()}
    pairs = zip(columns, [*columns][1:], strict=False)
    tried = [(TimeSource(column=name), values) for name, values in columns.items()]
    tried += [(TimeSource(column=a, fine=b), columns[a] - columns[a][:1] + 1e-9 * columns[b])
              for a, b in pairs if np.ptp(columns[b]) > 1e8 and columns[b].min() >= 0
              and columns[b].max() < 1e9]  # fmt: skip
    for source, values in tried:
        steps = np.diff(values)
        if len(steps) < 2 or not np.all(steps > 0):
            continue
        step = float(np.median(steps))
        even = np.mean(np.abs(steps - step) <= _JITTER * step) > 0.5
        if even and not (np.all(steps == 1) if counts else step == 1):
            yield source if source.fine else _with_unit(table, source.column, "")
            return


def _with_unit(table: Table, name: str, unit: str) -> TimeSource:
    values = np.asarray(table.columns[name], dtype=np.float64)
    steps = np.diff(values[~np.isnan(values)])
    steps = steps[steps > 0]
    first = float(values[0]) if len(values) else 0.0
    return TimeSource(
        column=name, unit=unit or time_unit(float(np.median(steps)) if steps.size else 0.0, first)
    )


def _same_but(seconds: str, nanos: str) -> bool:
    """Whether two names differ in seconds and nanoseconds alone."""
    one, other = (re.split(r"([a-z]+)", name.lower()) for name in (seconds, nanos))
    unlike = [pair for pair in zip(one, other, strict=False) if pair[0] != pair[1]]
    alike = len(one) == len(other) and len(unlike) == 1
    return alike and unlike[0][0] in _SECONDS and unlike[0][1] in _NANOS


def _short(words: str) -> str:
    return words.split("; choose", 1)[0][:160]


# ------------------------------------------------------------------------- order


@lru_cache(maxsize=8)
def _clock(table: Table, time: TimeSource) -> _Clock:
    """Times of all rows as the file has them, or by a rate."""
    place, own = table.place, time.column or table.time
    rate = time.rate_hz or (None if own else table.rate_hz)
    if rate is not None:
        return _Clock(f"at {rate:g} Hz", np.arange(float(len(table))), 1 / rate)
    if not own:
        raise InvalidData(
            f"{place}: its time is not known. Name its column, time = {{ column = 'Time' }}, or "
            "give the recorder's sampling rate where the samples are evenly spaced, "
            "time = { rate_hz = ... } [Hz]; no rate is assumed"
        )
    raw = _numbers(table, own, "time")
    if time.fine:
        whole = [np.asarray(part) for part in (raw, _numbers(table, time.fine, "time"))]
        if not all(np.all(np.isfinite(part)) for part in whole):
            raise InvalidData(f"{place}: columns {own!r} and {time.fine!r} of the time miss values")
        raw = whole[0].astype(np.int64) * 10**9 + whole[1].astype(np.int64)
        return _Clock(f"{own!r} and {time.fine!r} [ns]", raw, 1e-9)
    unit = time.unit or table.units.get(own) or "s"
    return _Clock(f"{own!r} [{unit}]", raw, unit_named(unit, f"{place}: time.unit").factor)


_Ordered = tuple[Array, int, NDArray[np.int64], tuple[str, ...]]


@lru_cache(maxsize=8)
def _all_times(table: Table, time: TimeSource) -> _Ordered:
    """Times of all rows, which channels without missing samples share."""
    return _ordered(table, time, np.arange(len(table)))


def _ordered(table: Table, time: TimeSource, rows: NDArray[np.int64]) -> _Ordered:
    """Times of rows [s] after an origin [ns], the rows in their order, and what was done."""
    clock = _clock(table, time)
    raw = clock.raw[rows]
    bad = np.flatnonzero(~np.isfinite(raw))
    if bad.size:
        value = raw[int(bad[0])]
        words = "''" if np.isnan(value) else f"'{value}'"
        name = clock.label.rsplit(" [", 1)[0]
        raise InvalidData(f"{table.row(int(rows[bad[0]]))}, column {name}: {words} is no time")
    done: list[str] = []
    if len(raw) > 1 and np.any(np.diff(raw) <= 0):
        raw, order = _mended(table, clock, raw, rows, done)
        rows, raw = (rows[order], raw[order])
    first = raw[0] if len(raw) else np.float64()
    nanos = round(clock.factor * 1e9) if raw.dtype.kind in "iu" else clock.factor * 1e9
    return (raw - first) * clock.factor, round(first.item() * nanos), rows, tuple(done)


def _mended(
    table: Table, clock: _Clock, raw: NDArray[Any], rows: NDArray[np.int64], done: list[str]
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Times with overflows continued, and the order of their rows."""
    raw = _continued(table, clock, raw, rows, done)
    steps = np.diff(raw)
    back = np.flatnonzero(steps <= 0)
    order = np.argsort(raw, kind="stable")
    if not back.size:
        return raw, order
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    late = int(np.sum(raw < np.maximum.accumulate(raw)))
    enough = step > 0 and len(raw) >= _FEWEST and late <= _LATE * len(raw)
    i = _set_back(raw, raw[order], back, step) if enough else int(back[0])
    still = np.flatnonzero(np.diff(raw[order]) == 0)
    if i is None and not still.size:
        words = f"rows came late by {clock.label} and were put back in order"
        done.append(f"{table.place}: {late} {words}")
        return raw, order
    one, other = (i, i + 1) if i is not None else order[still[0] : still[0] + 2].tolist()
    same = raw[one] == raw[other]
    alike = f" ({len(raw) - len(np.unique(raw))} of {len(raw)} rows have the time of another)"
    raise InvalidData(
        f"{table.row(int(rows[other]))}: time {'stands still' if same else 'runs backwards'}: "
        f"{clock.label} is {raw[other]} after {raw[one]}{alike if same else ''}; choose another "
        "time for this source (a finer stamp, or rate_hz where the samples are evenly spaced)"
    )


def _continued(
    table: Table, clock: _Clock, raw: NDArray[Any], rows: NDArray[np.int64], done: list[str]
) -> NDArray[Any]:
    """Times of a counter that started again at 0, counted on."""
    steps = np.diff(np.asarray(raw, dtype=np.float64))
    forward = steps[steps > 0]
    if not forward.size:
        return raw
    step, low, high = float(np.median(forward)), float(raw.min()), float(raw.max())
    deep = np.flatnonzero(steps < -0.5 * (high - low))
    for modulus in (m * scale for scale in (1.0, 1e-3, 1e-6, 1e-9) for m in _MODULI):
        jumps = steps[deep] + modulus
        if not deep.size or low < 0 or high >= modulus or (high - low) < 1e-3 * modulus:
            continue
        if np.any(jumps <= 0) or np.any(jumps > _OVERFLOW * step):
            continue
        turns = np.zeros(len(raw), dtype=raw.dtype)
        turns[deep + 1] = modulus if raw.dtype.kind == "f" else int(modulus)
        first = int(rows[deep[0] + 1])
        done.append(
            f"{table.row(first)}: the counter {clock.label} overflows at {modulus:.10g}, from "
            f"{raw[deep[0]]} to {raw[deep[0] + 1]}, and is counted on ({len(deep)} times)"
        )
        return np.asarray(raw + np.cumsum(turns))
    return raw


def _set_back(
    raw: NDArray[Any], order: NDArray[Any], back: NDArray[np.int64], step: float
) -> int | None:
    """Row before the deepest step back of the clock; None where rows only came late."""
    since, whole = order - raw[0], np.maximum.accumulate(raw)
    twice: list[tuple[float, int]] = []
    for i in back[whole[back] > raw[back + 1]]:
        low, high = float(raw[i + 1] - raw[0]), float(whole[i] - raw[0])
        there = np.count_nonzero((since >= low - 5 * step) & (since < high + 5.0001 * step))
        span = min(high + 5 * step, float(since[-1])) - max(low - 5 * step, float(since[0]))
        if there - (span / step + 1) > max(1.5, _TWICE * (high - low) / step):
            twice.append((high - low, -int(i)))
    return -max(twice)[1] if twice else None


def _numbers(table: Table, name: str, word: str) -> NDArray[Any]:
    """Values of a column; refused where a cell is none, or there is no such column."""
    if name in table.columns:
        return table.columns[name]
    if name in table.texts:
        cells = enumerate(table.texts[name])
        i, cell = next((i, c) for i, c in cells if not NUMBER.fullmatch(c.strip() or "nan"))
        raise InvalidData(
            f"{table.row(i)}, {table.column_word} {name!r}: {cell[:40]!r} is no {word}"
        )
    there = [*table.columns, *table.texts]
    raise InvalidData(
        f"{table.place}: there is no {'channel' if table.topic else 'column'} {name[:60]!r}"
        f"{' for the time' if word == 'time' else ''}; there are "
        f"{', '.join(map(repr, there[:30]))[:600] or 'none'}{nearest(name, there)}"
    )
