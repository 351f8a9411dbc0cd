"""Signals of a log's channels on common times, and how alike two of them are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from loose_env.importing.names import Meaning
from loose_env.importing.resampling import median_step, smoothed
from loose_env.importing.samples import ChannelKey, Samples
from loose_env.typing import Array

MOST_ROWS = 8192
"""Samples compared of a run, where it moves most; at 1 kHz, 8 s."""
LONGEST_LAG = 0.5
"""Largest delay searched between a command and the motion that follows it [s]."""
K = TypeVar("K")
_WIDTH, _SMOOTHED_S = 5, 0.02
"""Samples, and time at least [s], over which a signal is averaged before it is differentiated or
compared with a rate: arms move below 10 Hz."""
_FALLS = 5.0
"""Factor by which the largest jump falls where values were wrapped around or had a sign bit."""
_PERIODS = (2 * np.pi, 360.0, *(float(2**b) for b in (8, 10, 12, 13, 14, 16, 17, 20, 24, 32)))
_TURNS = ("rev", "turn", "turns")
_SIGN_BITS = (10, 11, 15, 31)
SIZES = (1.0, 180 / math.pi, math.pi / 180, 30 / math.pi, 1 / 6, 60.0)
"""Ratios of a velocity to the derivative of a position, in all their units."""
_TOLD = 0.2
"""Most that a size in no unit speaks against a velocity [1]."""


@dataclass(eq=False, kw_only=True)
class Signal:
    """A channel with its values on the common times of each run."""

    source: str
    key: ChannelKey
    unit: str
    """Unit that the file or the name states; "" for none."""
    meaning: Meaning
    runs: list[Array]
    """Values of each run, each of shape (T,); empty where the run lacks the channel."""
    step: float
    """Time between rows [s]."""
    period: float | None = None
    """Period at which the values wrapped around, which is undone in ``runs``."""
    sign_bit: int | None = None
    whole: bool = False
    """True if all values are whole numbers."""
    sort: int = 0
    """Place among the channels of the log."""
    defined: bool = False
    """True if the format defines radians, and N·m."""
    why: str = ""
    """Reason for which it has no values."""

    @cached_property
    def values(self) -> Array:
        """Values of all runs in a row."""
        return np.concatenate(self.runs) if self.runs else np.empty(0)

    def averaged(self, seconds: float) -> Array:
        """Values of all runs in a row, each a mean over so long about it."""
        width = max(1, round(seconds / self.step))
        return np.concatenate([smoothed(v, min(width, len(v))) for v in self.runs if len(v)])

    @cached_property
    def moves(self) -> bool:
        """True if it changes by more than the rounding of its values in some run."""
        scale = max(float(np.max(np.abs(self.values))), 1e-9) if self.values.size else 1.0
        return any(len(v) and float(np.ptp(v)) > 1e-6 * scale for v in self.runs)

    @cached_property
    def ends(self) -> Array:
        """Smallest and largest value, shape (2,)."""
        return np.array([np.min(self.values), np.max(self.values)])

    @cached_property
    def smooth(self) -> list[Array]:
        """Averages of the runs over some samples."""
        return [_averaged(v, self.step) for v in self.runs]

    @cached_property
    def rates(self) -> list[Array]:
        """Derivatives of the runs."""
        return [derivative(v, self.step) for v in self.runs]

    @cached_property
    def compared(self) -> tuple[list[Array], list[Array]]:
        """The same and the averages, about the means of their runs."""
        return _centred(self.rates), _centred(self.smooth)


class Likeness(NamedTuple):
    """Best correlation of two signals over their delay."""

    correlation: float
    """From -1 to 1."""
    lag: float
    """Delay of the second behind the first [s]."""


def dry_friction(speed: Array) -> Array:
    """Direction of dry friction; at a tenth of the rms speed it has 76 % of its size."""
    return np.tanh(speed / (0.1 * np.std(speed) + 1e-12))


class Agreement(NamedTuple):
    """What there is of what the model predicts for a motion in the channels of a witness."""

    whole: float = 0.0
    """Correlation with it and what acts beside it: friction, or another mount of a sensor [1]."""
    alone: float = 0.0
    """Correlation with it as the model has it; negative if reversed [1]."""
    per: float = 0.0
    """Predicted SI units for each of the channels' units."""


