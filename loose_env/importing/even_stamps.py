"""Jittered time stamps of evenly spaced samples put on a straight line, across missing ones.

A stamp is its sample's number times the step, and an error that comes and goes. A sample that is
missing moves all stamps behind it by one step for good. Numbers are given first, then the line is
fitted; a line through stamps of wrong numbers would be bent by every missing sample.
"""

from __future__ import annotations

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.resampling import median_step
from loose_env.typing import Array

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
