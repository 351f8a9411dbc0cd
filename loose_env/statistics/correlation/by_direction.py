"""Correlation of the tool's motion with one excited joint, as a function of direction.

With x the joint acceleration, a the tool acceleration, c = cov(x, a) and S = cov(a), the
correlation along the unit vector u is r(u) = u.c / (sd(x) sqrt(u.S u)). Equation numbers are
those of the thesis.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_angles, as_direction
from loose_env.statistics.directions.angles import wrap_axial
from loose_env.statistics.records.covariance import (
    STILL,
    Covariances,
    covariances,
    planar_excitation,
    single_excitation,
)
from loose_env.typing import Array


class MaximumCorrelation(NamedTuple):
    """Maximum correlation over all directions, and its direction."""

    value: float
    """Correlation, 0 to 1."""
    direction: Array
    """Unit vector in the tool frame, shape (d,)."""


def correlation_loop(x: ArrayLike, a: ArrayLike, angles: ArrayLike) -> Array:
    """Trace the correlation vector: the correlation at every angle of the plane (4.14).

    Each is the Pearson correlation with the component along that angle (4.10 to 4.13).

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (2, N)
        Tool acceleration in the tool frame, m/s^2.
    angles : array, shape (K,)
        Angles from the tool's x axis, rad.

    Returns
    -------
    array, shape (K,)
        Correlation, -1 to 1; it changes sign from an angle to its opposite (4.15).

    Raises
    ------
    InvalidData
        If the record or the angles cannot be used, x has several rows or a not two.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> correlation_loop(x, a, np.radians([0.0, 60.0, 180.0])).round(4).tolist()
    [1.0, 0.5, -1.0]
    """
    return correlation_loop_from(covariances(x, a), angles)


def correlation_loop_from(cov: Covariances, angles: ArrayLike) -> Array:
    """`correlation_loop` on covariances."""
    c = planar_excitation(cov)
    phi = as_angles(angles)
    cosine, sine = np.cos(phi), np.sin(phi)
    s = cov.aa
    variance = s[0, 0] * cosine**2 + 2 * s[0, 1] * cosine * sine + s[1, 1] * sine**2
    still = variance <= STILL * (s[0, 0] + s[1, 1])
    scale = np.sqrt(cov.xx[0, 0] * np.where(still, 1.0, variance))
    return np.where(still, 0.0, (c[0] * cosine + c[1] * sine) / scale)


def lowest_correlation_direction(x: ArrayLike, a: ArrayLike) -> float:
    """Find the planar direction uncorrelated with the excited joint.

    The correlation is zero perpendicular to c = cov(x, a), so no search is needed:
    phi0 = atan2(c_y, c_x) + 90 degrees.

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (2, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    float
        Angle from the tool's x axis in [0, pi), rad.

    Raises
    ------
    InvalidData
        If the record cannot be used, x has several rows, a not two, or x is correlated with no
        direction at all.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> round(lowest_correlation_direction(x, [x, [1.0, 1.0, -1.0, -1.0]]), 4)
    1.5708
    """
    return lowest_correlation_direction_from(covariances(x, a))


def lowest_correlation_direction_from(cov: Covariances) -> float:
    """`lowest_correlation_direction` on covariances."""
    c = planar_excitation(cov)
    if not c.any():
        raise InvalidData("x is uncorrelated with a in every direction; none is the lowest")
    return wrap_axial(math.atan2(c[1], c[0]) + math.pi / 2)


def maximum_correlation(x: ArrayLike, a: ArrayLike) -> MaximumCorrelation:
    """Find the maximum correlation over all directions: C in the thesis's tables.

    It lies along S^-1 c and is sqrt(c.S^-1 c) / sd(x).

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (d, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    MaximumCorrelation
        Its value and its direction, the sign chosen so that the correlation is positive.

    Raises
    ------
    InvalidData
        If the record cannot be used, x has several rows, or x is correlated with no direction.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> value, direction = maximum_correlation(x, [x, [1.0, 1.0, -1.0, -1.0]])
    >>> round(value, 6), direction.round(6).tolist()
    (1.0, [1.0, 0.0])
    """
    return maximum_correlation_from(covariances(x, a))


def maximum_correlation_from(cov: Covariances) -> MaximumCorrelation:
    """`maximum_correlation` on covariances."""
    c = single_excitation(cov)
    if not c.any():
        raise InvalidData("x is uncorrelated with a in every direction; none is the highest")
    variances, axes = np.linalg.eigh(cov.aa)
    along = axes.T @ c
    # A direction in which the tool does not move adds nothing but rounding.
    moving = variances > STILL * variances[-1]
    weights = np.where(moving, along, 0.0) / np.where(moving, variances, 1.0)
    value = math.sqrt(float(np.sum(weights * along)) / float(cov.xx[0, 0]))
    return MaximumCorrelation(min(value, 1.0), as_direction(axes @ weights, len(c)))
