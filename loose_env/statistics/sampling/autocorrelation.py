"""Integrated autocorrelation time and long-run variance of dependent samples.

Covariance of the means of several dependent series.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from loose_env.typing import Array


class Memory(NamedTuple):
    """Autocorrelation of a series and its effect on the scatter of the mean."""

    block: float
    """Length of bootstrap blocks that suits the series, samples."""
    variance: float
    """Variance of the mean times the number of samples (long-run variance)."""
    degrees: float
    """Degrees of freedom of that variance."""
    reach: float
    """Share of the variance that resampling in blocks of this length reaches, 0 to 1."""


def memory_of(series: Array, block: float | None = None) -> Memory:
    """Estimate the integrated autocorrelation time of a series.

    The autocovariance is summed with flat-top weights up to twice the last significant lag, which
    hardly bends the variance, or with falling weights over one block (Newey and West), which
    cannot fall below zero, whichever is larger. Blocks cut the same memory as falling weights do.

    Parameters
    ----------
    series : array, shape (N,)
        Series of mean zero.
    block : float, optional
        Length of a block, samples; by default the rule of Politis and White for circular blocks.

    Returns
    -------
    Memory
        Block length, long-run variance, its degrees of freedom, and the share blocks reach.

    References
    ----------
    Newey and West, Econometrica 55 (1987); Politis and White, Econometric Reviews 23 (2004);
    Patton, Politis and White, Econometric Reviews 28 (2009).
    """
    count = len(series)
    transform = np.fft.rfft(series - series.mean(), 2 * count)
    covariance = np.fft.irfft(transform.real**2 + transform.imag**2)[:count] / count
    window = memory_window(covariance)
    lag = np.arange(1, window + 1)
    weight = np.minimum(1.0, 2 * (1 - lag / window))
    level = float(covariance[0] + 2 * np.sum(weight * covariance[lag]))
    if block is None:
        slope = float(2 * np.sum(weight * lag * covariance[lag]))
        longest = min(3 * math.sqrt(count), count / 3)
        best = (1.5 * (slope / level) ** 2 * count) ** (1 / 3) if level > 0.0 else longest
        block = min(max(best, 1.0), longest)
    lag = np.arange(1, min(math.ceil(block), count))
    within = float(covariance[0] + 2 * np.sum((1 - lag / block) * covariance[lag]))
    variance = max(within, level)
    # The integral of the squared weights, 4/3 of the window or 2/3 of the block, sets the scatter.
    degrees = count / max(4 / 3 * window, 2 / 3 * block)
    return Memory(block, variance, degrees, within / variance if variance > 0.0 else 1.0)


def memory_window(covariance: Array) -> int:
    """Return twice the lag after which a run of autocovariances is insignificant."""
    count = len(covariance)
    # The published run of 5 lags is shorter than one period of a narrow-band record.
    run = max(5, math.ceil(0.5 * math.sqrt(count)))
    most = max(min(math.ceil(3 * math.sqrt(count)) + run, count // 2), 1)
    bound = 2 * math.sqrt(math.log10(count) / count) * covariance[0]
    last = 0
    for lag in np.flatnonzero(np.abs(covariance[1 : most + 1]) >= bound).tolist():
        if lag + 1 - last > run:
            break
        last = lag + 1
    return int(min(2 * max(last, 1), most))
