"""Trial parameters and trial directions from which a Gaussian ridge is fitted (thesis 4.1.1)."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics import as_floats
from loose_env.thesis.methods.motion.gaussian_ridge import exponent_from_sd
from loose_env.thesis.methods.motion.histogram import Histogram, require_dimension
from loose_env.typing import Array

__all__ = ["hemisphere", "planar_trial", "spatial_trial", "variance_trial"]


def variance_trial(found: Histogram) -> float:
    """Trial variance: half the mean squared distance from the origin (4.7).

    It is the mean over the counts: the sum as printed needs the division by their sum.

    ``found``: counts in d directions; the motion has a mean of zero. Returns variance of one
    direction if all were alike (divided by d), squared unit of the data.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2)), low=np.array([-2.0, -2.0]), width=2.0)
    >>> variance_trial(corners)
    1.0
    """
    counts = found.counts.ravel()
    total = float(counts.sum())
    if not (math.isfinite(total) and total > 0.0 and (counts >= 0.0).all()):
        raise InvalidData("counts must be finite, not negative, and not all zero")
    squared = np.sum(found.points() ** 2, axis=0)
    return float(np.sum(squared * counts)) / total / found.counts.ndim


def planar_trial(found: Histogram, angle: float) -> Array:
    """Trial parameters with a given direction: a0 the highest count, a1 from (4.7) and (4.9).

    ``angle``: trial direction a2 of the Gaussian component, rad. Returns (3,): a0, a1, a2.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2)), low=np.array([-2.0, -2.0]), width=2.0)
    >>> planar_trial(corners, 0.5).tolist()
    [1.0, -0.5, 0.5]
    """
    require_dimension(found, 2)
    a1 = exponent_from_sd(math.sqrt(variance_trial(found)))
    return np.array([float(found.counts.max()), a1, angle])


def spatial_trial(found: Histogram, direction: ArrayLike) -> Array:
    """Trial parameters of `spatial_ridge`: round, with the trial variance of (4.7).

    ``direction`` (3,): trial direction of the looseness, of any length above zero. Returns (6,):
    parameters b.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2, 2)), low=np.full(3, -2.0), width=2.0)
    >>> spatial_trial(corners, [1.0, 0.0, 0.0]).tolist()
    [1.0, 1.0, 0.0, 1.0, 0.0, 0.0]
    """
    require_dimension(found, 3)
    x, y, z = as_floats(direction, "direction")
    flat = math.hypot(x, y)
    if not (math.isfinite(flat + z) and flat + abs(z) > 0.0):
        raise InvalidData(f"direction is {direction!r}; it needs a length above zero")
    root = 1.0 / math.sqrt(variance_trial(found))
    return np.array([found.counts.max(), root, 0.0, root, math.atan2(y, x), math.atan2(z, flat)])


def hemisphere(count: int) -> Array:
    """Unit vectors spread evenly over the upper hemisphere (3, count), on a golden spiral.

    Examples
    --------
    >>> hemisphere(2).round(3).T.tolist()
    [[0.661, 0.0, 0.75], [-0.714, 0.654, 0.25]]
    """
    k = np.arange(count)
    z = 1.0 - (k + 0.5) / count
    turn = k * math.pi * (3.0 - math.sqrt(5.0))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z])