def torque_in(
    channel: Sequence[Array], needed: Sequence[Array], rates: Sequence[Array]
) -> Agreement:
    """What there is of a torque in a channel, by the torque needed for the motion and its speed.

    Friction is viscous and dry: ``whole`` is negative where load or friction is reversed.
    """
    load, own, speed, dry = _rows(needed, channel, rates, [dry_friction(v) for v in rates])
    if np.std(own) == 0 or np.std(load) == 0:
        return Agreement()
    beside = np.stack([speed, dry], axis=1)
    columns = np.column_stack([load, beside])
    share = np.linalg.lstsq(columns, own, rcond=None)[0]
    fitted, friction = columns @ share, beside @ share[1:]
    alone, whole = (
        float(np.corrcoef(each, own)[0, 1]) if np.std(each) > 0 else 0.0 for each in (load, fitted)
    )
    # The load, and friction, which acts with the motion, have the sign of the larger one.
    larger = np.std(load) * abs(share[0]) > np.std(friction)
    sign = float(share[0]) if larger else float(np.mean(friction * speed))
    size = abs(share[0]) if share[0] * alone > 0 else np.std(own) / np.std(load) * abs(alone)
    return Agreement(math.copysign(whole, sign), alone, float(1 / size) if size > 0 else 0.0)


def sensed_in(
    places: Iterable[int], axes: Sequence[Sequence[Array]], readings: Sequence[Sequence[Array]]
) -> Agreement:
    """What there is of a tool sensor in channels of its axes, by what the model reads there.

    ``places`` are those of the channels among the readings; a mount mixes all readings.
    """
    rows = _rows(*readings, *axes)
    read, own = rows[: len(readings)].T, rows[len(readings) :].T
    same = read[:, [*places]]
    if not own.any() or not same.any():
        return Agreement()
    fitted = read @ np.linalg.lstsq(read, own, rcond=None)[0]
    whole = np.linalg.norm(fitted) / np.linalg.norm(own)
    alone = np.sum(same * own) / np.linalg.norm(same) / np.linalg.norm(own)
    per = np.linalg.norm(same) / (np.linalg.norm(fitted) + 1e-12)
    return Agreement(float(whole), float(alone), float(per))


def _rows(few: Sequence[Array], *others: Sequence[Array]) -> Array:
    """Signals about their means, at every so many rows as the first has."""
    rows = []
    for first, *own in zip(few, *others, strict=True):
        every = max(1, round(len(own[0]) / len(first))) if len(first) else 1
        parts = [first, *(v[::every] if len(v) > len(first) else v for v in own)]
        if len(first) > 3 and {len(part) for part in parts} == {len(first)}:
            rows.append(np.stack(parts))
    whole = np.concatenate(rows, axis=1) if rows else np.zeros((1 + len(others), 1))
    return np.asarray(whole - whole.mean(axis=1, keepdims=True))


def derivative(values: Array, step: float) -> Array:
    """Rate of a smoothed signal, shape (T,)."""
    if len(values) < 2:
        return np.zeros(len(values))
    return np.asarray(np.gradient(_averaged(values, step), step))


def _averaged(values: Array, step: float) -> Array:
    width = max(_WIDTH, round(_SMOOTHED_S / step))
    return smoothed(values, width) if len(values) else values


def slope(first: Sequence[Array], second: Sequence[Array]) -> float:
    """Signed ratio of the spread of a second signal to that of the first."""
    return ratio_of(*_products(_centred(first), _centred(second)))[0]


def ratio_of(product: float, one: float, two: float) -> tuple[float, float]:
    """Signed ratio of a second signal to a first one, and correlation, by their squares."""
    if one <= 0 or two <= 0:
        return 0.0, 0.0
    return math.copysign(math.sqrt(two / one), product), product / math.sqrt(one * two)


def _centred(runs: Sequence[Array]) -> list[Array]:
    return [v - v.mean() if len(v) else v for v in runs]


def _products(first: Sequence[Array], second: Sequence[Array]) -> tuple[float, float, float]:
    """Product of two signals, and square of each, over the runs that both have."""
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if len(a) == len(b)]
    return tuple(float(sum(x @ y for x, y in each)) for each in (  # type: ignore[return-value]
        pairs, [(a, a) for a, _ in pairs], [(b, b) for _, b in pairs]))  # fmt: skip


def likeness(first: Sequence[Array], second: Sequence[Array], step: float) -> Likeness:
    """Correlate two signals over delays of the second from -0.5 to 0.5 s; the best in size."""
    most = round(LONGEST_LAG / step)
    longest = max((len(v) for v in first), default=0)
    most = min(most, longest // 2)
    total, powers = np.zeros(2 * most + 1), np.zeros(2)
    for a, b in zip(first, second, strict=True):
        if not len(a) or len(a) != len(b):
            continue
        one, two = a - a.mean(), b - b.mean()
        size = 1 << (len(a) + most).bit_length()
        whole = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(two, size), size)
        total += np.concatenate([whole[size - most :], whole[: most + 1]])
        powers += (one @ one, two @ two)
    scale = float(np.sqrt(powers[0] * powers[1]))
    if scale <= 0:
        return Likeness(0.0, 0.0)
    total /= scale
    best = int(np.argmax(np.abs(total)))
    exact = float(best)
    if 0 < best < len(total) - 1:
        left, here, right = np.abs(total[best - 1 : best + 2])
        bend = left - 2 * here + right
        exact += float(0.5 * (left - right) / bend) if bend < 0 else 0.0
    return Likeness(float(np.clip(total[best], -1, 1)), (exact - most) * step)


