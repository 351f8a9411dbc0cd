"""Measurement jobs of a simulated rig, and batches of jobs in the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.typing import Array

__all__ = ["Job", "Run", "check_jobs", "whole_factor"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One measurement to take."""

    slot: int
    """Which arm of the rig."""
    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What to play."""
    rng: np.random.Generator
    """Source of the excitation, the sensor noise and the seat's place in its gap."""


@dataclass(kw_only=True, eq=False)
class Run:
    """Batch of jobs with one duration and one model layout."""

    jobs: Sequence[Job]
    delivered: Array
    """Torques that the drives deliver, and the shaker's force (jobs, steps, drives)."""
    recorded: Array
    """Sensor channels of every step (jobs, steps, channels)."""
    before: int
    """Steps of run-in."""
    count: int
    """Samples of the record."""
    failures: dict[int, str] = field(default_factory=dict)


def check_jobs(arm: Arm, jobs: Sequence[Job]) -> None:
    """Reject jobs that do not match an arm.

    Raises
    ------
    InvalidSetting
        If a slot is named twice, or a pose or excitation does not fit the arm.
    """
    slots = [job.slot for job in jobs]
    if len(set(slots)) != len(slots):
        raise InvalidSetting(f"each slot can be measured once at a time, got slots {slots}")
    n = arm.n
    for job in jobs:
        if job.pose.shape != (n,) or len(job.excitation.torque_rms) != n:
            raise InvalidSetting(
                f"arm {arm.name!r} needs {n} joint positions and {n} torques, got "
                f"{job.pose.shape} and {len(job.excitation.torque_rms)}"
            )
        if job.excitation.shaker_rms > 0 and arm.shaker is None:
            raise InvalidSetting(
                f"arm {arm.name!r} has no shaker; set shaker_rms to 0 or take an arm "
                "that stands at one"
            )


def whole_factor(rate: float, timestep: float) -> int:
    """Simulation steps per reading.

    Parameters
    ----------
    rate : float
        Sampling rate [Hz].
    timestep : float
        Simulation step [s].

    Raises
    ------
    InvalidSetting
        If the rate is no whole fraction of the simulation's.
    """
    factor = round(1 / (rate * timestep))
    if factor < 1 or abs(factor * rate * timestep - 1) > 1e-6:
        raise InvalidSetting(
            f"the sampling rate {rate:g} Hz must be a whole fraction of the "
            f"simulation's {1 / timestep:g} Hz"
        )
    return factor
