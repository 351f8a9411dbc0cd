"""Likelihood of one record by location, opening and amount of loose motion.

How well a measured covariance fits many expected ones: the Wishart density in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.likelihood.seat_response import predict_seats
from loose_env.diagnosis.records.model_uncertainty import joint_zero_errors, sensor_errors
from loose_env.diagnosis.records.prediction import SensorFloor
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = [
    "LOOSE",
    "OPENINGS",
    "SHUT",
    "Fit",
    "fit_record",
    "joint_covariance",
    "transmission_errors",
    "wishart_fit",
]


OPENINGS = np.linspace(-0.4, 1.2, 21)
"""Openings s that are tried [1]: 0 shut, 1 floating freely."""
LOOSE = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 8)])
"""Loose motion out of step that is tried, over that of a freely floating seat [1]."""
SHUT = int(np.argmin(np.abs(OPENINGS)))
"""Index of the shut seat among the openings."""

_MODEL_ERROR = 0.35
"""Relative error of predicted residual powers that sampling does not explain."""
_INERTIA_ERROR = 0.03
"""Relative error of the predicted apparent inertia."""
_OPEN_ERROR = 0.05
"""Relative error of the predicted change of transmission."""
_LINEAR_ERROR = 0.003
"""Share of the tool's rms motion that no linear model explains."""
_SPREAD = 0.03
"""Share of loose motion that shows across its direction."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Log-likelihood of one record."""

    log: Array
    """Over locations, openings and loose motion (P, S, Q)."""
    force: Array
    """Rms force that each shut seat transmits in the record (P,)."""
    load: Array
    """Force that gravity puts on each seat at rest (P,)."""


def fit_record(
    linear: LinearArm,
    record: RecordStatistics,
    directions: Array,
    floor: SensorFloor,
    mismatch: Mismatch,
) -> Fit:
    """Likelihood of a record.

    Three things are compared with what each seat would do. The part of the tool's motion that
    does not follow the joint as measured, a - B x, must not follow the command either. The
    apparent inertia must be the predicted one. The covariance of a - B x must be what the
    arm's modes, the sensors and the loose seat leave (a Wishart density). With several joints
    excited at once only the first is asked.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    record : RecordStatistics
        Measured summaries.
    directions : ndarray (A, axes)
        Sliding directions to try.
    floor : SensorFloor
        Noise of the sensors.
    mismatch : Mismatch
        Errors of the nominal model.
    """
    pose = linear.at(record.pose)
    on = np.flatnonzero(record.excited)
    d, m = len(record.tool_covariance), len(on)
    noise = np.concatenate([floor.joints(linear.arm)[on], np.full(d, floor.tool)]) ** 2
    seats = predict_seats(pose, record.torque, directions, noise)
    samples = 2 * (linear.arm.band[1] - linear.arm.band[0]) * record.duration

    b = record.transmission_by_instrument[:, on]
    joint = joint_covariance(record.joint_rms[on], seats.in_step[:m], seats.rest[:m, :m])
    mixed = joint @ record.transmission[:, on].T
    residual = record.tool_covariance - b @ mixed - mixed.T @ b.T + b @ joint @ b.T
    if m > 1:  # with their covariance only predicted, more may be taken off than was there
        size, along = np.linalg.eigh(residual)
        residual = along @ np.diag(np.maximum(size, 0.0)) @ along.T
    # Error floor of float32 readings and the linear model.
    rounding = (
        1e-3 * floor.tool**2 + _LINEAR_ERROR**2 * np.trace(record.tool_covariance)
    ) * np.eye(d)
    residual += rounding
    away = np.concatenate([-b, np.eye(d)], axis=1)

    s = OPENINGS[None, :, None, None]
    step = seats.in_step + s * seats.in_step_open[:, None]  # (P, S, p, m)
    log = _in_step(linear, record, on, b, away, residual, samples, seats.in_step, step, mismatch)
    if m > 1:
        log = np.repeat(log[..., None], len(LOOSE), 2)
        return Fit(log=log, force=seats.force, load=seats.load)

    x = step[..., 0, 0]
    inertia = float(record.inertia[on[0]])
    expected = float(record.torque[on[0]]) / np.where(np.abs(x) < 1e-9, 1e-9, x)
    error = np.sqrt(_INERTIA_ERROR**2 + 1 / samples)
    log = log - 0.5 * np.log1p(((expected / inertia - 1) / error) ** 2 / 4) * 5

    s = OPENINGS[None, :]
    rest = [seats.rest, seats.rest_mixed[:, None], seats.rest_open[:, None]]
    alone = [part[..., 0, 0] for part in rest]
    power = x**2 + alone[0] + s * alone[1] + s**2 * alone[2] - noise[0]
    # Scaled to the joint motion that was measured: the command's own power drops out.
    scale = np.maximum(record.joint_rms[on[0]] ** 2 - noise[0], 0.1 * noise[0])
    scale = scale / np.maximum(power, 1e-3 * float(seats.in_step[0, 0]) ** 2)
    scale, s = np.clip(scale, 0.2, 5.0)[..., None, None], s[..., None, None]
    # Sensor noise is no motion: it does not scale.
    sensed = away @ np.diag(noise) @ away.T
    shut, mixed_in, opened = (away @ part @ away.T for part in rest)
    across = (shut - sensed + s * mixed_in + s**2 * opened) * scale + sensed + rounding
    loose = away @ seats.loose @ away.T
    loose = loose + _SPREAD * np.trace(loose, axis1=1, axis2=2)[:, None, None] * np.eye(d)
    degrees = 2 / (2 / samples + _MODEL_ERROR**2)
    log = log[..., None] + wishart_fit(
        residual, across + 1e-12 * np.eye(d), loose[:, None], LOOSE, degrees
    )
    return Fit(log=log, force=seats.force, load=seats.load)


