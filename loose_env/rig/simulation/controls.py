"""Torques of a run: random excitation plus gravity compensation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.excitation import torque_periods
from loose_env.rig.jobs import Job
from loose_env.typing import Array

__all__ = ["Controls", "controls"]


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
    """Sample the torques of measurements of one length; each draws from its own generator.

    Parameters
    ----------
    nominal : LinearArm
        The nominal arm: its gravity is compensated.
    jobs : sequence of Job
        The measurements.
    timestep : float
        Simulation step [s].
    """
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
