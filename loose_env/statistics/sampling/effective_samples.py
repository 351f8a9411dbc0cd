"""Effective sample size of a record."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_record, require_finite


def effective_samples(x: ArrayLike, u: ArrayLike) -> float:
    """Effective sample size for the covariance cov(x, u).

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
    transform = np.fft.rfft(both - both.mean(axis=1, keepdims=True))
    half = transform.real**2 + transform.imag**2
    # The other side of the two-sided spectrum mirrors this one without its ends.
    mirrored = half[:, (both.shape[1] - 1) // 2 : 0 : -1]
    power_x, power_u = np.concatenate((half, mirrored), axis=1)
    # A neighbouring bin in place of the same one: two raw periodograms of correlated signals
    # scatter together in a bin, which would count the overlap up to twice.
    beside = 0.5 * (np.roll(power_u, 1) + np.roll(power_u, -1))
    overlap = float(np.sum(power_x * beside))
    total = float(np.sum(power_x)) * float(np.sum(power_u))
    return total / overlap if overlap > 0.0 else math.inf
