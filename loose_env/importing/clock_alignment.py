"""Offset between two clocks by two channels of one motion, and jittered stamps put on a line.

A stamp is its sample's number times the step, and an error that comes and goes. A sample that is
missing moves all stamps behind it by one step for good. Numbers are given first, then the line is
fitted; a line through stamps of wrong numbers would be bent by every missing sample.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import signal

from loose_env.errors import InvalidData
from loose_env.importing.resampling import bridged, median_step, resampled
from loose_env.typing import Array

_MOST_POINTS = 2**24
_LEAST_OVERLAP = 0.3
"""Share of the shorter channel that has to lie beside the other."""
_RIVAL = 0.95
"""A second peak this high leaves the shift open."""


_OFF = 3.0
"""Steps that a stamp may be off the straight line through them."""
_PLAIN = 0.3
"""Share of a step by which pauses between stamps may be off whole steps to be plain."""
_SHIFT = 0.5
"""Steps by which stamps have to move for good for samples to be missing."""
_SURE = 0.3
"""Share of a step by which such a move may be off whole steps."""
_BESIDE = 50
"""Most samples on either side of a place by which a move is judged."""
_LEAST = 10
"""Least samples there."""
_MOST = 200
"""Most places at which samples may be missing where stamps jitter."""


class Shift(NamedTuple):
    """A shift [s] to add to the own channel's times, and the correlation that is left with it."""

    seconds: float
    correlation: float


def shift_between(
    place: str,
    own: tuple[Array, Array],
    other: tuple[Array, Array],
    *,
    most_s: float,
    band_hz: tuple[float, float] | None = None,
    sign: int = 1,
    least: float = 0.6,
) -> Shift:
    """Find the shift at which two channels agree best.

    Both are brought to one grid at the faster one's rate and to the band that both have; the
    correlation is taken at every shift over what overlaps, and its peak read off by a parabola.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(4000) / 1000
    >>> motion = signal.sosfilt(signal.butter(4, 50, fs=1000, output="sos"), rng.normal(size=4000))
    >>> found = shift_between("here", (t - 0.2, motion), (t, motion), most_s=1.0)
    >>> round(found.seconds, 6)
    0.2
    """
    step = min(median_step(own[0]), median_step(other[0]))
    top = 0.4 / max(median_step(own[0]), median_step(other[0]))
    low, high = band_hz if band_hz is not None else (0.0, top)
    high = min(high, top)
    if low >= high:
        raise InvalidData(f"{place}: the band starts at {low:g} Hz, and both reach {top:.3g} Hz")
    first = min(own[0][0], other[0][0] - most_s)
    last = max(own[0][-1], other[0][-1] + most_s)
    count = (last - first) / step
    if count > _MOST_POINTS:
        raise InvalidData(
            f"{place}: {count:.3g} samples would be compared; at most {_MOST_POINTS}. The sources "
            "may not count from the same date: give from_start = true or offset_s"
        )
    mine, mine_there = _on_grid(own, step, (low, high))
    theirs, theirs_there = _on_grid(other, step, (low, high))
    begin = (other[0][0] - own[0][0]) / step  # shift that puts both first samples together
    correlate = partial(signal.correlate, method="fft")  # over the overlap at each lag alone
    overlap = correlate(theirs_there, mine_there)
    powers = correlate(theirs_there, mine**2), correlate(theirs**2, mine_there)
    size = np.sqrt(np.maximum(powers[0], 0) * np.maximum(powers[1], 0))
    floor = 1e-9 * (np.sum(mine**2) * np.sum(theirs**2)) ** 0.5 + 1e-300
    scores = correlate(theirs, mine) / np.maximum(size, floor)
    seconds = (begin + signal.correlation_lags(len(theirs), len(mine))) * step
    least_overlap = _LEAST_OVERLAP * min(mine_there.sum(), theirs_there.sum())
    allowed = (np.abs(seconds) <= most_s) & (overlap >= least_overlap)
    if not allowed.any():
        raise InvalidData(
            f"{place}: with shifts up to {most_s:g} s the two channels hardly overlap: one has "
            f"{own[0][0]:.3f} to {own[0][-1]:.3f} s, the other {other[0][0]:.3f} to "
            f"{other[0][-1]:.3f} s; raise most_s, or set offset_s or from_start first"
        )
    scores = np.where(allowed, sign * scores, -np.inf)
    best = int(np.argmax(scores))
    if scores[best] < least:
        raise InvalidData(
            f"{place}: the channels agree at no shift up to {most_s:g} s: the best correlation is "
            f"{scores[best]:.2f} (at {seconds[best]:+.4f} s), and {least:g} is asked for; is it "
            "the same motion, the right sign and band?"
        )
    _refuse_rival(place, scores, seconds, best)
    exact = float(seconds[best])
    if 0 < best < len(scores) - 1 and np.isfinite(scores[[best - 1, best + 1]]).all():
        left, here, right = scores[best - 1 : best + 2]
        bend = left - 2 * here + right
        if bend < 0:
            exact += float(0.5 * (left - right) / bend) * step
    return Shift(exact, float(scores[best]))


