"""From records in one pose to the change of transmission, with all its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.records.model_uncertainty import (
    bent_by_seats,
    calibrate_sensor,
    kinematic_errors,
    sensor_errors,
    stiffness_errors,
)
from loose_env.diagnosis.records.prediction import SensorFloor, predict
from loose_env.errors import InvalidData, UnknownName
from loose_env.rig import Measurement
from loose_env.statistics import (
    TransmissionEstimate,
    acceleration_from_angle,
    bandpass,
    estimate_transmission,
    join_transmissions,
    pool_transmissions,
)
from loose_env.typing import Array

__all__ = ["Instrument", "MeasuredChange", "change_of_transmission", "measured_transmission"]

Instrument = Literal["command", "encoder"]

_CHANGE_TOLERANCE = 0.005
"""Share of a change that the linear picture of an open seat gets wrong: the held joints move a
little with it, and impacts on stops excite what the arm's model leaves out."""
_REST_TOLERANCE = 2e-4
"""Share of the whole transmission that may change without anything sliding: a shut seat gives by
the stiffness of its stops, brakes and drives are not quite linear."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredChange:
    """Change of transmission in one pose, a column for each excited joint of each record."""

    estimate: TransmissionEstimate
    """Change and the covariance of all its errors, tool frame [m] (d, m)."""
    joints: NDArray[np.intp]
    """Joint of each column, from 0 (m,)."""
    reference: Array
    """Transmission that it is a change of [m] (d, m)."""
    sampling: TransmissionEstimate
    """The same change with the scatter of the records alone."""

    @property
    def ratio(self) -> float:
        """Size of the change over that of the reference (Frobenius norms) [1]."""
        size = float(np.linalg.norm(self.reference))
        return float(np.linalg.norm(self.estimate.b)) / size if size > 0 else 0.0

    @property
    def column_ratios(self) -> Array:
        """The same for each column (m,) [1]."""
        sizes = np.linalg.norm(self.reference, axis=0)
        return np.asarray(np.linalg.norm(self.estimate.b, axis=0) / np.maximum(sizes, 1e-12))


def measured_transmission(
    measurement: Measurement, *, instrument: Instrument = "command"
) -> TransmissionEstimate:
    """Estimate the transmission of one record, for its excited joints.

    Parameters
    ----------
    measurement : Measurement
        A record in which at least one joint was excited.
    instrument : {"command", "encoder"}
        Instrument of the regression: the commanded torque, which knows nothing of encoder noise,
        or the measured joint motion itself, which wastes less of the record where encoders are good
        or friction and servos loosen the joint from its command.

    Raises
    ------
    InvalidData
        If the measurement failed, nothing moves, or nothing was excited.
    UnknownName
        If there is no such instrument.
    """
    if instrument not in ("command", "encoder"):
        raise UnknownName(f"unknown instrument {instrument!r}: 'command' or 'encoder'")
    if measurement.failure is not None:
        raise InvalidData(f"the measurement failed: {measurement.failure}")
    on = np.flatnonzero(measurement.excited)
    if not len(on):
        raise InvalidData("no joint was excited in this record: nothing is transmitted")
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    tool = bandpass(measurement.tool, rate, band)
    command = bandpass(measurement.command[on], rate, band) if instrument == "command" else None
    return estimate_transmission(joint, tool, rate, command=command)


def change_of_transmission(
    linear: LinearArm,
    records: Sequence[Measurement],
    *,
    healthy: Sequence[Measurement] | None = None,
    mismatch: Mismatch | None = None,
    instrument: Instrument = "command",
) -> MeasuredChange:
    """Compare records of one pose with the healthy arm in that pose.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    records : sequence of Measurement
        Records of the arm under test, all in one pose: each joint in turn, several at once, or the
        same again. Records of the same joints are averaged.
    healthy : sequence of Measurement, optional
        Records of the same arm when it was healthy, with the same joints excited in the same pose.
        Without them the nominal model says what a healthy arm would transmit.
    mismatch : Mismatch, optional
        Errors of model and sensors; the defaults of `Mismatch`.
    instrument : {"command", "encoder"}
        As in `measured_transmission`.

    Returns
    -------
    MeasuredChange
        With the nominal model as reference, the errors of sensors and model are in its
        covariance. With healthy records, the model is used to calibrate the accelerometer on
        them, and what stays unknown of it acts on the change alone.

    Raises
    ------
    InvalidData
        If there is no record, the poses differ, a record cannot be used, or no healthy record has
        the same joints excited.
    """
    if not records:
        raise InvalidData("no record is given; one or more in the same pose are needed")
    pose = records[0].pose
    for record in [*records, *(healthy or ())]:
        if record.pose.shape != pose.shape or np.abs(record.pose - pose).max() > 1e-6:
            raise InvalidData(
                f"records of one pose are needed, got {pose.round(4).tolist()} and "
                f"{record.pose.round(4).tolist()}"
            )
    assumed = Mismatch() if mismatch is None else mismatch
    now = _by_joints(records, instrument)
    columns = [j for joints in now for j in joints]
    measured = join_transmissions(list(now.values()))
    played = [_played(linear, records, joints) for joints in now]
    nominal = np.concatenate([_nominal(arm, r, instrument) for arm, r in played], axis=1)
    kinematic = kinematic_errors(linear, pose, assumed)[:, :, columns]
    if healthy is None:
        reference, change = nominal, measured.minus(nominal)
        springs = [stiffness_errors(arm, pose, r.excited, assumed) for arm, r in played]
        errors = np.concatenate([sensor_errors(measured.b, assumed), kinematic, _apart(springs)])
    else:
        before = _by_joints(healthy, instrument)
        missing = [joints for joints in now if joints not in before]
        if missing:
            raise InvalidData(
                f"no healthy record excites joints {[j + 1 for j in missing[0]]} together, as a "
                "record of the arm under test does; healthy records excite "
                f"{[[j + 1 for j in joints] for joints in before]}"
            )
        intact = join_transmissions([before[joints] for joints in now])
        sensor, left = calibrate_sensor(intact, nominal, kinematic, assumed)
        reference, change = intact.b, measured.minus(intact).turned(np.linalg.inv(sensor))
        errors = left @ change.b
    bent = np.concatenate([bent_by_seats(arm.at(pose), r.excited) for arm, r in played])
    # The loose link is unknown: a uniform prior.
    errors = np.concatenate([errors, np.einsum("mkde,em->kdm", bent, change.b) / linear.arm.n**0.5])
    return MeasuredChange(
        estimate=change.with_errors(np.concatenate([errors, _coarse(change, reference)])),
        joints=np.array(columns, dtype=np.intp),
        reference=reference,
        sampling=change,
    )


def _by_joints(
    records: Sequence[Measurement], instrument: Instrument
) -> dict[tuple[int, ...], TransmissionEstimate]:
    """Estimates of each set of excited joints, records of the same set averaged."""
    groups: dict[tuple[int, ...], list[TransmissionEstimate]] = {}
    for record in records:
        joints = tuple(int(j) for j in np.flatnonzero(record.excited))
        groups.setdefault(joints, []).append(measured_transmission(record, instrument=instrument))
    return {joints: pool_transmissions(found) for joints, found in groups.items()}


def _played(
    linear: LinearArm, records: Sequence[Measurement], joints: tuple[int, ...]
) -> tuple[LinearArm, Measurement]:
    """A record in which these joints were excited, and the arm in its band."""
    record = next(r for r in records if tuple(np.flatnonzero(r.excited)) == joints)
    band = record.excitation.band
    arm = linear if band == linear.arm.band else linear.variant(replace(linear.arm, band=band))
    return arm, record


def _nominal(linear: LinearArm, record: Measurement, instrument: Instrument) -> Array:
    """Transmission of the nominal arm in a record, brakes and modes included."""
    quiet = SensorFloor(joint=0.0, tool=0.0)
    expected = predict(linear.at(record.pose), record.excitation, quiet)
    if instrument == "encoder":
        return expected.transmission
    return expected.transmission_by_instrument


def _apart(errors: Sequence[Array]) -> Array:
    """Errors of sets of columns, each (K, d, m) and without effect on the others (K, d, m)."""
    columns = sum(e.shape[2] for e in errors)
    spread, start = [], 0
    for e in errors:
        wide = np.zeros((*e.shape[:2], columns))
        wide[:, :, start : start + e.shape[2]] = e
        spread.append(wide)
        start += e.shape[2]
    return np.concatenate(spread)


def _coarse(change: TransmissionEstimate, reference: Array) -> Array:
    """Errors in every direction, in proportion to loose motion and transmission (K, d, m)."""
    d, m = change.b.shape
    loose = np.sum(change.b**2, axis=0) + np.einsum("imim->m", change.covariance)
    whole = np.sum(reference**2, axis=0)
    sizes = np.sqrt(_CHANGE_TOLERANCE**2 * loose + _REST_TOLERANCE**2 * whole)
    errors = np.zeros((d, m, d, m))
    for i in range(d):
        for j in range(m):
            errors[i, j, i, j] = sizes[j]
    return errors.reshape(d * m, d, m)
