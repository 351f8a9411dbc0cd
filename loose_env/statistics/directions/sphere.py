"""Axes in space: grids, angles and minimisation over the hemisphere.

A looseness slides both ways, so a direction and its opposite are one axis, and half a sphere
holds them all.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidSetting
from loose_env.statistics._checks import as_direction, as_floats
from loose_env.statistics.directions.angles import axial_vector
from loose_env.typing import Array


class HemisphereSearch(NamedTuple):
    """Result of a search on the hemisphere."""

    direction: Array
    """Unit vector, shape (3,); the last non-zero component is positive."""
    value: float
    """Criterion there."""
    evaluations: int
    """Directions at which the criterion was asked."""


def axes_grid(count: int, dimension: int = 3) -> Array:
    """Distribute axes evenly over a half circle or a half sphere.

    Parameters
    ----------
    count : int
        Number of axes, one or more.
    dimension : {2, 3}
        Plane or space.

    Returns
    -------
    array, shape (count, dimension)
        Unit vectors, each standing for itself and its opposite; on the sphere a Fibonacci
        lattice, whose spacing is about sqrt(2 pi / count) rad.

    Raises
    ------
    InvalidSetting
        If `count` is below one or `dimension` is neither 2 nor 3.

    References
    ----------
    Swinbank and Purser, Q. J. R. Meteorol. Soc. 132 (2006).

    Examples
    --------
    >>> axes_grid(2, 2).round(3).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    >>> bool(np.allclose(np.linalg.norm(axes_grid(100), axis=1), 1.0))
    True
    """
    if count != int(count) or count < 1 or dimension not in (2, 3):
        raise InvalidSetting(
            f"count is {count} and dimension {dimension}; a whole number of axes, one or more, in "
            "2 or 3 dimensions"
        )
    k = np.arange(count, dtype=np.float64)
    if dimension == 2:
        around = np.pi * k / count
        return np.stack((np.cos(around), np.sin(around)), axis=1)
    height = (k + 0.5) / count
    turn = k * np.pi * (3.0 - math.sqrt(5.0))
    flat = np.sqrt(1.0 - height**2)
    return np.stack((flat * np.cos(turn), flat * np.sin(turn), height), axis=1)


def axial_angle_between(first: ArrayLike, second: ArrayLike) -> float:
    """Angle between two axes, 0 to pi/2.

    Parameters
    ----------
    first, second : array, shape (d,)
        Any vectors along the axes.

    Returns
    -------
    float
        Angle, rad.

    Raises
    ------
    InvalidData
        If the vectors differ in size, are not finite or have no length.

    Examples
    --------
    >>> round(math.degrees(axial_angle_between([1.0, 0.0, 0.0], [-1.0, 1.0, 0.0])), 6)
    45.0
    """
    size = np.shape(as_floats(first, "first"))[-1]
    u, v = as_direction(first, size, "first"), as_direction(second, size, "second")
    along = abs(float(np.sum(u * v)))
    # The length of what is left over is exact for small angles, where the cosine is flat.
    across = float(np.linalg.norm(u - np.sum(u * v) * v))
    return math.atan2(across, along)


def tangents(direction: ArrayLike) -> Array:
    """Orthonormal basis of the plane perpendicular to a direction.

    Parameters
    ----------
    direction : array, shape (d,)
        Any vector along the axis.

    Returns
    -------
    array, shape (d - 1, d)
        An orthonormal basis of what lies across.

    Raises
    ------
    InvalidData
        If `direction` is no finite vector with a length.

    Examples
    --------
    >>> bool(np.allclose(tangents([0.0, 0.0, 2.0]) @ [0.0, 0.0, 1.0], 0.0))
    True
    """
    vector = as_floats(direction, "direction")
    unit = as_direction(vector, vector.shape[-1])
    _, _, basis = np.linalg.svd(unit[None])
    return np.asarray(basis[1:], dtype=np.float64)


def hemisphere_search(
    criterion: Callable[[Array], Array],
    *,
    spacing: float = math.radians(15.0),
    tolerance: float = math.radians(0.1),
) -> HemisphereSearch:
    """Minimise a criterion over the axes of the hemisphere.

    As the thesis sketches it (6.5.2): candidates are spaced evenly over one hemisphere, then the
    spacing about the best one is bisected until it is fine enough. The closed forms need no
    search; this one is for comparison, and for criteria without a closed form. It finds the
    smallest of the candidates' valleys, not surely the lowest point of all.

    Parameters
    ----------
    criterion : callable
        Value at unit vectors, of shape (K, 3) to (K,), the same for opposite vectors.
    spacing : float
        Spacing of the first candidates, rad.
    tolerance : float
        Spacing at which the search ends, rad.

    Returns
    -------
    HemisphereSearch
        Axis, value and number of evaluations.

    Raises
    ------
    InvalidSetting
        If `tolerance` is not above zero or `spacing` is below it or above a right angle.

    Examples
    --------
    >>> target = np.array([0.6, 0.0, 0.8])
    >>> found = hemisphere_search(lambda u: -((u @ target) ** 2))
    >>> bool(math.degrees(axial_angle_between(found.direction, target)) < 0.2)
    True
    """
    if not 0.0 < tolerance <= spacing <= math.pi / 2:
        raise InvalidSetting(
            f"spacing is {spacing} and tolerance {tolerance} rad; 0 < tolerance <= spacing <= pi/2"
        )
    candidates = axes_grid(max(math.ceil(2 * math.pi / spacing**2), 3))
    values = criterion(candidates)
    evaluations = len(candidates)
    best = candidates[int(np.argmin(values))]
    value = float(np.min(values))
    step = spacing
    turn = np.arange(6) * math.pi / 3
    while step > tolerance:
        # A ring of neighbours; the spacing is halved once none of them is lower.
        across = tangents(best)
        ring = math.cos(step) * best + math.sin(step) * (
            np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
        )
        around = criterion(ring)
        evaluations += len(ring)
        if float(np.min(around)) < value:
            best, value = ring[int(np.argmin(around))], float(np.min(around))
        else:
            step /= 2
    return HemisphereSearch(axial_vector(best), value, evaluations)
