"""Tempering from the prior to the posterior: step size and resampling.

References
----------
P. Del Moral, A. Doucet, A. Jasra, "An adaptive sequential Monte Carlo method for approximate
Bayesian computation", Statistics and Computing 22, 2012.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.typing import Array

__all__ = ["next_power", "resampled"]

_TINY_STEP = 1e-9
"""Least step of the power: particles so far apart that none is left are told apart anyway."""


def next_power(values: Array, power: float, share: float) -> float:
    """Find the power at which a share of the particles that have any likelihood is left.

    Parameters
    ----------
    values : ndarray (N,)
        Log likelihood, -inf where there is none.
    power : float
        The power reached, 0 to 1.
    share : float
        Effective number of particles that the step leaves, over those with any likelihood.

    Returns
    -------
    float
        The next power, 1 at most.

    Examples
    --------
    >>> next_power(np.zeros(4), 0.0, 0.5)
    1.0
    >>> 0 < next_power(np.array([0.0, -50.0, -50.0, -50.0]), 0.0, 0.5) < 0.1
    True
    """
    alive = values[np.isfinite(values)]
    if not len(alive):
        return 1.0
    offsets = alive - alive.max()

    def left(step: float) -> float:
        weights = np.exp(step * offsets)
        return float(weights.sum() ** 2 / (weights**2).sum())

    low, high = 0.0, 1.0 - power
    if left(high) >= share * len(alive):
        return 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if left(middle) >= share * len(alive) else (low, middle)
    return min(1.0, power + max(low, _TINY_STEP))


def resampled(weights: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Systematic resampling: indices, each about as often as its weight says.

    Parameters
    ----------
    weights : ndarray (N,)
        Weights of any sum above zero.
    rng : numpy.random.Generator
        Source of the one draw it takes.

    Returns
    -------
    ndarray of int (N,)

    Examples
    --------
    >>> resampled(np.array([0.0, 3.0, 1.0, 0.0]), np.random.default_rng(0)).tolist()
    [1, 1, 1, 2]
    """
    count = len(weights)
    edges = np.cumsum(weights)
    at = (rng.random() + np.arange(count)) / count * edges[-1]
    return np.asarray(np.minimum(np.searchsorted(edges, at, side="right"), count - 1))
