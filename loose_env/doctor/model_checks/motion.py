"""Motion, sensor readings and torques that joint positions imply by the rigid model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.doctor.channels import Channel, Factors, Machine
from loose_env.doctor.entries import positions_in
from loose_env.doctor.thresholds import BLOCK_S, MOST_BLOCKS, MOST_SAMPLES, UNEVEN_BLOCK
from loose_env.importing import median_step
from loose_env.recording import Run
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of a run on an even grid, and what the rigid model makes of it."""

    time: Array
    """Times [s], shape (T,)."""
    step: float
    """Step between them [s]."""
    readings: Array
    """Sensor data that the model implies, shape (T, nsensordata)."""
    torques: Array
    """Generalised force that the motion needs, shape (T, nv) [N·m or N]."""
    known: frozenset[str]
    """Joints whose position is measured or noted."""


Blocks = Sequence[tuple[Run, Sequence[Channel], Motion, Array]]
"""Runs with their motion by block means, and the rows at which blocks begin and end."""


def block_means(values: Array, rows: Array) -> Array:
    """Mean of each block of rows, from its first to before its last, shape (N, ...).

    Examples
    --------
    >>> block_means(np.arange(6.0), np.array([[0, 2], [2, 6]])).tolist()
    [0.5, 3.5]
    """
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return np.asarray(((total[rows[:, 1]] - total[rows[:, 0]]).T / (rows[:, 1] - rows[:, 0])).T)


def carried(machine: Machine, sensor: str, known: frozenset[str]) -> bool:
    """Return whether all joints that carry a site sensor are known."""
    model = machine.model
    body = int(model.site_bodyid[int(model.sensor_objid[model.sensor(sensor).id])])
    while body > 0:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        for j in range(first, first + count):
            if model.joint(j).name not in known:
                return False
        body = int(model.body_parentid[body])
    return True


def block_motion(
    machine: Machine, run: Run, channels: Sequence[Channel], factors: Factors
) -> tuple[Motion, Array] | None:
    """Motion by block means; None for a run of fewer than four blocks."""
    rate = 1 / median_step(run.time)
    size = max(2, round(BLOCK_S * rate))
    count = run.samples // size
    if count < 4:
        return None
    edges = size * np.arange(count + 1)
    step = float(np.median(np.diff(run.time[edges[:-1]])))
    positions = {
        joint: q[: count * size].reshape(count, size).mean(axis=1)
        for joint, q in positions_in(run, channels, factors).items()
    }
    time = run.time[: count * size].reshape(count, size).mean(axis=1)
    inner = np.arange(1, count - 1)
    even = np.abs(np.diff(time) / step - 1) < UNEVEN_BLOCK
    inner = inner[even[inner - 1] & even[inner]]  # no derivative across a pause
    if len(inner) < 2:
        return None
    chosen = inner[np.unique(np.linspace(0, len(inner) - 1, MOST_BLOCKS).astype(int))]
    motion = _motion(machine, run, positions, time, step, chosen)
    return motion, np.stack([edges[chosen], edges[chosen + 1]], axis=1)


def sampled_motion(
    machine: Machine, run: Run, channels: Sequence[Channel], factors: Factors
) -> Motion:
    """Motion at the rate of the run, of its first samples, brought to an even grid."""
    step = median_step(run.time)
    last = min(float(run.time[-1]), float(run.time[0]) + step * (MOST_SAMPLES + 1))
    time = run.time[0] + step * np.arange(int((last - run.time[0]) / step + 1e-6) + 1)
    positions = {
        joint: np.interp(time, run.time, q)
        for joint, q in positions_in(run, channels, factors).items()
    }
    return _motion(machine, run, positions, time, step, np.arange(1, len(time) - 1))


def _motion(
    machine: Machine,
    run: Run,
    positions: Mapping[str, Array],
    time: Array,
    step: float,
    chosen: NDArray[np.intp],
) -> Motion:
    model = machine.model
    qpos = np.tile(model.qpos0, (len(time), 1))
    qvel, qacc = np.zeros((2, len(chosen), model.nv))
    known = set(positions)
    for joint, q in (run.pose or {}).items():
        if joint not in known:
            qpos[:, int(model.jnt_qposadr[model.joint(joint).id])] = q
            known.add(joint)
    for joint, values in positions.items():
        j = model.joint(joint).id
        qpos[:, int(model.jnt_qposadr[j])] = values
        dof = int(model.jnt_dofadr[j])
        qvel[:, dof] = (values[chosen + 1] - values[chosen - 1]) / (2 * step)
        qacc[:, dof] = (values[chosen + 1] - 2 * values[chosen] + values[chosen - 1]) / step**2
    data = mujoco.MjData(model)
    flags = model.opt.disableflags
    readings = np.zeros((len(chosen), model.nsensordata))
    torques = np.zeros((len(chosen), model.nv))
    try:
        # Contacts and stops change neither kinematics nor what gravity and inertia need.
        model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for row, at in enumerate(chosen):
            data.qpos[:], data.qvel[:], data.qacc[:] = qpos[at], qvel[row], qacc[row]
            mujoco.mj_inverse(model, data)
            readings[row], torques[row] = data.sensordata, data.qfrc_inverse
    finally:
        model.opt.disableflags = flags
    return Motion(
        time=time[chosen], step=step, readings=readings, torques=torques, known=frozenset(known)
    )
