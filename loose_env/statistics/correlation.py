"""Coherence, transmission, apparent inertia, and the comparative index of correlation vectors.

x are the accelerations of the excited joints, a that of the tool, u the commanded torques.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from loose_env.errors import InvalidData
from loose_env.statistics.directions import axial_vector
from loose_env.statistics.moments import Covariances, excitation_factor, whitener
from loose_env.typing import Array

# Correlation of command and joint acceleration below which the command instruments nothing.
UNRELATED = 1e-9


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


def transmission_from(cov: Covariances) -> Array:
    """Regress the tool acceleration on the accelerations of the excited joints.

    B = C Sx^-1 with C = cov(a, x) and Sx = cov(x). Noise in x shrinks it: then use
    `transmission_by_instrument_from`.

    Parameters
    ----------
    cov : Covariances
        Of the joints' accelerations with the tool's. Axes in front are those of several records.

    Returns
    -------
    array, shape (..., d, m)
        B, m/s^2 per rad/s^2.

    Raises
    ------
    InvalidData
        If the rows of x depend on each other.

    Examples
    --------
    >>> from loose_env.statistics import covariances
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> transmission_from(covariances(x, [[0.5, -0.5, 0.5, -0.5], [1, 1, -1, -1]])).tolist()
    [[0.5], [0.0]]
    """
    if cov.xx.shape[-1] == 1:
        return (cov.xa / cov.xx).mT
    factor = excitation_factor(cov.xx)
    b = np.linalg.solve(factor.mT, np.linalg.solve(factor, cov.xa)).mT
    return np.asarray(b, dtype=np.float64)


def transmission_by_instrument_from(command_x: Covariances, command_a: Covariances) -> Array:
    """Estimate the transmission with the command as instrument: noise in x does not shrink it.

    B = cov(a, u) cov(x, u)^-1, the instrumental-variable estimate (Soderstrom and Stoica,
    Instrumental Variable Methods for System Identification, 1983).

    Parameters
    ----------
    command_x, command_a : Covariances
        Of the commanded torques u of the excited joints with their accelerations x, and with the
        tool acceleration a. Axes in front are those of several records.

    Returns
    -------
    array, shape (..., d, m)
        B, m/s^2 per rad/s^2.

    Raises
    ------
    InvalidData
        If there is not one command for each row of x, or x does not follow it.

    Examples
    --------
    >>> from loose_env.statistics import covariances
    >>> u, noisy = [1.0, -1.0, 1.0, -1.0], [3.0, -1.0, 1.0, -3.0]
    >>> transmission_by_instrument_from(covariances(u, noisy), covariances(u, [u, u])).tolist()
    [[0.5], [0.5]]
    """
    _require_related(command_x)
    return np.asarray(np.linalg.solve(command_x.xa, command_a.xa).mT, dtype=np.float64)


def apparent_inertia_from(command_x: Covariances) -> Array:
    """Estimate the apparent inertia of the excited joints, M = cov(u, u) cov(x, u)^-1.

    Noise in x does not shrink it. M[i, i] is what joint i feels while the other excited joints do
    not accelerate, M[i, j] the torque on joint i by the acceleration of joint j.

    Parameters
    ----------
    command_x : Covariances
        Of the commanded torques u with the joint accelerations x.

    Returns
    -------
    array, shape (..., m, m)
        M, N m per rad/s^2.

    Raises
    ------
    InvalidData
        As `transmission_by_instrument_from`.

    Examples
    --------
    >>> from loose_env.statistics import covariances
    >>> apparent_inertia_from(covariances([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])).tolist()
    [[2.0]]
    """
    _require_related(command_x)
    return np.asarray(np.linalg.solve(command_x.xa, command_x.xx).mT, dtype=np.float64)


def _require_related(command_x: Covariances) -> None:
    uu, ux, xx = command_x.xx, command_x.xa, command_x.aa
    if ux.shape[-2] != ux.shape[-1]:
        raise InvalidData(
            f"command has {ux.shape[-2]} rows and x has {ux.shape[-1]}; each excited joint needs "
            "one"
        )
    commanded, moved = (np.diagonal(own, axis1=-2, axis2=-1) for own in (uu, xx))
    scale = np.sqrt(commanded[..., :, None] * moved[..., None, :])
    if (scale == 0.0).any() or (
        np.linalg.svd(ux / scale, compute_uv=False)[..., -1] < UNRELATED
    ).any():
        raise InvalidData("x does not follow the command; the command cannot serve as instrument")
