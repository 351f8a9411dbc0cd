"""Errors of sensors and nominal arm in a change of transmission.

An error is given as a mode: its effect, at one standard deviation, on the in-step acceleration of
every row under every command of a record.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Mismatch
from loose_env.diagnosis.multi_sensor.direction_search import UNKNOWN
from loose_env.diagnosis.multi_sensor.sensed_arm import SensedPose
from loose_env.diagnosis.multi_sensor.sensor_rows import SensorRows, StackedRecord
from loose_env.diagnosis.records.model_uncertainty import sensor_matrices
from loose_env.statistics import tangents
from loose_env.typing import Array

__all__ = [
    "against_nominal",
    "against_reference",
    "healthy_rest",
    "pattern_error",
    "sensor_error",
    "zero_error",
]


_LINEAR_ERROR = 0.005
"""Share of a sensor's motion that the linear model misses beside its parameters [1]."""
_MOTION_ERROR = 0.005
"""Share of a seat's free motion that shows where the nominal pattern has none [1]."""
_PATTERN_ERROR = 0.02
"""Share of a change that shows where the nominal pattern has none [1]."""


def against_reference(rows: SensorRows, change: Array, mismatch: Mismatch) -> tuple[Array, Array]:
    """Errors that remain where the same arm served as reference: those of the change itself.

    Gain, leakage and mounting of each sensor bend what it says of the change, alike in all
    excitations. A sensor with a single axis may lie across the seat's motion; what leaks into it
    is taken to follow the axis that shows most.

    Parameters
    ----------
    rows : SensorRows
        The measured axes.
    change : ndarray (D, M)
        In-step change under every command of every record.
    mismatch : Mismatch
        Standard deviations.

    Returns
    -------
    ndarray (r, D, M)
        Modes.
    ndarray (M,)
        Further variance of each row under each command.
    """
    same = rows.link[:, None] == rows.link
    moved = np.einsum("de,ec,em->dcm", same, rows.direction, change)
    alone = np.flatnonzero(same.sum(axis=1) == 1)
    most = change[np.argmax(np.sum(change**2, axis=1))]
    leaks = np.zeros((len(alone), *change.shape))
    leaks[np.arange(len(alone)), alone] = _across(mismatch) * most
    # Errors outside the pattern are common to all excitations: they count as often as shared.
    missed = _PATTERN_ERROR**2 * change.shape[1] * np.mean(change**2, axis=0)
    return np.concatenate([_by_sensors(rows, moved, mismatch), leaks]), missed


def _across(mismatch: Mismatch) -> float:
    """Share of what lies across an axis that leaks into it, one standard deviation."""
    return float(np.hypot(mismatch.cross_axis, np.radians(mismatch.misalignment)))


def _by_sensors(rows: SensorRows, motion: Array, mismatch: Mismatch) -> Array:
    """Change of every row by each sensor error, for motion (D, 3, m): (r, D, m)."""
    read = np.einsum("dc,kce,dem->kdm", rows.direction, sensor_matrices(3, mismatch), motion)
    of_sensor = np.unique(rows.link)[:, None] == rows.link
    return np.asarray((of_sensor[:, None, :, None] * read).reshape(-1, *read.shape[1:]))


def zero_error(
    rows: SensorRows, sites: NDArray[np.intp], at: SensedPose, direction: Array, mismatch: Mismatch
) -> Array:
    """Variance that the joints' zeros leave in each link's direction (n,) [rad²].

    They turn the sensors beyond a joint against the links before it, in every record alike. A
    joint counts by the share of the seat's motion that is read beyond it.

    Parameters
    ----------
    rows : SensorRows
        The measured axes.
    sites : ndarray (D,)
        Sensor of each row among those of the prediction.
    at : SensedPose
        The prediction.
    direction : ndarray (n, 3)
        Direction of each link in its seat's frame.
    mismatch : Mismatch
        Standard deviations.
    """
    n, _, axes = at.mass.shape
    column = np.einsum("dc,dcna,na->nd", rows.direction, at.column[sites], direction[:, :axes])
    power = column**2
    carrier = np.where(rows.link == 0, n, rows.link)
    beyond = carrier > np.arange(n)[:, None]  # joint j + 1 moves the row (joints, D)
    share = power @ beyond.T / np.maximum(power.sum(axis=1), 1e-12)[:, None]  # (links, joints)
    share = np.where(np.arange(n) > np.arange(n)[:, None], share, 0.0)
    across = np.sum(np.cross(at.turns, direction[:, None])[..., :axes] ** 2, axis=2)
    return np.asarray(np.radians(mismatch.joint_zero) ** 2 * np.sum(share**2 * across, axis=1))


