"""Torques of a run: random excitation plus gravity compensation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.arms import LinearArm
from loose_env.excitation import torque_signals
from loose_env.rig.jobs import Job
from loose_env.typing import Array

__all__ = ["controls"]


def controls(
    nominal: LinearArm, jobs: Sequence[Job], *, timestep: float, before: int, after: int
) -> Array:
    """Sample the torques of every step, and the shaker force if present.

    Parameters
    ----------
    nominal : LinearArm
        The nominal arm: its gravity is compensated.
    jobs : sequence of Job
        Measurements of one length; each draws from its own generator.
    timestep : float
        Simulation step [s].
    before, after : int
        Steps of run-in and run-out around the record.

    Returns
    -------
    ndarray (jobs, steps, drives)
        Torques within the drives' limits [N·m, N where a joint slides or for the shaker].
    """
    arm = nominal.arm
    shaker = arm.shaker
    drives = arm.n + (shaker is not None)
    limits = np.array(arm.torque_limits)
    control = np.zeros((len(jobs), 0, drives))
    for k, job in enumerate(jobs):
        torque = torque_signals(
            job.excitation, timestep=timestep, before=before, after=after, rng=job.rng
        )
        if k == 0:
            control = np.zeros((len(jobs), torque.shape[1], drives))
        if shaker is not None and job.excitation.shaker_rms > 0:
            most = shaker.force_limit
            control[k, :, -1] = np.clip(torque[-1], -most, most)
        gravity = nominal.at(job.pose).gravity_torque
        for j in np.flatnonzero(np.array(job.excitation.excited) | (gravity != 0)):
            control[k, :, j] = np.clip(torque[j] + gravity[j], -limits[j], limits[j])
    return control