def _on_grid(
    channel: tuple[Array, Array], step: float, band: tuple[float, float]
) -> tuple[Array, Array]:
    """A channel on an even grid from its first sample, its band alone, and where it is there."""
    time, values = channel
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
    on_grid = resampled(time, values, grid, bridged(time, None)).values
    there = np.isfinite(on_grid)
    filled = np.where(there, on_grid, np.mean(values))
    filled = signal.detrend(filled)
    half = 0.5 / step
    low, high = band
    if low > 0 or high < 0.99 * half:
        kind = ("bandpass", (low, min(high, 0.99 * half))) if low > 0 else ("lowpass", high)
        sos = signal.butter(4, kind[1], btype=kind[0], fs=2 * half, output="sos")
        filled = signal.sosfiltfilt(sos, filled, padlen=min(len(filled) - 1, 1000))
    return np.where(there, filled, 0.0), there.astype(np.float64)


def _refuse_rival(place: str, scores: Array, seconds: Array, best: int) -> None:
    """Refuse a shift beside which another does as well, as in a motion that repeats itself."""
    peak = scores[best]
    left = right = best
    while left > 0 and scores[left - 1] > 0.5 * peak:
        left -= 1
    while right < len(scores) - 1 and scores[right + 1] > 0.5 * peak:
        right += 1
    others = np.concatenate([scores[:left], scores[right + 1 :]])
    if len(others) and others.max() > _RIVAL * peak:
        where = np.concatenate([seconds[:left], seconds[right + 1 :]])[int(np.argmax(others))]
        raise InvalidData(
            f"{place}: the shift is not clear: {seconds[best]:+.4f} s and {where:+.4f} s agree "
            f"about as well ({peak:.3f} and {others.max():.3f}); the motion repeats itself. Lower "
            "most_s, or use channels with random motion"
        )


# ------------------------------------------------------------------------- even stamps


def straightened(place: str, time: Array) -> Array:
    """Stamps on the straight line through them, in the place of those that jitter about it.

    Examples
    --------
    >>> stamps = np.array([0.0, 0.011, 0.019, 0.03, 0.051, 0.059, 0.07, 0.081])
    >>> straightened("log.csv: x", stamps).round(3).tolist()
    [0.0, 0.01, 0.02, 0.03, 0.05, 0.06, 0.07, 0.08]
    """
    number = _plainly(time)
    if number is None:
        number = np.arange(len(time), dtype=float)
        for _ in range(_MOST):
            where, steps = _moved(number, time)
            if where == 0:
                break
            number[where:] += steps
        else:
            raise InvalidData(
                f"{place}: even = true, but at more than {_MOST} places stamps move by a step and "
                "more for good; leave even out"
            )
        where, steps = _moved(number, time, whole=False)
        if where:
            raise InvalidData(
                f"{place}: even = true, but at sample {where + 1} the stamps move by {steps:+.2f} "
                "steps for good: whether samples are missing there cannot be told; leave even out"
            )
    line = _line(number, time)
    off = np.abs(time - line)
    step = median_step(time)
    if off.max() > _OFF * step:
        i = int(np.argmax(off))
        raise InvalidData(
            f"{place}: even = true, but sample {i + 1} is {off[i]:.4g} s off the straight line "
            f"through the stamps, {off[i] / step:.0f} steps; leave even out"
        )
    return line


def _line(number: Array, time: Array) -> Array:
    slope, start = np.polyfit(number, time, 1)
    return np.asarray(start + slope * number)


def _plainly(time: Array) -> Array | None:
    """Numbers of the samples where every pause is plainly a whole number of steps; else None."""
    pauses = np.diff(time) / median_step(time)
    whole = np.round(pauses)
    if whole.min() < 1 or np.abs(pauses - whole).max() > _PLAIN:
        return None
    number = np.concatenate([[0.0], np.cumsum(whole)])
    # Clocks that wander add up: the numbers have to lie along the line too.
    off = time - _line(number, time)
    return number if np.abs(off).max() < _SHIFT * median_step(time) else None


def _moved(number: Array, time: Array, *, whole: bool = True) -> tuple[int, float]:
    """Sample from which stamps are later for good by the most, and by how many steps.

    0 where none are. Means of the stamps before and behind each place are compared, so that single
    late ones do not count. With ``whole``, moves that are no whole number of steps onwards are
    passed over.
    """
    count = len(time)
    slope = float(np.polyfit(number, time, 1)[0])
    off = (time - slope * number) / slope
    total = np.concatenate([[0.0], np.cumsum(off - off[0])])
    at = np.arange(count)
    before, behind = np.minimum(at, _BESIDE), np.minimum(count - at, _BESIDE)
    judged = at[(before >= _LEAST) & (behind >= _LEAST)]
    if not len(judged):
        return 0, 0.0
    low, high = judged - before[judged], judged + behind[judged]
    later = (total[high] - total[judged]) / behind[judged]
    earlier = (total[judged] - total[low]) / before[judged]
    move = later - earlier
    wanted = np.abs(move) > _SHIFT
    if whole:
        wanted &= (np.round(move) >= 1) & (np.abs(move - np.round(move)) <= _SURE)
    if not wanted.any():
        return 0, 0.0
    best = int(np.argmax(np.where(wanted, np.abs(move), -1.0)))
    if whole:
        return int(judged[best]), float(np.round(move[best]))
    return int(judged[best]), float(move[best])
