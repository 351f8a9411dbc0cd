"""Transmission from joint motion to the tool, and its change due to a fault.

The tool acceleration is B x plus what the excited joints do not explain. Against the healthy arm
in the same pose, a loose seat sliding along z_l changes B along z_l alone: the change has rank
one and its leading left singular vector is z_l, where the other joints hold still.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_floats, require_finite
from loose_env.statistics.directions.angles import axial_vector
from loose_env.statistics.records.covariance import Covariances, covariances, excitation_factor
from loose_env.typing import Array

# Correlation of command and joint acceleration below which the command instruments nothing.
UNRELATED = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class TransmissionChange:
    """Change of transmission against a reference."""

    direction: Array
    """Unit vector of the change in the tool frame, shape (d,); last non-zero component positive.

    Without meaning when the magnitude is zero.
    """
    magnitude: float
    """Largest singular value of the change, m/s^2 per rad/s^2."""
    ratio: float
    """Size of the change over that of the reference (Frobenius norms)."""
    singular_values: Array
    """Singular values of the change, falling, shape (min(d, m),)."""
    first_share: float
    """Share of the change's squared size along `direction`: 1 for rank one, 0 for no change."""


def transmission(x: ArrayLike, a: ArrayLike) -> Array:
    """Regress the tool acceleration on the excited joints' accelerations.

    B = C Sx^-1 with C = cov(a, x) and Sx = cov(x). Noise in x shrinks it: then use
    `transmission_by_instrument`.

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


def transmission_by_instrument(command: ArrayLike, x: ArrayLike, a: ArrayLike) -> Array:
    """Regress the tool acceleration on measured joint accelerations through the command.

    B = cov(a, u) cov(x, u)^-1 with the command u as instrument. Noise in the measured x drops
    out, since the command does not know it.

    Parameters
    ----------
    command : array, shape (N,) or (m, N)
        Commanded torques of the excited joints, N m; one for each row of x.
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
        If the record cannot be used, or the joints do not follow the command.

    Examples
    --------
    >>> u = [1.0, -1.0, 1.0, -1.0]
    >>> noisy = [3.0, -1.0, 1.0, -3.0]
    >>> transmission_by_instrument(u, noisy, [u, u]).tolist()
    [[0.5], [0.5]]
    """
    return transmission_by_instrument_from(covariances(command, x), covariances(command, a))


def transmission_by_instrument_from(command_x: Covariances, command_a: Covariances) -> Array:
    """`transmission_by_instrument` on the covariances of the command with x and with a.

    Of several records (..., d, m).
    """
    _require_related(command_x)
    return np.asarray(np.linalg.solve(command_x.xa, command_a.xa).mT, dtype=np.float64)


def apparent_inertia(command: ArrayLike, x: ArrayLike) -> Array:
    """Estimate the apparent inertia of the excited joints from torque and acceleration.

    Torque is regressed on acceleration with the command u as instrument,
    M = cov(u, u) cov(x, u)^-1, so noise in x does not shrink it. For one joint this is
    var(u) / cov(u, x). For several, M[i, i] is what joint i feels while the other excited joints
    do not accelerate, and M[i, j] the torque on joint i by the acceleration of joint j.

    Parameters
    ----------
    command : array, shape (N,) or (m, N)
        Commanded torques of the excited joints, N m; one for each row of x.
    x : array, shape (N,) or (m, N)
        Accelerations of the excited joints, motor side, rad/s^2.

    Returns
    -------
    array, shape (m, m)
        M, N m per rad/s^2.

    Raises
    ------
    InvalidData
        If the record cannot be used, or the joints do not follow the command.

    Examples
    --------
    >>> apparent_inertia([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5]).tolist()
    [[2.0]]
    """
    return apparent_inertia_from(covariances(command, x))


def apparent_inertia_from(command_x: Covariances) -> Array:
    """`apparent_inertia` on the covariances of the command with x.

    Of several records (..., m, m).
    """
    _require_related(command_x)
    return np.asarray(np.linalg.solve(command_x.xa, command_x.xx).mT, dtype=np.float64)


def transmission_change(b: ArrayLike, b_reference: ArrayLike) -> TransmissionChange:
    """Compare a transmission with that of the healthy arm in the same pose.

    The rank of the change speaks: 0 healthy, 1 one slide, more for several directions.

    Parameters
    ----------
    b, b_reference : array, shape (d, m)
        Transmissions, m/s^2 per rad/s^2.

    Returns
    -------
    TransmissionChange
        Direction, size and singular values of b - b_reference.

    Raises
    ------
    InvalidData
        If the shapes differ, a value is not finite or the reference is zero.

    Examples
    --------
    >>> change = transmission_change([[0.5, 0.1], [0.4, 0.2]], [[0.5, 0.1], [0.1, 0.2]])
    >>> change.direction.round(6).tolist(), round(change.magnitude, 6), round(change.first_share, 6)
    ([0.0, 1.0], 0.3, 1.0)
    """
    now, reference = as_floats(b, "b"), as_floats(b_reference, "b_reference")
    if now.ndim != 2 or now.shape != reference.shape or now.size == 0:
        raise InvalidData(
            f"b has shape {now.shape} and b_reference {reference.shape}; both must be (d, m)"
        )
    change = now - reference
    require_finite(change, "b or b_reference")
    size = float(np.sqrt(np.sum(reference * reference)))
    if size == 0.0:
        raise InvalidData("b_reference is zero; a healthy arm transmits motion")
    vectors, values, _ = np.linalg.svd(change, full_matrices=False)
    total = float(np.sum(values * values))
    return TransmissionChange(
        direction=axial_vector(vectors[:, 0]),
        magnitude=float(values[0]),
        ratio=float(np.sqrt(total)) / size,
        singular_values=values,
        first_share=float(values[0] ** 2) / total if total > 0.0 else 0.0,
    )


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
