"""Transmission from the excited joints to the tool, and the apparent inertia of the joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics.moments import Covariances, covariances, excitation_factor
from loose_env.typing import Array

# Correlation of command and joint acceleration below which the command instruments nothing.
UNRELATED = 1e-9


def transmission(x: ArrayLike, a: ArrayLike) -> Array:
    """Regress the tool acceleration on the excited joints' accelerations.

    B = C Sx^-1 with C = cov(a, x) and Sx = cov(x). Noise in x shrinks it: then use
    `transmission_by_instrument_from`.

    Parameters
    ----------
    x : array, shape (N,) or (m, N)
        Accelerations of the excited joints, motor side, rad/s^2.
    a : array, shape (d, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    array, shape (d, m)
        B, m/s^2 per rad/s^2.

    Raises
    ------
    InvalidData
        If the record cannot be used or the rows of x depend on each other.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> transmission(x, [[0.5, -0.5, 0.5, -0.5], [1.0, 1.0, -1.0, -1.0]]).tolist()
    [[0.5], [0.0]]
    """
    return transmission_from(covariances(x, a))


def transmission_from(cov: Covariances) -> Array:
    """`transmission` on covariances; of several records (..., d, m)."""
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
