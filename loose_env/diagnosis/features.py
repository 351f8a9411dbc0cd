"""Transmission change of a record, and its features by seat location: inputs of the network.

For every location (a sliding direction of a link, or the play of a joint) the nominal arm says how
the record would have changed had that seat floated. The measured change is set against it in
units of what model and sampling leave open, beside what drives and loads the seat.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, LinearPoses, Mismatch
from loose_env.diagnosis.posterior import away_from, transmission_errors, unexplained
from loose_env.diagnosis.prediction import (
    INERTIA_ERROR,
    RecordStatistics,
    SeatPrediction,
    SensorFloor,
    channel_noise,
    independent_samples,
    joints_on,
    predict_seats,
    seat_drives,
    sensor_errors,
    stiffness_errors,
)
from loose_env.excitation import SeatReference
from loose_env.inference import whitener
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid
from loose_env.typing import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class TransmissionChange:
    """Change of the tool's in-step motion per command, as far as the transmission makes it."""

    measured: Array
    """As measured [m/s²] (d m,)."""
    open: Array
    """As each seat would make it by floating [m/s²] (P, d m)."""
    nominal: Array
    """The motion itself in the nominal arm [m/s²] (d m,)."""
    covariance: Array | None = None
    """Covariance by model errors, to first order, and sampling as the record shows it [m²/s⁴]
    (d m, d m); None where only the errors by source were asked for."""
    arm_errors: Array | None = None
    """What errors of joint zeros and springs make of it, one standard deviation each: the same at
    every sensor and in every record of an arm [m/s²] (K, d m); None where none is known."""
    sensor_errors: Array | None = None
    """What errors of the sensor and its levers make of it: the same in every record (L, d m)."""

    def __getitem__(self, k: int) -> TransmissionChange:
        """Change in one record of several."""
        own = {name: None if part is None else part[k] for name, part in vars(self).items()}
        return TransmissionChange(**own)  # type: ignore[arg-type]


