"""Sensor models: conversion of simulated motion to readings."""

from __future__ import annotations

import numpy as np

from loose_env.arms import Arm, MismatchDraw
from loose_env.rig.jobs import Run
from loose_env.rig.measurement import Measurement
from loose_env.sensors import SensorSuite, read_accelerometer, read_encoder
from loose_env.typing import Array

__all__ = ["read_record"]


def read_record(
    run: Run,
    k: int,
    *,
    arm: Arm,
    sensors: SensorSuite,
    factor: int,
    mismatch: MismatchDraw,
    gravity: Array,
) -> Measurement:
    """Read job ``k`` of a run with an arm's sensors.

    Parameters
    ----------
    run : Run
        The run, simulated.
    k : int
        Index of its job.
    arm : Arm
        The nominal arm.
    sensors : SensorSuite
        Sensors that read the motion.
    factor : int
        Simulation steps per reading.
    mismatch : MismatchDraw
        Gains, cross-axis and mounting of each accelerometer (probes: as the tool's), and the
        encoders' zeros.
    gravity : ndarray (n,)
        Torque commanded against gravity, to be taken off the command [N·m].
    """
    job, count, n = run.jobs[k], run.count, arm.n
    axes, rate = list(arm.axes), sensors.rate
    steps = run.before + factor * np.arange(-1, count + 1)
    command = (run.control[k][steps[1:-1], :n] - gravity).T
    shaker_force = run.control[k][steps[1:-1], n] if arm.shaker is not None else None
    choice = sensors.on_links
    carriers = () if choice is None else choice.on(arm)
    link_axes = [0] if choice is not None and choice.tangential else axes
    failure = run.failures.get(job.slot)
    if failure is not None:
        still = np.zeros((len(axes), count))
        return Measurement(
            pose=job.pose,
            excitation=job.excitation,
            rate=rate,
            command=command,
            encoder=np.zeros((n, count + 2)),
            tool=still,
            links=None if choice is None else np.zeros((len(carriers), len(link_axes), count)),
            probes={site: np.zeros((3, count)) for site in arm.probe_sites},
            shaker_force=shaker_force,
            failure=failure,
        )
    recorded = run.recorded[k]

    def accelerometer(first: int, axes: list[int] = axes, errors: Array = mismatch.sensor) -> Array:
        return read_accelerometer(
            recorded[:, first : first + 3],
            sensor=sensors.accelerometer,
            matrix=errors[axes],
            factor=factor,
            first=run.before,
            count=count,
            rate=rate,
            rng=job.rng,
        )

    # Channels: tool accelerometer, encoders, link accelerometers, probes.
    tool = accelerometer(0)
    angle = recorded[steps, 3 : 3 + n].T - mismatch.joint_zero[:, None]
    encoder = read_encoder(angle, sensor=sensors.encoder, rng=job.rng, sliding=arm.sliding)
    links = None
    if choice is not None:
        links = np.array(
            [
                accelerometer(3 + n + 3 * i, link_axes, mismatch.link_sensors[link - 1])
                for i, link in enumerate(carriers)
            ]
        ).reshape(len(carriers), len(link_axes), count)
    before = 3 + n + 3 * len(carriers)
    probes = {
        site: accelerometer(before + 3 * i, [0, 1, 2]) for i, site in enumerate(arm.probe_sites)
    }
    return Measurement(
        pose=job.pose,
        excitation=job.excitation,
        rate=rate,
        command=command,
        encoder=encoder,
        tool=tool,
        links=links,
        probes=probes,
        shaker_force=shaker_force,
    )
