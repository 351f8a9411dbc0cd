"""Features of one record by location of the loose seat, inputs of the network.

For every location (a sliding direction of a link, or the play of a joint) the nominal arm says how
the record would have changed had that seat floated. The measured change is set against it in
units of what model and sampling leave open, beside what drives and loads the seat.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, Mismatch
from loose_env.diagnosis.learned.transmission_change import TransmissionChange
from loose_env.diagnosis.likelihood.record_likelihood import joint_covariance, transmission_errors
from loose_env.diagnosis.likelihood.seat_response import SeatPrediction, predict_seats
from loose_env.diagnosis.records.model_uncertainty import stiffness_errors
from loose_env.diagnosis.records.prediction import SensorFloor
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.excitation import SeatDrive, SeatReference
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid
from loose_env.typing import Array

__all__ = ["LOCATION_FEATURES", "RECORD_FEATURES", "SeatFeatures"]


LOCATION_FEATURES = (
    "opening",  # how far the seat would have to float, 1: freely
    "gain",  # log(1 + what that explains of the change, chi²)
    "left",  # log(1 + what it leaves, chi²)
    "visible",  # log(1 + chi² of a freely floating seat)
    "alike",  # cosine between measured and predicted change
    "drive",  # log force on the shut seat over that of the top level
    "load",  # log(1 + gravity over that force)
    "inertia_gain",  # log(1 + what that opening explains of the inertias' change)
    "inertia_left",  # log(1 + what it leaves)
    "inertia_visible",  # log(1 + change of the inertias if it floats)
    "loose",  # log of unexplained motion along the seat's, over all motion of the tool
    "loose_expected",  # log of a floating seat's motion over all motion of the tool
    "loose_share",  # share of the unexplained motion that lies along the seat's
    "lowest",  # squared cosine between the seat's motion and the lowest coherence
    "kurtosis",  # kurtosis of the axes along which the seat moves the tool
)
"""Features of every location, in order."""

RECORD_FEATURES = (
    "change",  # log(1 + chi² of the change of transmission)
    "numbers",  # log of the number of its elements
    "inertia_change",  # log(1 + chi² of the inertias' change)
    "rest",  # log of unexplained motion over all motion of the tool
    "tool",  # log of the tool's motion over what was predicted
    "duration",  # log of the record's length over 1 s
    "excited",  # share of joints excited
    "level",  # log of the predicted tool motion over the top level
    "kurtosis",  # largest of the axes
    "lowest_kurtosis",  # along the lowest coherence
    "skewness",  # largest of the axes
    "coherence",  # lowest coherence
)
"""Features of the record as a whole, in order."""

_INERTIA_ERROR = 0.03
_TINY = 1e-12


class SeatFeatures:
    """Features of the records of one arm.

    Places are the sliding directions of link 1, those of link 2, ..., then the joints' plays:
    P = n A + n of them.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite
        Figures of the sensors.
    mismatch : Mismatch
        Errors of the nominal model.
    directions : int
        Sliding directions of each link, A.
    points : int, optional
        Frequencies across the band; by default 6, or 40 where modes lie within the band.
    over : {"median", "best"}
        Pose whose seat drive friction is compared to.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> features = SeatFeatures(LinearArm(planar(2)), SensorSuite(), Mismatch(), directions=8)
    >>> features.locations, len(features.hypothesis)
    (18, 18)
    """

    def __init__(
        self,
        linear: LinearArm,
        sensors: SensorSuite,
        mismatch: Mismatch,
        *,
        directions: int,
        points: int | None = None,
        over: SeatReference = "median",
    ) -> None:
        arm = linear.arm
        self.bends = bool(len(linear.flexible_dofs)) or arm.hold != "brake"
        count = points if points is not None else (40 if self.bends else 6)
        self.linear = LinearArm(arm, points=count, remember=64)
        self.mismatch = mismatch
        self.floor = SensorFloor.of(sensors, arm.band)
        self.directions = axes_grid(directions, len(arm.axes))
        """Sliding directions in a link's frame, unit vectors (A, axes)."""
        drive = SeatDrive(linear, over=over)
        top = [drive.slide(link, tuple(u)) for link in range(1, arm.n + 1) for u in self.directions]
        top += [drive.hinge(joint) for joint in range(1, arm.n + 1)]
        self.top = np.maximum(top, 1e-9 * max(top))
        """Rms force of the top level across every seat (P,)."""
        self.hypothesis = np.concatenate(
            [np.repeat(np.arange(arm.n), directions), arm.n + np.arange(arm.n)]
        )
        """Hypothesis of each location: slides 0 to n - 1, plays n to 2 n - 1 (P,)."""

    def sensed_at(self, arm: Arm) -> SeatFeatures:
        """The same features at another sensor: of an arm with that sensor as its tool."""
        other = copy.copy(self)
        other.linear = LinearArm(arm, points=len(self.linear.frequency), remember=64)
        return other

    def change_at(self, record: RecordStatistics, transmission: Array) -> TransmissionChange:
        """Change at a sensor of which the transmission is known.

        Parameters
        ----------
        record : RecordStatistics
            The record: pose, torque and duration.
        transmission : ndarray (d, m)
            Acceleration per joint acceleration, the command as instrument.
        """
        on = np.flatnonzero(record.excited)
        noise = np.full(len(transmission), self.floor.tool)
        noise = np.concatenate([self.floor.joints(self.linear.arm)[on], noise])
        pose = self.linear.at(record.pose)
        torque, directions = record.torque, self.directions
        seats = predict_seats(pose, torque, directions, noise**2, covariances=False)
        springs = self._springs(record.pose, record.excited)
        return self._changed(record, transmission, seats, springs)

    @property
    def locations(self) -> int:
        """Number of locations."""
        return len(self.top)

    def of(self, record: RecordStatistics) -> tuple[Array, Array]:
        """Features of one record.

        Parameters
        ----------
        record : RecordStatistics
            Record with at least one joint excited.

        Returns
        -------
        ndarray (P, 15)
            By location, `LOCATION_FEATURES`.
        ndarray (12,)
            Of the record, `RECORD_FEATURES`.
        """
        location, whole, _ = self.with_change(record)
        return location, whole

    def with_change(self, record: RecordStatistics) -> tuple[Array, Array, TransmissionChange]:
        """Features of one record, and the change behind them.

        Parameters
        ----------
        record : RecordStatistics
            Record with at least one joint excited.
        """
        arm = self.linear.arm
        on = np.flatnonzero(record.excited)
        m, d = len(on), len(record.tool_covariance)
        noise = np.concatenate([self.floor.joints(arm)[on], np.full(d, self.floor.tool)]) ** 2
        pose = self.linear.at(record.pose)
        seats = predict_seats(pose, record.torque, self.directions, noise)
        b = record.transmission_by_instrument[:, on]
        joint = joint_covariance(record.joint_rms[on], seats.in_step[:m], seats.rest[:m, :m])
        mixed = joint @ record.transmission[:, on].T
        residual = record.tool_covariance - b @ mixed - mixed.T @ b.T + b @ joint @ b.T
        size, along = np.linalg.eigh(residual)
        residual = along @ np.diag(np.maximum(size, 1e-3 * self.floor.tool**2)) @ along.T
        springs = self._springs(record.pose, record.excited)
        covariance = self.covariance(
            record.pose,
            record.excited,
            b,
            residual,
            seats.in_step[:m],
            record.duration,
            springs=springs,
        )
        change = replace(self._changed(record, b, seats, springs), covariance=covariance)
        white = _whitening(covariance)
        seen, opened = white @ change.measured, change.open @ white.T
        power = (opened**2).sum(-1)
        inner = opened @ seen
        chi = float(seen @ seen)
        opening = inner / (power + 1.0)
        gain = inner**2 / (power + 1.0)
        inertia, inertia_open = self._inertias(record, on, seats)
        s = np.clip(opening, 0.0, 1.2)[:, None]
        inertia_left = ((inertia - s * inertia_open) ** 2).sum(-1)
        inertia_chi = float(inertia @ inertia)

        away = np.concatenate([-b, np.eye(d)], axis=1)
        loose = away @ seats.loose @ away.T
        size = np.trace(loose, axis1=1, axis2=2)
        total = float(np.trace(record.tool_covariance))
        axes = loose / np.maximum(size, _TINY)[:, None, None]
        unexplained = np.einsum("pij,ij->p", axes, residual)
        rest = float(np.trace(residual))
        expected = float(np.trace(seats.in_step[m:] @ seats.in_step[m:].T))
        location = np.stack(
            [
                np.clip(opening, -1.5, 2.5),
                np.log1p(gain),
                np.log1p(np.maximum(chi - gain, 0.0)),
                np.log1p(power),
                inner / np.sqrt((power + _TINY) * (chi + _TINY)),
                np.log(np.maximum(seats.force / self.top, 1e-4)),
                np.log1p(seats.load / np.maximum(seats.force, 1e-9 * self.top)),
                np.log1p(np.maximum(inertia_chi - inertia_left, 0.0)),
                np.log1p(inertia_left),
                np.log1p((inertia_open**2).sum(-1)),
                np.log((unexplained + _TINY) / (total + _TINY)),
                np.log((size + _TINY) / (total + _TINY)),
                unexplained / max(rest, _TINY),
                np.einsum("pij,i,j->p", axes, record.lowest_direction, record.lowest_direction),
                np.arcsinh(np.einsum("pii,i->p", axes, record.kurtosis)),
            ],
            axis=1,
        )
        whole = np.array(
            [
                np.log1p(chi),
                np.log(d * m),
                np.log1p(inertia_chi),
                np.log((rest + _TINY) / (total + _TINY)),
                0.5 * np.log((total + _TINY) / (expected + _TINY)),
                np.log(record.duration),
                m / arm.n,
                0.5 * np.log((expected + _TINY) / arm.levels[-1] ** 2),
                np.arcsinh(record.kurtosis.max()),
                np.arcsinh(record.lowest_kurtosis),
                np.arcsinh(np.abs(record.skewness).max()),
                record.lowest_coherence,
            ]
        )
        return location, whole, change

    def _changed(
        self, record: RecordStatistics, b: Array, seats: SeatPrediction, springs: Array
    ) -> TransmissionChange:
        """Change of transmission b (d, m), with the changes by errors of the springs (K, d, m)."""
        x = seats.in_step[: b.shape[1]]
        nominal = seats.in_step[b.shape[1] :] @ np.linalg.inv(x)
        pose, on, n = record.pose, np.flatnonzero(record.excited), self.linear.arm.n
        errors = transmission_errors(self.linear, pose, on, b, self.mismatch)
        first = len(errors) - len(b) - n  # the sensor's own, n joint zeros, then the levers
        sensor, zeros, levers = np.split(errors, [first, first + n])
        # A row for every spring, those of driven joints zero, so that records can be pooled.
        modes = len(springs) - int((~record.excited).sum())
        held = modes + np.flatnonzero(~record.excited)
        sprung = np.zeros((modes + n if len(springs) else 0, *b.shape))
        if len(springs):
            sprung[np.concatenate([np.arange(modes), held])] = springs
        return TransmissionChange(
            measured=((b - nominal) @ x).ravel(),
            open=self.open_change(seats),
            nominal=(nominal @ x).ravel(),
            arm_errors=(np.concatenate([zeros, sprung]) @ x).reshape(-1, b.size),
            sensor_errors=(np.concatenate([sensor, levers]) @ x).reshape(-1, b.size),
        )

    def open_change(self, seats: SeatPrediction) -> Array:
        """Change of the tool's in-step motion if each seat floats, per command (P, d m).

        That part of it which the change of transmission makes; the joints move as before.
        """
        p, m = seats.in_step.shape
        x = seats.in_step[:m]
        nominal = seats.in_step[m:] @ np.linalg.inv(x)
        opened = seats.in_step + seats.in_step_open
        floating = opened[:, m:] @ np.linalg.inv(opened[:, :m])
        return np.asarray(((floating - nominal) @ x).reshape(-1, (p - m) * m))

    def whitening(
        self,
        pose: Array,
        excited: NDArray[np.bool_],
        b: Array,
        residual: Array,
        x: Array,
        duration: float,
    ) -> Array:
        """Matrix that brings changes of in-step motion to standard deviations (d m, d m).

        Its parameters are those of `covariance`.
        """
        return _whitening(self.covariance(pose, excited, b, residual, x, duration))

    def covariance(
        self,
        pose: Array,
        excited: NDArray[np.bool_],
        b: Array,
        residual: Array,
        x: Array,
        duration: float,
        *,
        springs: Array | None = None,
    ) -> Array:
        """Covariance of in-step motion by model and sampling errors [m²/s⁴] (d m, d m).

        Parameters
        ----------
        pose : ndarray (n,)
            Pose of the record [rad or m].
        excited : ndarray of bool (n,)
            Joints that are excited.
        b : ndarray (d, m)
            Transmission [m].
        residual : ndarray (d, d)
            Covariance of the tool's motion that does not follow the joints [m²/s⁴].
        x : ndarray (m, m)
            In-step motion of the excited joints per command [rad/s²].
        duration : float
            Length of the record [s].
        springs : ndarray (K, d, m), optional
            Changes of the transmission by errors of the springs [m], where they are known.
        """
        d, m = b.shape
        on = np.flatnonzero(excited)
        errors = transmission_errors(self.linear, pose, on, b, self.mismatch)
        springs = self._springs(pose, excited) if springs is None else springs
        errors = np.concatenate([errors, springs])
        # In units of the tool's motion per command, in which sampling errors are even.
        uncertain = (errors @ x).reshape(len(errors), d * m)
        sampling = np.kron(residual, np.eye(m)) / self.samples(duration)
        covariance = uncertain.T @ uncertain + sampling
        covariance += 1e-6 * np.trace(covariance) / (d * m) * np.eye(d * m)
        return np.asarray(covariance)

    def samples(self, duration: float) -> float:
        """Independent samples in a record of some length [s]."""
        low, high = self.linear.arm.band
        return 2 * (high - low) * duration

    def _springs(self, pose: Array, excited: NDArray[np.bool_]) -> Array:
        """Change of the transmission by an error of each spring in the band (K, d, m)."""
        if self.bends:
            return stiffness_errors(self.linear, pose, excited, self.mismatch)
        return np.zeros((0, len(self.linear.arm.axes), int(excited.sum())))

    def _inertias(
        self, record: RecordStatistics, on: NDArray[np.intp], seats: SeatPrediction
    ) -> tuple[Array, Array]:
        """Change of the joints' motion per torque: measured, and if each seat floats (P, m)."""
        m = len(on)
        nominal = np.diag(seats.in_step[:m])
        samples = 2 * (self.linear.arm.band[1] - self.linear.arm.band[0]) * record.duration
        error = np.sqrt(_INERTIA_ERROR**2 + 1 / samples)
        # Inertia is torque over in-step motion of the joint itself; motion adds where inertia
        # does not.
        inertia = record.inertia[on]
        found = record.torque[on] / np.where(np.abs(inertia) < _TINY, _TINY, inertia)
        measured = np.clip(found / nominal - 1, -3.0, 3.0) / error
        opened = np.diagonal(seats.in_step_open[:, :m], axis1=1, axis2=2) / nominal / error
        return measured, np.clip(opened, -100.0, 100.0)


def _whitening(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