def sampling_covariance(rest: ComplexArray, noise: Array, samples: float) -> Array:
    """Covariance of the motion in step with Gaussian commands in a record of finite length.

    Where the motion R (K, D, m) of an axis per unit-rms command, out of step with the joints,
    varies over the band so that its mean in step is zero, a record still shows some: with N samples

    ``cov(E_ij, E_kl) = mean over f of Re(δ_jl (R Rᴴ)_ik + R_il R_kj) / N``

    for axes i, k and commands j, l. On an arm that bends, these errors are far from even, and far
    from independent. ``noise`` (D, D) is that of the sensors in the band [m²/s⁴].
    """
    count, axes, commands = rest.shape
    power = np.einsum("fim,fkm->ik", rest, rest.conj()).real / count + noise
    crossed = np.einsum("fil,fkj->ijkl", rest, rest).real / count
    size = axes * commands
    covariance = np.kron(power, np.eye(commands)) + crossed.reshape(size, size)
    return np.asarray(covariance / samples)


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
        self.top = seat_drives(linear, self.directions, over)
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
        """Change at a sensor of which the transmission (d, m) in a record is known."""
        records = record.several
        poses, noise = self._placed(records)
        seats = predict_seats(poses, records.torque, self.directions, noise)
        errors = self.errors(poses, records.excited, transmission[None])
        return self._changed(transmission[None], seats, errors)[0]

    def _placed(self, records: RecordStatistics) -> tuple[LinearPoses, Array]:
        """The nominal arm in the records' poses, and the sensors' noise in each channel (B, p)."""
        noise = channel_noise(self.floor, self.linear.arm, joints_on(records.torque))
        return self.linear.at_all(records.pose), noise

    @property
    def locations(self) -> int:
        """Number of locations."""
        return len(self.top)

    def of(self, record: RecordStatistics) -> tuple[Array, Array]:
        """Features of one record: by location (P, 15), and of the record as a whole (12,)."""
        location, whole, _ = self.with_changes(record.several)
        return location[0], whole[0]

    def with_changes(self, records: RecordStatistics) -> tuple[Array, Array, TransmissionChange]:
        """Features as of `of` of B records with equally many joints on, and the changes behind."""
        arm, d = self.linear.arm, records.tool_covariance.shape[-1]
        poses, noise = self._placed(records)
        m = noise.shape[1] - d
        seats = predict_seats(poses, records.torque, self.directions, noise, free=True)
        b, residual = unexplained(records, seats, least=1e-3 * self.floor.tool**2)
        errors = self.errors(poses, records.excited, b)
        covariance = self.covariance(errors, residual, seats.in_step[:, :m], records.duration)
        change = replace(self._changed(b, seats, errors), covariance=covariance)
        white = whitener(covariance)
        seen = (white @ change.measured[..., None])[..., 0]
        opened = change.open @ white.mT
        power = (opened**2).sum(-1)
        inner = (opened @ seen[..., None])[..., 0]
        chi = (seen**2).sum(-1)[:, None]
        opening = inner / (power + 1.0)
        gain = inner**2 / (power + 1.0)
        inertia, inertia_open = self._inertias(records, seats)
        s = np.clip(opening, 0.0, 1.2)[..., None]
        inertia_left = ((inertia[:, None] - s * inertia_open) ** 2).sum(-1)
        inertia_chi = (inertia**2).sum(-1)[:, None]

        away = away_from(b)[:, None]
        loose = away @ seats.loose @ away.mT
        size = np.trace(loose, axis1=2, axis2=3)
        total, rest = (
            np.trace(part, axis1=1, axis2=2)[:, None]
            for part in (records.tool_covariance, residual)
        )
        axes = loose / np.maximum(size, _TINY)[..., None, None]
        beside = (axes * residual[:, None]).sum((2, 3))
        expected = (seats.in_step[:, m:] ** 2).sum((1, 2))[:, None]
        lowest = records.lowest_direction[:, None, :, None]
        along = np.diagonal(axes, axis1=2, axis2=3) @ records.kurtosis[..., None]
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
                np.log((beside + _TINY) / (total + _TINY)),
                np.log((size + _TINY) / (total + _TINY)),
                beside / np.maximum(rest, _TINY),
                (lowest.mT @ axes @ lowest)[..., 0, 0],
                np.arcsinh(along[..., 0]),
            ],
            axis=-1,
        )
        whole = np.stack(
            [
                np.log1p(chi[:, 0]),
                np.full(len(b), np.log(d * m)),
                np.log1p(inertia_chi[:, 0]),
                np.log((rest + _TINY) / (total + _TINY))[:, 0],
                0.5 * np.log((total + _TINY) / (expected + _TINY))[:, 0],
                np.log(records.duration),
                np.full(len(b), m / arm.n),
                0.5 * np.log((expected[:, 0] + _TINY) / arm.levels[-1] ** 2),
                np.arcsinh(records.kurtosis.max(-1)),
                np.arcsinh(records.lowest_kurtosis),
                np.arcsinh(np.abs(records.skewness).max(-1)),
                records.lowest_coherence,
            ],
            axis=-1,
        )
        return location, whole, change

    def _changed(self, b: Array, seats: SeatPrediction, errors: Array) -> TransmissionChange:
        """Changes of transmissions b (B, d, m), and by the errors of the model."""
        count, d, m = b.shape
        x, n = seats.in_step[:, :m], self.linear.arm.n
        nominal = seats.in_step[:, m:] @ np.linalg.inv(x)
        # The sensor's own, n joint zeros, the levers, then the springs.
        own = len(sensor_errors(b[:1], self.mismatch)[0])
        moved = errors @ x[:, None]
        sensor, zeros, levers, springs = np.split(moved, [own, own + n, own + n + d], axis=1)
        return TransmissionChange(
            measured=((b - nominal) @ x).reshape(count, -1),
            open=self.open_change(seats),
            nominal=(nominal @ x).reshape(count, -1),
            arm_errors=np.concatenate([zeros, springs], axis=1).reshape(count, -1, d * m),
            sensor_errors=np.concatenate([sensor, levers], axis=1).reshape(count, -1, d * m),
        )

    def open_change(self, seats: SeatPrediction) -> Array:
        """Change of the tool's in-step motion by each floating seat, per command (B, P, d m).

        The part which the change of transmission makes; the joints move as before.
        """
        p, m = seats.in_step.shape[1:]
        x = seats.in_step[:, :m]
        nominal = seats.in_step[:, m:] @ np.linalg.inv(x)
        opened = seats.in_step[:, None] + seats.in_step_open
        floating = opened[:, :, m:] @ np.linalg.inv(opened[:, :, :m])
        change = (floating - nominal[:, None]) @ x[:, None]
        return np.asarray(change.reshape(*change.shape[:2], (p - m) * m))

    def covariance(
        self, errors: Array, residual: Array, x: Array, duration: Array | float
    ) -> Array:
        """Covariances of in-step motion by model and sampling errors [m²/s⁴] (B, d m, d m).

        For errors of the transmission (B, K, d, m), motion of the tool (B, d, d) that does not
        follow the joints, and in-step motion x (B, m, m) of the joints.
        """
        d, m = errors.shape[2:]
        # In units of the tool's motion per command, in which sampling errors are even.
        uncertain = (errors @ x[:, None]).reshape(*errors.shape[:2], d * m)
        samples = np.reshape(independent_samples(self.linear.arm, duration), (-1, 1, 1))
        sampling = np.einsum("bij,kl->bikjl", residual / samples, np.eye(m))
        covariance = uncertain.mT @ uncertain + sampling.reshape(-1, d * m, d * m)
        share = 1e-6 * np.trace(covariance, axis1=1, axis2=2) / (d * m)
        return np.asarray(covariance + share[:, None, None] * np.eye(d * m))

    def errors(self, poses: LinearPoses, excited: NDArray[np.bool_], b: Array) -> Array:
        """Changes of transmissions (B, d, m) by each independent error of the model (B, K, d, m).

        There is a row for every spring in the band, zero for those of driven joints, so that
        records can be pooled.
        """
        errors = transmission_errors(poses, joints_on(excited), b, self.mismatch)
        if not self.bends:
            return errors
        return np.concatenate([errors, stiffness_errors(poses, excited, self.mismatch)], axis=1)

    def _inertias(self, records: RecordStatistics, seats: SeatPrediction) -> tuple[Array, Array]:
        """Change of the joints' motion per torque (B, m): measured, and by each seat (B, P, m)."""
        on = joints_on(records.torque)
        m = on.shape[1]
        nominal = np.diagonal(seats.in_step[:, :m], axis1=1, axis2=2)
        samples = independent_samples(self.linear.arm, records.duration)
        error = np.sqrt(INERTIA_ERROR**2 + 1 / samples)[:, None]
        # Inertia is torque over in-step motion of the joint itself; motion adds where inertia
        # does not.
        inertia, torque = (np.take_along_axis(x, on, 1) for x in (records.inertia, records.torque))
        found = torque / np.where(np.abs(inertia) < _TINY, _TINY, inertia)
        measured = np.clip(found / nominal - 1, -3.0, 3.0) / error
        opened = np.diagonal(seats.in_step_open[:, :, :m], axis1=2, axis2=3) / nominal[:, None]
        return measured, np.clip(opened / error[:, None], -100.0, 100.0)
