"""Models of a motion that is Gaussian in all directions but one, and uniform along that one.

In the plane the density is a ridge, in space a column of ellipses (thesis 4.1.1).
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import as_floats, require_finite
from loose_env.typing import Array

__all__ = [
    "along",
    "exponent_from_sd",
    "planar_ridge",
    "rotation",
    "sd_from_exponent",
    "spatial_ridge",
    "to_plane",
]

_STEEPEST = 50.0  # Exponents are cut here, so that a wild step of a search does not overflow.


def along(points: ArrayLike, angle: float) -> Array:
    """Component of points along a direction of the plane (4.4).

    ``points`` (2, N): points, any unit. Returns (N,): component, unit of the points.

    Examples
    --------
    >>> along([[1.0, 0.0], [0.0, 2.0]], np.pi / 2).round(6).tolist()
    [0.0, 2.0]
    """
    x, y = _points(points, 2)
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
    a0, a1, a2 = _parameters(a, 3)
    x, y = _points(points, 2)
    across = np.cos(a2) * x + np.sin(a2) * y
    return np.asarray(a0 * np.exp(np.minimum(a1 * across**2, _STEEPEST)))


def exponent_from_sd(sd: float) -> float:
    """Exponent a1 of a standard deviation: -1 / (2 sd^2) (4.8).

    Examples
    --------
    >>> exponent_from_sd(0.5)
    -2.0
    """
    if not (math.isfinite(sd) and sd > 0.0):
        raise InvalidSetting(f"sd is {sd}; it must be finite and above zero")
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
    return np.asarray(rotation(azimuth, elevation) @ _points(points, 3))


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
    height, root, skew, other, azimuth, elevation = _parameters(b, 6)
    x, y, _ = to_plane(points, azimuth, elevation)
    squared = (root * x + skew * y) ** 2 + (other * y) ** 2
    return np.asarray(height * np.exp(-0.5 * squared))


def _points(points: ArrayLike, dimension: int) -> Array:
    found = as_floats(points, "points")
    if found.ndim != 2 or found.shape[0] != dimension:
        raise InvalidData(f"points has shape {found.shape}; it must be ({dimension}, N)")
    require_finite(found, "points")
    return found


def _parameters(values: ArrayLike, count: int) -> Array:
    found = as_floats(values, "parameters")
    if found.shape != (count,):
        raise InvalidData(f"parameters has shape {found.shape}; it must be ({count},)")
    require_finite(found, "parameters")
    return found
