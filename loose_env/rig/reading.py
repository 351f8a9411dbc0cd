"""Torques that a run plays, and conversion of simulated motion to readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, MismatchDraw
from loose_env.excitation import torque_periods
from loose_env.rig.measurement import Job, Measurement
from loose_env.sensors import SensorSuite, low_passed, read_accelerometer, read_encoder
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Controls:
    """Torques of J records of one length, within the drives' limits, and the shaker's force."""

    periods: Array
    """One period of each signal that varies, gravity included (R, steps of a period)."""
    records: NDArray[np.intp]
    """Record of each of them (R,)."""
    drives: NDArray[np.intp]
    """Joint of each of them; n for the shaker (R,)."""
    constant: Array
    """Torque of the drives that do not vary, zero for the others (J, n) [N·m]."""
    gravity: Array
    """Torque that holds each joint of the nominal arm against gravity (J, n) [N·m]."""

    def signals(self, *, drives: int, before: int, after: int) -> Array:
        """Torques of every step, and the shaker force if present (J, steps, drives).

        ``before`` and ``after`` are steps of run-in and run-out around the record.
        """
        jobs, n = self.constant.shape
        steps = np.arange(-before, self.periods.shape[1] + after) % self.periods.shape[1]
        control = np.zeros((jobs, len(steps), drives))
        control[..., :n] = self.constant[:, None]
        for row, job, drive in zip(self.periods, self.records, self.drives, strict=True):
            control[job, :, drive] = row[steps]
        return control

    def commands(self, factor: int, count: int) -> Array:
        """Commanded torque less gravity's at every reading (J, n, count) [N·m].

        ``factor`` is the number of steps per reading.
        """
        jobs, n = self.constant.shape
        command = np.zeros((jobs, n, count))
        steady = np.where(self.constant != 0, self.constant - self.gravity, 0.0)
        command += steady[..., None]
        for row, job, drive in zip(self.periods, self.records, self.drives, strict=True):
            if drive < n:
                command[job, drive] = row[::factor][:count] - self.gravity[job, drive]
        return command


def controls(nominal: LinearArm, jobs: Sequence[Job], *, timestep: float) -> Controls:
    """Sample the torques of measurements of one length; each draws from its own generator."""
    arm = nominal.arm
    limits = np.array(arm.torque_limits)
    periods, records, drives = torque_periods(
        [job.excitation for job in jobs], timestep=timestep, rngs=[job.rng for job in jobs]
    )
    gravity = np.array([nominal.at(job.pose).gravity_torque for job in jobs])
    constant = np.clip(gravity, -limits, limits)
    for row, job, drive in zip(periods, records, drives, strict=True):
        if drive < arm.n:
            row += gravity[job, drive]
            constant[job, drive] = 0.0
            most = limits[drive]
        elif arm.shaker is not None:
            most = arm.shaker.force_limit
        np.clip(row, -most, most, out=row)
    return Controls(
        periods=periods, records=records, drives=drives, constant=constant, gravity=gravity
    )


class AxesRead:
    """Accelerometer axes that are read, of all sensors one after the other: tool, links, probes."""

    def __init__(self, arm: Arm, sensors: SensorSuite) -> None:
        choice = sensors.on_links
        axes = list(arm.axes)
        self.link_axes = [0] if choice is not None and choice.tangential else axes
        self.links: tuple[int, ...] = () if choice is None else choice.on(arm)
        """Links that carry an accelerometer."""
        self.on_links = choice is not None
        self.probes = arm.probe_sites
        self.tool = len(axes)
        """Axes of the tool's accelerometer."""
        each = [axes] + [self.link_axes] * len(self.links) + [[0, 1, 2]] * len(self.probes)
        self.sensor = np.repeat(np.arange(len(each)), [len(own) for own in each])
        """Accelerometer of each axis, in the order of the channels (S,)."""
        self._axes = np.concatenate(each)
        owners = [-1, *(link - 1 for link in self.links)] + [-1] * len(self.probes)
        self._owners = np.array(owners)[self.sensor]

    def mixing(self, mismatches: Sequence[MismatchDraw]) -> Array:
        """Output of each axis per true acceleration: gains, cross-axis, mounting (J, S, 3).

        Probes have those of the tool.
        """
        own = np.array([draw.sensor[self._axes] for draw in mismatches])
        if self.on_links:
            on = self._owners >= 0
            links = np.array([draw.link_sensors for draw in mismatches])
            own[:, on] = links[:, self._owners[on], self._axes[on]]
        return own


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """True motion of J arms as it reaches the converters of their sensors."""

    smooth: Array
    """Accelerations along the axes that are read, behind their low-pass (J, S, N) [m/s²]."""
    position: Array
    """Joint positions, one reading more at either end (J, n, N + 2) [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Standard normal variates of J records, one for each reading."""

    accelerometers: Array
    """Of the axes that are read (J, S, N)."""
    encoders: Array
    """Of the encoders (J, n, N + 2)."""