def joint_covariance(rms: Array, in_step: Array, rest: Array) -> Array:
    """Covariance of the excited joints (m, m): as strong as measured, correlated as predicted."""
    predicted = in_step @ in_step.T + rest
    scale = rms / np.sqrt(np.diag(predicted))
    return np.asarray(predicted * np.outer(scale, scale))


def _in_step(
    linear: LinearArm,
    record: RecordStatistics,
    on: NDArray[np.intp],
    b: Array,
    away: Array,
    residual: Array,
    samples: float,
    healthy: Array,
    step: Array,
    mismatch: Mismatch,
) -> Array:
    """Log-density of "a - B x does not follow the command" (P, S)."""
    d, m = b.shape
    # Unit of the residual: joint motion as predicted, so that the density is one of B.
    x = np.sqrt(np.diag(healthy[:m] @ healthy[:m].T))
    errors = transmission_errors(linear, record.pose, on, b, mismatch)
    uncertain = np.array([(e * x).ravel() for e in errors])
    covariance = uncertain.T @ uncertain + np.kron(residual, np.eye(m)) / samples
    nominal = healthy[m:] @ np.linalg.inv(healthy[:m])
    covariance += _OPEN_ERROR**2 * float((((b - nominal) * x) ** 2).sum()) * np.eye(d * m)
    missing = (away @ step).reshape(*step.shape[:2], d * m)
    white = missing @ np.linalg.inv(np.linalg.cholesky(covariance)).T
    # Heavier tails than normal: mismatch is cut off, not Gaussian, and shared by all records.
    fit = -0.5 * (5 + d * m) * np.log1p((white**2).sum(-1) / 5)
    motion = step[..., 0, 0] if m == 1 else np.linalg.det(step[..., :m, :])
    motion = np.abs(motion) / np.prod(x)
    return np.asarray(fit + d * np.log(np.maximum(motion, 1e-9)))


def transmission_errors(
    linear: LinearArm,
    pose: Array,
    on: NDArray[np.intp],
    b: Array,
    mismatch: Mismatch,
) -> Array:
    """Changes of the transmission, one for each independent error of the model [m] (K, d, m)."""
    zeros = joint_zero_errors(linear, pose, mismatch)[:, :, on]
    # Lengths in the rough: each tool axis by as much as the longest lever would change.
    longer = np.zeros((len(b), *b.shape))
    longer[np.arange(len(b)), np.arange(len(b))] = mismatch.length * np.abs(b).max()
    return np.concatenate([sensor_errors(b, mismatch), zeros, longer])


