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

from loose_env.arms import Arm, LinearArm, Mismatch
from loose_env.diagnosis.posterior import transmission_errors, unexplained
from loose_env.diagnosis.prediction import (
    INERTIA_ERROR,
    RecordStatistics,
    SeatPrediction,
    SensorFloor,
    channel_noise,
    independent_samples,
    predict_seats,
    seat_drives,
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
        on = np.flatnonzero(record.excited)
        noise = channel_noise(self.floor, self.linear.arm, on)
        pose = self.linear.at(record.pose)
        seats = predict_seats(pose, record.torque, self.directions, noise, covariances=False)
        springs = self._springs(record.pose, record.excited)
        return self._changed(record, transmission, seats, springs)

    @property
    def locations(self) -> int:
        """Number of locations."""
        return len(self.top)

    def of(self, record: RecordStatistics) -> tuple[Array, Array]:
        """Features of one record: by location (P, 15), and of the record as a whole (12,)."""
        location, whole, _ = self.with_change(record)
        return location, whole

    def with_change(self, record: RecordStatistics) -> tuple[Array, Array, TransmissionChange]:
        """Features of one record as of `of`, and the change behind them."""
        arm = self.linear.arm
        on = np.flatnonzero(record.excited)
        m, d = len(on), len(record.tool_covariance)
        seats = predict_seats(
            self.linear.at(record.pose),
            record.torque,
            self.directions,
            channel_noise(self.floor, arm, on),
        )
        b, residual = unexplained(record, seats, least=1e-3 * self.floor.tool**2)
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
        white = whitener(covariance)
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
        beside = np.einsum("pij,ij->p", axes, residual)
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
                np.log((beside + _TINY) / (total + _TINY)),
                np.log((size + _TINY) / (total + _TINY)),
                beside / max(rest, _TINY),
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
        """Change of the tool's in-step motion by each floating seat, per command (P, d m).

        The part which the change of transmission makes; the joints move as before.
        """
        p, m = seats.in_step.shape
        x = seats.in_step[:m]
        nominal = seats.in_step[m:] @ np.linalg.inv(x)
        opened = seats.in_step + seats.in_step_open
        floating = opened[:, m:] @ np.linalg.inv(opened[:, :m])
        return np.asarray(((floating - nominal) @ x).reshape(-1, (p - m) * m))

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

        For a transmission b (d, m), motion of the tool (d, d) that does not follow the joints, and
        in-step motion x (m, m) of the joints; ``springs`` (K, d, m) are the errors by springs where
        known.
        """
        d, m = b.shape
        on = np.flatnonzero(excited)
        errors = transmission_errors(self.linear, pose, on, b, self.mismatch)
        springs = self._springs(pose, excited) if springs is None else springs
        errors = np.concatenate([errors, springs])
        # In units of the tool's motion per command, in which sampling errors are even.
        uncertain = (errors @ x).reshape(len(errors), d * m)
        sampling = np.kron(residual, np.eye(m)) / independent_samples(self.linear.arm, duration)
        covariance = uncertain.T @ uncertain + sampling
        covariance += 1e-6 * np.trace(covariance) / (d * m) * np.eye(d * m)
        return np.asarray(covariance)

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
        error = np.sqrt(
            INERTIA_ERROR**2 + 1 / independent_samples(self.linear.arm, record.duration)
        )
        # Inertia is torque over in-step motion of the joint itself; motion adds where inertia
        # does not.
        inertia = record.inertia[on]
        found = record.torque[on] / np.where(np.abs(inertia) < _TINY, _TINY, inertia)
        measured = np.clip(found / nominal - 1, -3.0, 3.0) / error
        opened = np.diagonal(seats.in_step_open[:, :m], axis1=1, axis2=2) / nominal / error
        return measured, np.clip(opened, -100.0, 100.0)