def draw_noise(jobs: Sequence[Job], axes: AxesRead, *, joints: int, count: int) -> Noise:
    """Draw the noise of records of ``count`` readings, each from its job's own generator."""
    read = np.empty((len(jobs), len(axes.sensor), count))
    turned = np.empty((len(jobs), joints, count + 2))
    for k, job in enumerate(jobs):
        # Tool, encoders, then all further accelerometers.
        job.rng.standard_normal(out=read[k, : axes.tool])
        job.rng.standard_normal(out=turned[k])
        if axes.tool < len(axes.sensor):
            job.rng.standard_normal(out=read[k, axes.tool :])
    return Noise(accelerometers=read, encoders=turned)


def sampled(
    recorded: Array,
    axes: AxesRead,
    mixing: Array,
    *,
    sensors: SensorSuite,
    joints: int,
    factor: int,
    before: int,
    count: int,
) -> Motion:
    """Filter and sample the channels that MuJoCo recorded."""
    first = 3 * axes.sensor + np.where(axes.sensor > 0, joints, 0)
    channels = recorded.transpose(0, 2, 1)
    mixed = sum(mixing[:, :, k, None] * channels[:, first + k] for k in range(3))
    steps = before + factor * np.arange(-1, count + 1)
    return Motion(
        smooth=low_passed(
            np.asarray(mixed),
            sensor=sensors.accelerometer,
            factor=factor,
            first=before,
            count=count,
            rate=sensors.rate,
        ),
        position=channels[:, 3 : 3 + joints][..., steps],
    )


def read_records(
    motion: Motion,
    noise: Noise,
    axes: AxesRead,
    jobs: Sequence[Job],
    control: Controls,
    *,
    arm: Arm,
    sensors: SensorSuite,
    factor: int,
    joint_zero: Array,
    failures: dict[int, str],
) -> list[Measurement]:
    """Read the records of several jobs with an arm's sensors."""
    count = motion.smooth.shape[-1]
    smooth = read_accelerometer(
        motion.smooth, sensor=sensors.accelerometer, rate=sensors.rate, drawn=noise.accelerometers
    )
    encoder = read_encoder(
        motion.position - joint_zero[..., None],
        sensor=sensors.encoder,
        drawn=noise.encoders,
        sliding=arm.sliding,
    )
    command = control.commands(factor, count)
    shaken = np.zeros((len(jobs), count)) if arm.shaker is not None else None
    if shaken is not None:
        on = control.drives == arm.n
        shaken[control.records[on]] = control.periods[on][:, ::factor][:, :count]
    end = axes.tool + len(axes.links) * len(axes.link_axes)
    found = []
    for k, job in enumerate(jobs):
        failure = failures.get(job.slot)
        if failure is not None:
            smooth[k] = encoder[k] = 0.0
        links = smooth[k, axes.tool : end].reshape(len(axes.links), len(axes.link_axes), count)
        found.append(
            Measurement(
                pose=job.pose,
                excitation=job.excitation,
                rate=sensors.rate,
                command=command[k],
                encoder=encoder[k],
                tool=smooth[k, : axes.tool],
                links=links if axes.on_links else None,
                probes={
                    site: smooth[k, end + 3 * i : end + 3 * i + 3]
                    for i, site in enumerate(axes.probes)
                },
                shaker_force=None if shaken is None else shaken[k],
                failure=failure,
            )
        )
    return found
