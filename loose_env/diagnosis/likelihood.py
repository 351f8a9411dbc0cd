"""How well one record fits each place, opening and amount of loose motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.linear import LinearArm
from loose_env.arms.mismatch import Mismatch
from loose_env.diagnosis.model_errors import joint_zero_errors, sensor_errors
from loose_env.diagnosis.prediction import SensorFloor
from loose_env.diagnosis.record import RecordStatistics
from loose_env.diagnosis.seat_prediction import predict_seats
from loose_env.diagnosis.wishart import wishart_fit

__all__ = [
    "LOOSE",
    "OPENINGS",
    "SHUT",
    "Fit",
    "fit_record",
    "joint_covariance",
    "transmission_errors",
]

Array = NDArray[np.float64]

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
    """Over places, openings and loose motion (P, S, Q)."""
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
    """Work out the likelihood of a record.

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
        What was measured.
    directions : ndarray (A, axes)
        Sliding directions to try.
    floor : SensorFloor
        What the sensors add.
    mismatch : Mismatch
        How far the nominal model may be off.
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
    # What float32 readings and the linear model itself leave, however good the sensors are.
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
    # What the sensors add is no motion: it keeps its size.
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
