"""Axes in space: grids, angles and minimisation over the hemisphere.

A looseness slides both ways, so a direction and its opposite are one axis, and half a sphere
holds them all.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidSetting
from loose_env.statistics._checks import as_direction, as_floats
from loose_env.typing import Array


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
