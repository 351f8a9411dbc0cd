"""What sensors and the nominal arm may get wrong about a change of transmission.

An error is given as a mode: its effect, at one standard deviation, on the in-step acceleration of
every row under every command of a record.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.mismatch import Mismatch
from loose_env.diagnosis.sensed_arm import SensedPose
from loose_env.diagnosis.sensor_rows import SensorRows, StackedRecord

__all__ = ["against_nominal", "against_reference", "healthy_rest", "pattern_error"]

Array = NDArray[np.float64]

_LINEAR_ERROR = 0.005
"""Share of a sensor's motion that the linear model misses beside its parameters [1]."""
_PATTERN_ERROR = 0.02
"""Share of a change that shows where the nominal pattern has none [1]."""


def against_reference(rows: SensorRows, change: Array, mismatch: Mismatch) -> tuple[Array, Array]:
    """Errors that remain where the same arm served as reference: those of the change itself.

    Gain, leakage and mounting of each sensor bend what it says of the change; the part across
    a single axis, which it does not measure, is taken to be as large as that along it.

    Returns
    -------
    ndarray (r, D, m)
        Modes.
    ndarray (D,)
        Further variance of each row.
    """
    across = np.hypot(mismatch.cross_axis, np.radians(mismatch.misalignment))
    same = rows.link[:, None] == rows.link
    along = np.abs(rows.direction @ rows.direction.T)
    alone = same.sum(axis=1) == 1
    deviation = mismatch.gain * along + across * (1 - along)
    deviation = np.hypot(deviation, np.where(alone, across, 0.0)[:, None])
    i, j = np.nonzero(same)
    modes = np.zeros((len(i), *change.shape))
    modes[np.arange(len(i)), i] = deviation[i, j, None] * change[j]
    size = float(np.mean(np.sum(change**2, axis=0)))
    return modes, np.full(len(rows), _PATTERN_ERROR**2 * size / len(rows))


def pattern_error(mismatch: Mismatch) -> float:
    """Relative error of a pattern over sensors: their gains, leakage, mounting, and the model."""
    across = np.hypot(mismatch.cross_axis, np.radians(mismatch.misalignment))
    return float(np.sqrt(mismatch.gain**2 + across**2 + _PATTERN_ERROR**2))


def healthy_rest(
    rows: SensorRows,
    sites: NDArray[np.intp],
    at: SensedPose,
    record: StackedRecord,
    tool: float,
    joint: Array,
) -> Array:
    """Covariance of what follows no joint on the nominal healthy arm (D, D) [m²/s⁴].

    ``tool`` and ``joint`` (m,) are the standard deviations that the accelerometers and the readings
    of the excited joints have in the band; the latter come in through the transmission, as joint
    motion is taken off as read. See `against_nominal` for the other arguments.
    """
    torque = record.torque[record.excited]
    wide = np.zeros((len(rows), 3 * len(at.transmission)))
    for row, (site, direction) in enumerate(zip(sites, rows.direction, strict=True)):
        wide[row, 3 * site : 3 * site + 3] = direction
    motion = at.transmission[sites] @ record.joint
    missed = _LINEAR_ERROR**2 * np.sum(motion**2, axis=(1, 2))
    read = record.transmission * joint
    own = read @ read.T + np.diag(tool**2 + missed)
    return np.asarray(wide @ (at.rest @ torque**2) @ wide.T + own)


def against_nominal(
    rows: SensorRows,
    sites: NDArray[np.intp],
    at: SensedPose,
    record: StackedRecord,
    mismatch: Mismatch,
) -> tuple[Array, list[Array]]:
    """Errors of the healthy motion where the nominal arm serves as reference.

    Parameters
    ----------
    rows : SensorRows
        The measured axes.
    sites : ndarray (D,)
        Sensor of each row among those of the prediction.
    at : SensedPose
        The prediction.
    record : StackedRecord
        The record, for how far the joints move.
    mismatch : Mismatch
        Standard deviations.

    Returns
    -------
    ndarray (D,)
        Further variance of each row: lengths, and what a linear model misses.
    list of ndarray (D, m)
        Modes: each row's gain and leakage, joint zeros, bending modes.
    """
    motion = at.transmission[sites] @ record.joint  # (D, 3, m)
    across = np.hypot(mismatch.cross_axis, np.radians(mismatch.misalignment))
    count = len(rows)
    frames = _frames(rows.direction)
    deviation = np.array([mismatch.gain, across, across])
    leak = deviation[:, None] * (frames @ motion)  # (D, 3, m)
    each = np.zeros((count, 3, count, motion.shape[2]))
    each[np.arange(count), :, np.arange(count)] = leak
    modes = list(each.reshape(3 * count, count, -1))
    for slope in at.slopes:
        shift = np.einsum("dc,dcm->dm", rows.direction, slope[sites]) @ record.joint
        modes.append(np.radians(mismatch.joint_zero) * shift)
    for change in at.bending:
        modes.append(np.einsum("dc,dcm->dm", rows.direction, change[sites]) @ record.joint)
    power = np.mean(np.sum(motion**2, axis=1), axis=1)
    largest = float(power.max())
    spread = _LINEAR_ERROR**2 * power + mismatch.length**2 * largest
    return np.asarray(spread), modes


def _frames(direction: Array) -> Array:
    """Orthonormal frames whose first axis is each direction, axes as rows (D, 3, 3)."""
    first = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = first - np.sum(first * direction, axis=1, keepdims=True) * direction
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([direction, first, np.cross(direction, first)], axis=1)
