"""How many independent samples a record is worth."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import FloatArray, as_record, require_finite


def effective_samples(x: ArrayLike, u: ArrayLike) -> float:
    """Number of independent samples with the same scatter of cov(x, u).

    N_eff = T int(Sx) int(Su) / int(Sx Su) over two-sided spectra, for x and u uncorrelated.
    About 2 * bandwidth * time for flat spectra in one band, far fewer near a resonance, and
    N for white noise.

    Parameters
    ----------
    x, u : array, shape (N,)
        Signals of any unit, sampled together.

    Returns
    -------
    float
        Effective number; infinite when the signals share no frequency.

    Raises
    ------
    InvalidData
        If a shape is wrong, the lengths differ, a value is not finite or a signal is constant.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> white = rng.standard_normal((2, 4096))
    >>> bool(abs(effective_samples(*white) / 4096 - 1) < 0.1)
    True
    """
    first, second = as_record(x, "x"), as_record(u, "u")
    if len(first) != 1 or first.shape != second.shape:
        raise InvalidData(f"x has shape {first.shape} and u {second.shape}; both must be (N,)")
    both = np.concatenate((first, second))
    require_finite(both, "x or u")
    if (np.ptp(both, axis=1) == 0.0).any():
        raise InvalidData("x or u is constant; both must vary")
    transform = np.fft.fft(both - both.mean(axis=1, keepdims=True))
    power_x, power_u = transform.real**2 + transform.imag**2
    # A neighbouring bin in place of the same one: two raw periodograms of correlated signals
    # scatter together in a bin, which would count the overlap up to twice.
    beside = 0.5 * (np.roll(power_u, 1) + np.roll(power_u, -1))
    overlap = float(np.sum(power_x * beside))
    total = float(np.sum(power_x)) * float(np.sum(power_u))
    return total / overlap if overlap > 0.0 else math.inf


def long_run_variance(series: FloatArray, lags: float) -> float:
    """Variance of the mean of `series` times its length, by Newey and West.

    Autocovariances up to `lags` samples are summed with falling (Bartlett) weights.

    References
    ----------
    Newey and West, Econometrica 55 (1987).
    """
    covariance = _autocovariance(series)
    lag = np.arange(1, min(math.ceil(lags), len(series)))
    return float(covariance[0] + 2 * np.sum((1 - lag / lags) * covariance[lag]))


def block_length(series: FloatArray) -> float:
    """Length of bootstrap blocks, in samples, that suits the memory of `series`.

    The rule of Politis and White for circular blocks: the autocovariance is summed up to twice
    the lag after which none is significant.

    References
    ----------
    Politis and White, Econometric Reviews 23 (2004); Patton, Politis and White, 28 (2009).
    """
    count = len(series)
    covariance = _autocovariance(series)
    # The published run of 5 lags is shorter than one period of a narrow-band record.
    run = max(5, math.ceil(0.5 * math.sqrt(count)))
    most = min(math.ceil(math.sqrt(count)) + run, count - 1)
    significant = np.abs(covariance[1 : most + 1]) >= (
        2 * math.sqrt(math.log10(count) / count) * covariance[0]
    )
    last = 0
    for lag in np.flatnonzero(significant) + 1:
        if lag - last > run:
            break
        last = int(lag)
    window = min(2 * max(last, 1), most)
    lag = np.arange(1, window + 1)
    weight = np.minimum(1.0, 2 * (1 - lag / window))
    level = float(covariance[0] + 2 * np.sum(weight * covariance[lag]))
    slope = float(2 * np.sum(weight * lag * covariance[lag]))
    longest = min(3 * math.sqrt(count), count / 3)
    if level <= 0.0:
        return longest
    length = (1.5 * (slope / level) ** 2 * count) ** (1 / 3)
    return min(max(length, 1.0), longest)


def _autocovariance(series: FloatArray) -> FloatArray:
    count = len(series)
    transform = np.fft.rfft(series - series.mean(), 2 * count)
    return np.fft.irfft(transform.real**2 + transform.imag**2)[:count] / count