_TINY = 1e-300


def wishart_fit(found: Array, fixed: Array, added: Array, amounts: Array, degrees: float) -> Array:
    """Log-density of a covariance, less its highest value: 0 where expectation meets it.

    The expected covariance is ``fixed + amount * added``. Its determinant, and the trace of its
    inverse times the measured one, are ratios of polynomials in the amount, so the cofactors are
    worked out once for all amounts. Without rounding this is
    ``-degrees / 2 (tr(E⁻¹ F) - d - ln det(E⁻¹ F))``, the log-density of Wishart's distribution
    of ``degrees * F`` with scale E up to a constant.

    Parameters
    ----------
    found : ndarray (d, d)
        Covariance measured, positive definite; d is 2 or 3.
    fixed : ndarray (..., d, d)
        Constant part of the covariances expected, symmetric.
    added : ndarray (..., d, d)
        Part that comes in an unknown amount, symmetric; of any shape that broadcasts.
    amounts : ndarray (Q,)
        Amounts, zero or more.
    degrees : float
        Degrees of freedom.

    Returns
    -------
    ndarray (..., Q)

    Raises
    ------
    InvalidData
        If d is not 2 or 3.

    Examples
    --------
    >>> import numpy as np
    >>> wishart_fit(2 * np.eye(2), np.eye(2), np.eye(2), np.array([0.0, 1.0]), 10.0).round(2)
    array([-3.07,  0.  ])
    """
    d = len(found)
    if d not in (2, 3):
        raise InvalidData(f"the covariance must be 2 x 2 or 3 x 3, got {found.shape}")
    of_fixed, of_added = _cofactors(fixed), _cofactors(added)
    if d == 2:  # det(A + q B) = det A + q tr(adj A B) + q² det B
        determinant = [_det(fixed, of_fixed), _dot(of_fixed, added), _det(added, of_added)]
        numerator = [_dot(of_fixed, found), _dot(of_added, found)]
    else:
        determinant = [
            _det(fixed, of_fixed),
            _dot(of_fixed, added),
            _dot(fixed, of_added),
            _det(added, of_added),
        ]
        between = _cofactors(fixed + added) - of_fixed - of_added
        numerator = [_dot(of_fixed, found), _dot(between, found), _dot(of_added, found)]
    expected = np.maximum(_polynomial(determinant, amounts), _TINY)
    trace = _polynomial(numerator, amounts) / expected
    measured = np.log(max(np.linalg.det(found), _TINY))
    return np.asarray(-0.5 * degrees * (trace - d - measured + np.log(expected)))


def _polynomial(coefficients: list[Array], at: Array) -> Array:
    """Values of polynomials, lowest coefficient first, at all points (..., Q)."""
    stacked = np.stack(np.broadcast_arrays(*coefficients), axis=-1)
    return np.asarray(stacked @ at ** np.arange(len(coefficients))[:, None])


def _dot(a: Array, b: Array) -> Array:
    """Trace of the product of symmetric matrices (...)."""
    d = a.shape[-1]
    total = sum(a[..., i, i] * b[..., i, i] for i in range(d))
    mixed = sum(a[..., i, j] * b[..., i, j] for i in range(d) for j in range(i))
    return np.asarray(total + 2 * mixed)


def _det(matrix: Array, cofactors: Array) -> Array:
    """Determinant, along the first row (...)."""
    return np.asarray(sum(matrix[..., 0, i] * cofactors[..., 0, i] for i in range(len(matrix.T))))


def _cofactors(m: Array) -> Array:
    """Cofactors of symmetric 2 x 2 or 3 x 3 matrices (..., d, d)."""
    found = np.empty_like(m)
    if m.shape[-1] == 2:
        found[..., 0, 0], found[..., 1, 1] = m[..., 1, 1], m[..., 0, 0]
        found[..., 0, 1] = found[..., 1, 0] = -m[..., 0, 1]
        return found
    for i in range(3):
        for j in range(i + 1):
            a, b, c, e = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            found[..., i, j] = m[..., a, c] * m[..., b, e] - m[..., a, e] * m[..., b, c]
            found[..., j, i] = found[..., i, j]
    return found
