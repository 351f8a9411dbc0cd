"""Axial directions, direction of lowest coherence with excited joints, comparative index.

A direction and its opposite are one axis: half a circle, or half a sphere, holds all. Planar angles
are in radians, from the x axis of the tool towards its y axis.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics._checks import as_directions, as_floats, require_finite
from loose_env.statistics.transmission import Covariances, excitation_factor, solved, whitener
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
    last = unit[..., -1]  # component that is not zero
    for k in range(2, unit.shape[-1] + 1):
        if last.all():
            break
        last = np.where(last != 0.0, last, unit[..., -k])
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


class LowestCoherence(NamedTuple):
    """Direction of lowest coherence with the excited joints."""

    direction: Array
    """Unit vector in the tool frame, shape (d,); the last non-zero component is positive."""
    coherence: float
    """Share rho^2 of the variance along it that the excited joints explain, 0 to 1."""
    coherences: Array
    """All generalised eigenvalues rho^2, rising, shape (d,)."""


def lowest_coherence_direction_from(cov: Covariances) -> LowestCoherence:
    """Find the direction of lowest coherence with all excited joints together.

    The smallest generalised eigenvector of (C Sx^-1 C.T) u = rho^2 S u, with C = cov(a, x),
    Sx = cov(x) and S = cov(a). With one excited joint in the plane this is the direction of
    lowest correlation, with rho^2 = 0. When x has fewer rows than a, the lowest rho^2 is zero
    by construction, and with two fewer the direction is one of many.

    Parameters
    ----------
    cov : Covariances
        Of the accelerations of the excited joints with the tool acceleration, tool frame.

    Returns
    -------
    LowestCoherence
        Direction, its rho^2, and every rho^2. Zero along a direction in which the tool does not
        move. Of several records, each has their axes in front.

    Raises
    ------
    InvalidData
        If the joint accelerations depend on each other.

    Examples
    --------
    >>> from loose_env.statistics import covariances
    >>> x = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [2.0, 0.0, -2.0, 0.0]]
    >>> lowest = lowest_coherence_direction_from(covariances(x, a))
    >>> lowest.direction.round(6).tolist(), round(lowest.coherence, 6)
    ([0.0, 1.0], 0.5)
    """
    w = whitener(cov.aa)
    whitened = solved(excitation_factor(cov.xx), cov.xa @ w).mT
    # Singular values of the whitened covariance are the canonical correlations rho. They come
    # falling, and the left vectors beyond them (m < d) follow no joint.
    vectors, rho, _ = np.linalg.svd(whitened)
    coherences = np.zeros(cov.aa.shape[:-1])
    coherences[..., : rho.shape[-1]] = np.minimum(rho, 1.0) ** 2
    lowest: Any = coherences[..., -1]
    return LowestCoherence(
        axial_vector((w @ vectors[..., -1:])[..., 0]),
        float(lowest) if cov.aa.ndim == 2 else lowest,
        coherences[..., ::-1],
    )


class ComparativeIndex(NamedTuple):
    """Magnitudes of the two cross products of correlation vectors."""

    mag_e: float
    """|C* sin(phi_n - phi_f)| (6.17)."""
    mag_d: float
    """|(1 - C*) sin(phi_n - phi_f)| (6.18): the index; near zero without a fault."""


def comparative_index(c_n: float, phi_n: float, c_f: float, phi_f: float) -> ComparativeIndex:
    """Compare a correlation vector with the nominal one (6.15 to 6.18).

    C* = c_f / c_n is the maximum correlation relative to the nominal one. The printed tables use
    the magnitude |1 - C*|, since C* exceeds one in some poses, and |sin|, since directions are
    axes. The index stays near zero when the direction does not change, fault or not.

    Parameters
    ----------
    c_n, c_f : float
        Maximum correlation in the nominal and in the compared state, 0 to 1; c_n above zero.
    phi_n, phi_f : float
        Direction of lowest correlation in either state, rad, from the same axis.

    Returns
    -------
    ComparativeIndex
        Magnitudes of E and D.

    Raises
    ------
    InvalidData
        If a correlation lies outside 0 to 1, c_n is zero or an angle is not finite.

    Examples
    --------
    The looseness case at 56 degrees, from table 6.4 and the angle of table 6.5:

    >>> round(comparative_index(0.60, math.radians(70.0), 0.30, 0.0).mag_d, 2)
    0.47
    """
    if not (0.0 < c_n <= 1.0 and 0.0 <= c_f <= 1.0):
        raise InvalidData(
            f"c_n is {c_n} and c_f is {c_f}; correlations lie between 0 and 1, c_n above 0"
        )
    if not (math.isfinite(phi_n) and math.isfinite(phi_f)):
        raise InvalidData(f"phi_n is {phi_n} and phi_f is {phi_f}; angles must be finite")
    relative = c_f / c_n
    turn = abs(math.sin(phi_n - phi_f))
    return ComparativeIndex(relative * turn, abs(1.0 - relative) * turn)
