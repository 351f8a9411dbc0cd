"""Models of a motion that is Gaussian in all directions but one, and uniform along that one.

In the plane the density is a ridge, in space a column of ellipses (thesis 4.1.1).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.thesis.methods.motion.histogram import Histogram
from loose_env.typing import Array

_STEEPEST = 50.0  # Exponents are cut here, so that a wild step of a search does not overflow.


def along(points: ArrayLike, angle: float) -> Array:
    """Component of points along a direction of the plane (4.4).

    ``points`` (2, N): points, any unit. Returns (N,): component, unit of the points.

    Examples
    --------
    >>> along([[1.0, 0.0], [0.0, 2.0]], np.pi / 2).round(6).tolist()
    [0.0, 2.0]
    """
    x, y = np.asarray(points, dtype=float)
    return np.asarray(math.cos(angle) * x + math.sin(angle) * y)


def planar_ridge(points: ArrayLike, a: ArrayLike) -> Array:
    """Height of the ridge: z = a0 exp(a1 (cos a2 x + sin a2 y)^2) (4.3, 4.5, 4.6).

    ``points`` (2, N): points, any unit. ``a`` (3,): height a0, exponent a1 (negative, one over the
    squared unit of the points) and direction a2 [rad] of the Gaussian component. Returns (N,):
    heights, unit of a0.

    Examples
    --------
    >>> planar_ridge([[0.0, 1.0], [5.0, 5.0]], [2.0, -0.5, 0.0]).round(4).tolist()
    [2.0, 1.2131]
    """
    a0, a1, a2 = np.asarray(a, dtype=float)
    x, y = np.asarray(points, dtype=float)
    across = np.cos(a2) * x + np.sin(a2) * y
    return np.asarray(a0 * np.exp(np.minimum(a1 * across**2, _STEEPEST)))


def exponent_from_sd(sd: float) -> float:
    """Exponent a1 of a standard deviation: -1 / (2 sd^2) (4.8).

    Examples
    --------
    >>> exponent_from_sd(0.5)
    -2.0
    """
    return -0.5 / sd**2


def sd_from_exponent(a1: float) -> float:
    """Standard deviation of an exponent a1, the inverse of (4.8); infinite where a1 is not below 0.

    Examples
    --------
    >>> sd_from_exponent(-2.0), sd_from_exponent(0.1)
    (0.5, inf)
    """
    return math.sqrt(-0.5 / a1) if a1 < 0.0 else math.inf


def rotation(azimuth: float, elevation: float) -> Array:
    """Rotation into the plane across a direction (4.2).

    Rows one and two span the plane, row three is the direction of azimuth and elevation.

    ``azimuth``, ``elevation``: direction in space: angle about z from x, and angle above the x-y
    plane, rad. Returns (3, 3): rotation matrix.

    Examples
    --------
    >>> (rotation(0.0, np.pi / 2) + 0.0).round(6).tolist()
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    cr, sr = np.cos(azimuth), np.sin(azimuth)
    ce, se = np.cos(elevation), np.sin(elevation)
    return np.array([[-sr, cr, 0.0], [-se * cr, -se * sr, ce], [ce * cr, ce * sr, se]])


def to_plane(points: ArrayLike, azimuth: float, elevation: float) -> Array:
    """Points in the frame whose z axis is the direction of azimuth and elevation (4.1).

    ``points`` (3, N): points, any unit. ``azimuth``, ``elevation``: direction, rad. Returns (3, N):
    points; rows one and two lie in the plane across the direction.

    Examples
    --------
    >>> to_plane([[2.0], [0.0], [0.0]], 0.0, 0.0).round(6).ravel().tolist()
    [0.0, 0.0, 2.0]
    """
    return np.asarray(rotation(azimuth, elevation) @ np.asarray(points, dtype=float))


def spatial_ridge(points: ArrayLike, b: ArrayLike) -> Array:
    """Height of the column of ellipses: b0 exp(-|L' p|^2 / 2), p the points in the plane (4.1).

    L = [[b1, 0], [b2, b3]] is a root of the inverse covariance in the plane, which any values
    keep positive.

    ``points`` (3, N): points, any unit. ``b`` (6,): height, the three entries of L (one over the
    unit of the points), azimuth and elevation of the direction across the plane [rad]. Returns
    (N,): heights, unit of b0.

    Examples
    --------
    >>> up = [2.0, 1.0, 0.0, 1.0, 0.0, np.pi / 2]
    >>> spatial_ridge([[0.0, 1.0], [0.0, 0.0], [7.0, 7.0]], up).round(4).tolist()
    [2.0, 1.2131]
    """
    height, root, skew, other, azimuth, elevation = np.asarray(b, dtype=float)
    x, y, _ = to_plane(points, azimuth, elevation)
    squared = (root * x + skew * y) ** 2 + (other * y) ** 2
    return np.asarray(height * np.exp(-0.5 * squared))


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
    counts, squared = found.counts.ravel(), np.sum(found.points() ** 2, axis=0)
    return float(np.sum(squared * counts)) / float(counts.sum()) / found.counts.ndim


def planar_trial(found: Histogram, angle: float) -> Array:
    """Trial parameters with a given direction: a0 the highest count, a1 from (4.7) and (4.9).

    ``angle``: trial direction a2 of the Gaussian component, rad. Returns (3,): a0, a1, a2.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2)), low=np.array([-2.0, -2.0]), width=2.0)
    >>> planar_trial(corners, 0.5).tolist()
    [1.0, -0.5, 0.5]
    """
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
    x, y, z = np.asarray(direction, dtype=float)
    flat = math.hypot(x, y)
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
