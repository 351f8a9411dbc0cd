"""Noise floor of each channel, from the measured data alone."""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array

_WINDOW = 64
"""Samples of a window."""
_TOP = 0.6
"""Share of the band, up to half the rate, above which motion is taken to have died out."""
_MEDIAN = 0.97
"""Median of a window's figure over the standard deviation, for white noise (20,000 windows)."""


def noise_floor(values: Array) -> float:
    """Estimate the standard deviation of a channel's noise.

    It is taken from the top of the spectrum: the noise of encoders and accelerometers is nearly
    white, the machine's motion is not. The level is the median over short windows, since a few
    contain steps and impacts. It is at least the rounding error of the channel's resolution (a step
    over the root of 12).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> swing = np.sin(2 * np.pi * 2 * np.arange(4000) / 1000)
    >>> bool(abs(noise_floor(swing + rng.normal(0, 0.01, 4000)) - 0.01) < 0.001)
    True
    """
    good = np.isfinite(values)
    if good.sum() < 10:
        return float("nan")
    filled = np.interp(np.arange(len(values)), np.flatnonzero(good), values[good])
    white = float(np.median(_tops(filled))) / _gain(good)
    return max(white, resolution_of(values) / float(np.sqrt(12)), 1e-12)


def _gain(good: Array) -> float:
    """Median of a window's figure over the standard deviation, where some samples are read (T,).

    Interpolation across missing samples smooths the noise: white noise tells by how much.
    """
    if good.all():
        return _MEDIAN
    unit = np.random.default_rng(0).standard_normal(len(good))
    return float(
        np.median(_tops(np.interp(np.arange(len(good)), np.flatnonzero(good), unit[good])))
    )


def channel_floor(values: Array) -> float:
    """Noise floor as of `noise_floor`; NaN where a channel is constant throughout.

    An encoder that stays on one of its steps does not reveal its resolution.

    Examples
    --------
    >>> channel_floor(np.full(100, 0.25))
    nan
    """
    good = values[np.isfinite(values)]
    return noise_floor(values) if len(good) and np.ptp(good) > 0 else float("nan")


def _tops(values: Array) -> Array:
    """Root mean square density at the top of the spectrum, window by window."""
    change = np.diff(values, 2)
    size = min(_WINDOW, len(change))
    starts = np.arange(0, len(change) - size + 1, max(size // 2, 1))
    shape = np.hanning(size + 2)[1:-1]
    power = np.abs(np.fft.rfft(change[starts[:, None] + np.arange(size)] * shape, axis=1)) ** 2
    power = power / np.sum(shape**2)
    angle = np.linspace(0, np.pi, power.shape[1])
    top = (angle >= _TOP * np.pi) & (angle < 0.98 * np.pi)
    # Second differences prevent leakage from low frequencies; their gain is divided out again.
    level = power[:, top] / (2 - 2 * np.cos(angle[top])) ** 2
    return np.asarray(np.sqrt(np.mean(level, axis=1)))


def resolution_of(values: Array) -> float:
    """Resolution of a rounded channel; 0 if it was not rounded.

    Examples
    --------
    >>> float(round(resolution_of(np.round(np.linspace(0, 1, 500) / 0.01) * 0.01), 6))
    0.01
    """
    good = values[np.isfinite(values)]
    levels = np.unique(good)
    if len(levels) < 2 or len(levels) > 0.5 * len(good):
        return 0.0
    gaps = np.diff(levels)
    step = float(np.min(gaps[gaps > 1e-6 * np.median(gaps)]))
    ratio = gaps / step
    return step if np.mean(np.abs(ratio - np.round(ratio)) < 0.05) > 0.9 else 0.0
