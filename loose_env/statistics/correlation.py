"""Correlation and coherence of the motion of the tool with the excited joints, by direction.

With x the joint acceleration, a the tool acceleration, c = cov(x, a) and S = cov(a), the
correlation along the unit vector u is r(u) = u.c / (sd(x) sqrt(u.S u)). Equation numbers are
those of the thesis.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_angles, as_direction
from loose_env.statistics.directions import axial_vector, wrap_axial
from loose_env.statistics.moments import (
    STILL,
    Covariances,
    covariances,
    excitation_factor,
    planar_excitation,
    single_excitation,
    whitener,
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
    c = planar_excitation(covariances(x, a))
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
    cov = covariances(x, a)
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
    >>> x = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [2.0, 0.0, -2.0, 0.0]]
    >>> lowest = lowest_coherence_direction_from(covariances(x, a))
    >>> lowest.direction.round(6).tolist(), round(lowest.coherence, 6)
    ([0.0, 1.0], 0.5)
    """
    w = whitener(cov.aa)
    whitened = np.linalg.solve(excitation_factor(cov.xx), cov.xa @ w).mT
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
