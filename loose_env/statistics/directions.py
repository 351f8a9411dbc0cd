"""Axial directions in the plane and in space: a direction and its opposite are one axis.

Planar angles are in radians, from the x axis of the tool towards its y axis. Half a circle, or half
a sphere, holds all axes.
"""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics._checks import as_direction, as_directions, as_floats, require_finite
from loose_env.typing import Array

Angles = NDArray[np.floating[Any]]


@overload
def wrap_axial(angle: float) -> float: ...
@overload
def wrap_axial(angle: Angles) -> Array: ...
def wrap_axial(angle: float | Angles) -> float | Array:
    """Wrap the angle of an axis to [0, pi).

    Parameters
    ----------
    angle : float or array
        Angle, rad.

    Returns
    -------
    float or array
        The same axis, rad, of the shape given.

    Examples
    --------
    >>> round(wrap_axial(-0.25), 4)
    2.8916
    """
    wrapped = np.mod(angle, np.pi)
    # The remainder of a tiny negative angle rounds up to pi itself.
    wrapped = np.where(wrapped >= np.pi, 0.0, wrapped)
    return float(wrapped) if wrapped.ndim == 0 else wrapped


@overload
def axial_difference(a: float, b: float) -> float: ...
@overload
def axial_difference(a: Angles, b: float | Angles) -> Array: ...
@overload
def axial_difference(a: float, b: Angles) -> Array: ...
def axial_difference(a: float | Angles, b: float | Angles) -> float | Array:
    """Signed smallest rotation from axis `b` to axis `a`.

    Parameters
    ----------
    a, b : float or array
        Angles of the axes, rad.

    Returns
    -------
    float or array
        Difference in [-pi/2, pi/2), rad.

    Examples
    --------
    >>> round(math.degrees(axial_difference(math.radians(2), math.radians(179))), 6)
    3.0
    """
    turn: float | Array = wrap_axial(np.subtract(a, b) + np.pi / 2)
    return turn - np.pi / 2


def axial_mean(angles: ArrayLike) -> float:
    """Average axes: half the direction of the mean of the doubled angles.

    Parameters
    ----------
    angles : array, shape (K,)
        Angles of the axes, rad.

    Returns
    -------
    float
        Angle of the mean axis in [0, pi), rad.

    Raises
    ------
    InvalidData
        If there is no angle, a value is not finite, or the axes cancel and have no mean.

    References
    ----------
    Mardia and Jupp, Directional Statistics, section 1.1.

    Examples
    --------
    >>> round(math.degrees(axial_mean(np.radians([176.0, 2.0]))), 6)
    179.0
    """
    axes = np.atleast_1d(as_floats(angles, "angles"))
    if axes.ndim != 1 or axes.size == 0:
        raise InvalidData(f"angles has shape {axes.shape}; it must be (K,), K > 0")
    require_finite(axes, "angles")
    cosine, sine = float(np.sum(np.cos(2 * axes))), float(np.sum(np.sin(2 * axes)))
    if math.hypot(cosine, sine) <= 1e-12 * len(axes):
        raise InvalidData("the axes cancel: they have no mean direction")
    return wrap_axial(0.5 * math.atan2(sine, cosine))


def axial_vector(direction: ArrayLike) -> Array:
    """Normalise an axis so that its last non-zero component is positive.

    In the plane this picks the vector whose angle lies in [0, pi).

    Parameters
    ----------
    direction : array, shape (..., d)
        Any vector along the axis.

    Returns
    -------
    array, shape (..., d)
        Unit vector.

    Raises
    ------
    InvalidData
        If `direction` is no vector, is not finite or has no length.

    Examples
    --------
    >>> axial_vector([3.0, -4.0]).tolist()
    [-0.6, 0.8]
    """
    unit = as_directions(direction)
    last = np.zeros(unit.shape[:-1])  # component that is not zero
    for component in np.moveaxis(unit, -1, 0):
        last = np.where(component != 0.0, component, last)
    return np.where(last[..., None] > 0.0, unit, -unit)


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
