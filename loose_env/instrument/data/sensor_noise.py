"""Noise variance by sensor and spectral line, mask of usable lines, and quantisation step.

A sensor that is slower than the run's rows, such as an encoder read at 125 Hz beside an
accelerometer at 1 kHz, is empty above half its own rate. That emptiness is neither its noise nor a
joint at rest: lines up there are not read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.model.readings import Reading
from loose_env.instrument.settings.thresholds import (
    STOPBAND_POWER,
    STOPBAND_POWER_AT_EDGE,
    STOPBAND_START,
)
from loose_env.typing import Array

_TALLER = 1.16
"""Upper over lower end of the parts of a spectrum in which an end is looked for [1]."""
_NEAR = (0.7, 1.2)
"""Ends over that of the excited band that may be the band's own [1]."""
_FOLDS: dict[str, int] = {"position": 4, "velocity": 2}
"""Power of the frequency with which the readings of joints fall."""
_DEAF = 1e6
"""Variance of a reading that is not there, over the largest power of it."""
_MARGIN = 1.15
_ROUNDING = 1e-9
"""Difference of two readings over the largest that is rounding of the file's numbers [1]."""
_DISTINCT = 0.5
"""Share of different readings from which a channel is not quantised [1]."""
_REGULAR = 0.05
"""Deviation of a difference from a whole multiple of the step [steps], and share of such [1]."""
_PARTS = 12


def sensor_noise(
    power: Array,
    smooth: Array,
    rows: Sequence[tuple[Reading, int]],
    frequency: Array,
    excited: NDArray[np.intp],
    *,
    lowest: float,
    highest: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Noise variance of each sensor per spectral line, and mask of usable lines.

    The floor of a reading is the lowest level that any part of its spectrum has: the noise of the
    sensors in use is white in what they read. A reading that ends below the rows' half rate gets
    its floor from below that end, and what its own slow samples fold back beside it.
    """
    parts = _parts(frequency, lowest, highest)
    edge = float(frequency[excited[-1]])
    levels = np.array([[_level(column[part]) for part in parts] for column in power.T])
    inside = np.array([bool(np.isin(excited, part).any()) for part in parts])
    centres = np.array([float(frequency[part[-1]]) for part in parts])
    sites = [k for k, (r, _) in enumerate(rows) if r.kind == "acceleration"]
    heard = levels[sites].sum(axis=0) if sites else None
    ends: dict[str, tuple[float, float]] = {}
    for k, (r, _) in enumerate(rows):
        beside = None if r.on_site else heard
        own = _end(levels[k], centres, inside, edge, beside)
        ends[r.sensor] = min(own, ends.get(r.sensor, (np.inf, np.inf)))
    noise, read = np.zeros_like(power), np.ones(power.shape, dtype=bool)
    for k, (r, _) in enumerate(rows):
        end, half = ends[r.sensor]
        top = min(end, highest)
        noise[:, k] = _floor(power[(frequency > lowest) & (frequency < top), k], power[:, k])
        if np.isfinite(end):
            if r.kind in _FOLDS:
                # Encoders are read without a filter: what is beyond half their rate is mirrored.
                mirror = frequency / np.maximum(2 * half - frequency, 1e-9)
                noise[:, k] += np.minimum(mirror, 1.0) ** _FOLDS[r.kind] * smooth[:, k]
            read[:, k] = frequency <= end
            noise[~read[:, k], k] = _DEAF * float(power[:, k].max())
    return np.maximum(noise, 1e-30), read


def quantum(values: Array) -> float:
    """Step in which a channel's readings are quantised, in their unit; 0 if none is seen.

    Rounding adds a variance of a twelfth of its square, which no quiet part of a spectrum shows
    where the motion is of the order of the step.

    Examples
    --------
    >>> angle = 0.3 * np.sin(np.arange(1000) / 50)
    >>> round(quantum(np.round(angle / 0.01) * 0.01), 6), quantum(angle)
    (0.01, 0.0)
    """
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    steps = steps[steps > _ROUNDING * largest]  # the same step, but for the last digits
    if not len(steps) or len(steps) > _DISTINCT * len(values):
        return 0.0
    smallest = float(steps.min())
    multiple = steps / smallest
    regular = float(np.mean(np.abs(multiple - np.round(multiple)) < _REGULAR))
    return smallest if regular > 1 - _REGULAR else 0.0


def _parts(frequency: Array, lowest: float, highest: float) -> list[NDArray[np.intp]]:
    """Spectral lines split into bands of equal ratio, at least four lines each."""
    found: list[NDArray[np.intp]] = []
    low = lowest
    while low < highest:
        high = low
        part = np.zeros(0, dtype=np.intp)
        while len(part) < 4 and high < highest:
            high *= _TALLER
            part = np.flatnonzero((frequency > low) & (frequency <= min(high, highest)))
        if len(part) >= 4:
            found.append(part)
        low = high
    return found


def _end(
    levels: Array,
    tops: Array,
    inside: NDArray[np.bool_],
    edge: float,
    beside: Array | None,
) -> tuple[float, float]:
    """Bandwidth and Nyquist frequency of a channel [Hz]; infinite if unlimited.

    Where the excited band ends, readings fall too, by as much as they stand above their noise.
    There a joint's sensor has to fall by far more than the accelerometers do; and an end of an
    accelerometer is looked for within the band alone.
    """
    best, end, half = 1.0, np.inf, np.inf
    for k, top in enumerate(tops[:-1]):
        beyond = tops > STOPBAND_START * top
        if top < _NEAR[0] * edge:
            beyond &= inside
        elif beside is None:
            continue
        if not beyond.any():
            continue
        left = float(levels[beyond].max() / max(levels[: k + 1].min(), 1e-300))
        allowed = STOPBAND_POWER
        if _NEAR[0] * edge <= top < _NEAR[1] * edge and beside is not None:
            left /= float(beside[beyond].max() / max(beside[: k + 1].min(), 1e-300))
            allowed = STOPBAND_POWER_AT_EDGE
        if left < allowed:
            end = min(end, float(top))
            if left / allowed < best:
                best, half = left / allowed, float(top)
    return end, half


def _level(power: Array) -> float:
    """Mean noise power from the median, which is 0.69 of it for chi-squared powers."""
    return float(np.median(power) / np.log(2))


def _floor(inside: Array, whole: Array) -> float:
    levels = [_level(part) for part in np.array_split(inside, _PARTS) if len(part) >= 4]
    return _MARGIN * (min(levels) if levels else float(whole.min()))