def speed_in(position: Signal, s: Signal) -> float:
    """Correlation of a channel with the derivative of a position, negative if reversed.

    Less what its size is off those of all units, where none is stated.
    """
    ratio, value = ratio_of(*_products(position.compared[0], s.compared[1]))
    off = 0.0 if s.unit else min(abs(math.log(max(abs(ratio), 1e-12) / each)) for each in SIZES)
    return math.copysign(max(abs(value) - min(off, _TOLD), 0.0), value)


def decoded(values: Array, period: float | None, sign_bit: int | None) -> Array:
    """Values without their wrap-around and without a bit for their sign.

    Examples
    --------
    >>> decoded(np.array([358.0, 359.0, 0.0, 1.0]), 360, None).tolist()
    [-2.0, -1.0, 0.0, 1.0]
    >>> decoded(np.array([32769.0, 2.0]), None, 15).tolist()
    [-1.0, 2.0]
    """
    if sign_bit is not None:
        high = float(2**sign_bit)
        values = np.where(values >= high, high - values, values)
    if period is not None and len(values):
        values = np.unwrap(values, period=period)
        values = values - period * np.round(values[0] / period)
    return values


def coding_of(values: Array, unit: str = "") -> tuple[float | None, int | None]:
    """Period at which values wrap around, and bit that holds their sign; None for neither.

    Examples
    --------
    >>> turns = np.linspace(0, 30, 500)
    >>> coding_of(np.degrees(turns) % 360), coding_of(turns)
    ((360.0, None), (None, None))
    """
    jump = _jump(values)
    spread = float(np.ptp(values)) if values.size else 0.0
    if jump < 0.5 * spread or spread == 0:
        return None, None
    tried: list[tuple[float | None, int | None]] = [
        (period, None)
        for period in (*_PERIODS, *[1.0] * (unit in _TURNS))
        if 0.5 * period < spread <= 1.001 * period and jump > 0.5 * period
    ]
    if np.min(values) >= 0 and np.all(values == np.round(values)):
        tried += [(None, bit) for bit in _SIGN_BITS if 2**bit <= np.max(values) < 2 ** (bit + 1)]
    left = {each: _jump(decoded(values, *each)) for each in tried}
    best = min(left, key=lambda each: left[each], default=(None, None))
    return best if tried and left[best] < jump / _FALLS else (None, None)


def _jump(values: Array) -> float:
    steps = np.diff(values)
    return float(max(steps.max(), -steps.min())) if steps.size else 0.0


def on_one_base(samples: Mapping[K, Samples]) -> tuple[float, dict[K, Array]]:
    """Channels of one run at the times that all of them have, where they move most."""
    origin = min((each.origin_ns for each in samples.values()), default=0)
    clocks = {(id(s.time), s.origin_ns): s.since(origin) for s in samples.values()}
    times = {key: clocks[id(s.time), s.origin_ns] for key, s in samples.items()}
    if not times:
        return 1.0, {}
    first, last = np.median([[t[0], t[-1]] for t in times.values()], axis=0)
    # A channel that speaks of less than half of the others' time is no part of the motion.
    kept = {k: t for k, t in times.items()
            if min(t[-1], last) - max(t[0], first) > 0.5 * (last - first)}  # fmt: skip
    start = max((t[0] for t in kept.values()), default=0.0)
    stop = min((t[-1] for t in kept.values()), default=0.0)
    step = min((median_step(t) for t in {id(t): t for t in kept.values()}.values()), default=1.0)
    rows = int((stop - start) / step + 1e-6) + 1 if stop > start else 0
    if rows < 10:
        return step, {}
    base = start + step * np.arange(rows)
    if rows > MOST_ROWS:  # the piece is looked for by every so many rows
        every = -(-rows // MOST_ROWS)
        effort = np.zeros(len(base[::every]) - 1)
        for k, t in kept.items():
            v = np.interp(base[::every], t, samples[k].values)
            effort += np.abs(np.diff(v)) / (np.ptp(v) or 1.0)
        total = np.cumsum(np.insert(effort, 0, 0.0))
        width = MOST_ROWS // every
        most = every * int(np.argmax(total[width:] - total[:-width]))
        base = base[min(most, rows - MOST_ROWS) :][:MOST_ROWS]
    return step, {k: np.interp(base, t, samples[k].values) for k, t in kept.items()}
