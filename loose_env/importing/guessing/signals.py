"""Signals of a log on one time base, their derivatives, and correlation of two over delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from loose_env.importing.samples import Samples
from loose_env.typing import Array

MOST_ROWS = 10_000
"""Samples compared, from the beginning of a log; at 1 kHz the first 10 s of motion."""
LONGEST_LAG = 0.5
"""Largest delay searched between a command and the motion that follows it [s]."""
_SMOOTHED = 5
"""Samples over which a position is averaged before it is differentiated."""


@dataclass(frozen=True)
class Likeness:
    """Best correlation of two signals over their delay."""

    correlation: float
    """From -1 to 1."""
    lag: float
    """Delay of the second behind the first [s]."""


def on_one_base(samples: Mapping[str, Samples]) -> tuple[float, dict[str, Array]]:
    """Interpolate channels to the times that all have."""
    if not samples:
        return 1.0, {}
    origin = min(each.origin_ns for each in samples.values())
    times = {key: each.since(origin) for key, each in samples.items()}
    start = max(float(each[0]) for each in times.values())
    stop = min(float(each[-1]) for each in times.values())
    step = min(each.step for each in samples.values())
    rows = min(int((stop - start) / step + 1e-6) + 1, MOST_ROWS) if stop > start else 0
    if rows < 10:
        return step, {}
    base = start + step * np.arange(rows)
    return step, {k: np.interp(base, times[k], each.values) for k, each in samples.items()}


def moves(values: Array) -> bool:
    """Whether a signal changes by more than the rounding of its values."""
    spread = float(np.ptp(values))
    return spread > 1e-6 * max(float(np.max(np.abs(values))), 1e-9)


def derivative(values: Array, step: float) -> Array:
    """Rate of a smoothed signal, shape (T,)."""
    return np.asarray(np.gradient(ndimage.uniform_filter1d(values, _SMOOTHED), step))


def correlation(first: Array, second: Array) -> float:
    """Correlation of two signals at no delay; 0 where one does not move."""
    one, two = first - first.mean(), second - second.mean()
    scale = float(np.linalg.norm(one) * np.linalg.norm(two))
    return float(one @ two) / scale if scale > 0 else 0.0


def likeness(first: Array, second: Array, step: float) -> Likeness:
    """Correlate two signals over delays of the second from -0.5 to 0.5 s."""
    one, two = first - first.mean(), second - second.mean()
    scale = float(np.linalg.norm(one) * np.linalg.norm(two))
    if scale <= 0:
        return Likeness(0.0, 0.0)
    whole = signal.correlate(two, one, mode="full", method="fft") / scale
    middle = len(one) - 1
    most = min(round(LONGEST_LAG / step), middle // 2)
    inner = whole[middle - most : middle + most + 1]
    best = int(np.argmax(np.abs(inner)))
    return Likeness(float(np.clip(inner[best], -1, 1)), (best - most) * step)


def slope(first: Array, second: Array) -> float:
    """Signed ratio of the spread of a second signal to that of the first."""
    spread = float(np.std(first))
    sign = 1.0 if correlation(first, second) >= 0 else -1.0
    return sign * float(np.std(second)) / spread if spread > 0 else 0.0