def sensor_error(
    rows: SensorRows, sites: NDArray[np.intp], at: SensedPose, direction: Array, mismatch: Mismatch
) -> Array:
    """Variance floor of each link's direction by sensor errors [rad²].

    That of the best estimate from one seat motion without noise: what follows the commands and
    what does not are two looks at the seat through the same sensors. Arguments and shape as
    `zero_error`.
    """
    axes = at.mass.shape[1]
    column = np.einsum("dc,dcna->nda", rows.direction, at.column[sites])
    own = np.einsum("nda,na->nd", column, direction[:, :axes]) ** 2
    moved = np.einsum("dcna,na->ndc", at.column[sites], direction[:, :axes])
    whole = np.sum(moved**2, axis=2)
    across = _across(mismatch) ** 2
    off = mismatch.gain**2 * own + across * np.maximum(whole - own, 0.0) + 1e-8
    ways = np.stack([tangents(u[:axes]) for u in direction])
    seen = column @ ways.swapaxes(1, 2)  # (n, D, A-1)
    information = seen.swapaxes(1, 2) @ (seen / off[..., None])
    inside = information + np.eye(axes - 1) / UNKNOWN[2] ** 2
    return np.asarray(np.trace(np.linalg.inv(inside), axis1=1, axis2=2))


def pattern_error(
    rows: SensorRows, at: SensedPose, rest: Array, healthy: Array, mismatch: Mismatch
) -> tuple[Array, Array]:
    """Variances of what each row shows of a seat's motion beside its pattern [m²/s⁴].

    All that a record shows beyond the healthy arm is taken to be the seat's. A sensor's gain
    bends what a row sees; leakage and mounting bring in what lies across it. A sensor with a
    single axis is taken to move as much as any other, for it may lie across the motion. The
    variances are the same for all links, or their likelihoods could not be compared.

    Parameters
    ----------
    rows : SensorRows
        The measured axes.
    at : SensedPose
        The prediction.
    rest, healthy : ndarray (D, D)
        Covariance of what follows no joint, and the same of the healthy arm [m²/s⁴].
    mismatch : Mismatch
        Standard deviations.

    Returns
    -------
    ndarray (D,)
        By the sensors.
    ndarray (D,)
        By the model: bending that varies over the band, whatever sets it going.
    """
    across = _across(mismatch) ** 2
    same = rows.link[:, None] == rows.link
    alone = same.sum(axis=1) == 1

    def of_sensor(own: Array) -> Array:
        seen = same @ own
        unseen = np.maximum(at.mass.shape[1] * own, seen.max())
        return np.asarray(np.where(alone, unseen, seen))

    own = np.maximum(np.diag(rest - healthy), 0.0)
    whole = of_sensor(own)
    bent = (mismatch.gain**2 - across) * own + across * whole
    bent += _MOTION_ERROR**2 * whole.max()  # joints give: sensors before the seat move a little
    return bent, float(at.rough.max()) * of_sensor(np.diag(rest))


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
        Modes: gains, leakage and mounting, joint zeros, bending modes.
    """
    motion = at.transmission[sites] @ record.joint  # (D, 3, m)
    modes = list(_by_sensors(rows, motion, mismatch))
    for slope in at.slopes:
        shift = np.einsum("dc,dcm->dm", rows.direction, slope[sites]) @ record.joint
        modes.append(np.radians(mismatch.joint_zero) * shift)
    for change in at.bending:
        modes.append(np.einsum("dc,dcm->dm", rows.direction, change[sites]) @ record.joint)
    power = np.mean(np.sum(motion**2, axis=1), axis=1)
    largest = float(power.max())
    spread = _LINEAR_ERROR**2 * power + mismatch.length**2 * largest
    return np.asarray(spread), modes
