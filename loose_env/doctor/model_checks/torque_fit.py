"""Inverse-dynamics torque of a measured motion fitted to the recorded torque; variance left."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from loose_env.doctor.channels import Factors, Machine, Runs, filled
from loose_env.doctor.entries import positions_in
from loose_env.doctor.model_checks.forces import recorded_forces
from loose_env.doctor.thresholds import STANDARD_SPEED, TORQUE_BAND_HZ, TORQUE_POINTS, TORQUE_RUNS
from loose_env.importing import median_step
from loose_env.recording import Run
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueData:
    """Smoothed motion and torque of all runs: arrays by run, (T, joints)."""

    runs: list[str]
    steps: list[float]
    positions: list[Array]
    torques: list[Array]


def torque_data(
    machine: Machine,
    runs: Runs,
    factors: Factors,
    joints: list[str],
) -> TorqueData | None:
    """Smoothed positions of all joints and torques of some, of the first runs that have them."""
    names, steps, positions, torques = [], [], [], []
    for run, channels in runs:
        forces = recorded_forces(machine, run, channels)
        places = positions_in(run, channels, factors)
        step = max(median_step(run.time), 0.1 / TORQUE_BAND_HZ)
        count = int((run.time[-1] - run.time[0]) / step) + 1
        if not set(joints) <= set(forces) or not set(machine.joints) <= set(places):
            continue
        if not 40 <= count <= 100_000 or step > 0.25 / TORQUE_BAND_HZ:
            continue
        grid = run.time[0] + step * np.arange(count)
        low = butter(2, TORQUE_BAND_HZ, fs=1 / step, output="sos")

        def smooth(values: Array, run: Run = run, grid: Array = grid, low: Array = low) -> Array:
            whole = sosfiltfilt(low, np.interp(grid, run.time, filled(run.time, values)))
            return np.asarray(whole)[: TORQUE_POINTS * max(1, len(grid) // TORQUE_POINTS)]

        names.append(run.name)
        steps.append(step)
        positions.append(np.stack([smooth(places[j]) for j in machine.joints], axis=1))
        torques.append(np.stack([smooth(forces[j][1]) for j in joints], axis=1))
        if len(steps) == TORQUE_RUNS:
            break
    if not steps or np.concatenate(torques).std(axis=0).max() == 0:
        return None
    return TorqueData(runs=names, steps=steps, positions=positions, torques=torques)


def needed_torque(
    machine: Machine,
    data: TorqueData,
    dofs: list[int],
    changed: mujoco.MjModel | None = None,
) -> tuple[Array, Array, Array]:
    """Inverse dynamics torque, velocity and acceleration at the compared points (E, J).

    The dynamics are those of the machine's model, or of a changed copy of it.
    """
    model = copy.copy(machine.model if changed is None else changed)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_frictionloss[:] = 0.0
    engine = mujoco.MjData(model)
    addresses = [int(model.jnt_qposadr[model.joint(j).id]) for j in machine.joints]
    own = [int(model.jnt_dofadr[model.joint(j).id]) for j in machine.joints]
    torque, speed, change = [], [], []
    for step, q in zip(data.steps, data.positions, strict=True):
        v = np.gradient(q, step, axis=0)
        a = np.gradient(v, step, axis=0)
        for k in compared_points(len(q)):
            engine.qpos[addresses], engine.qvel[own], engine.qacc[own] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, engine)
            torque.append(engine.qfrc_inverse[dofs].copy())
            speed.append(engine.qvel[dofs].copy())
            change.append(engine.qacc[dofs].copy())
    return np.array(torque), np.array(speed), np.array(change)


def compared_points(count: int) -> NDArray[np.intp]:
    """Compared points of a run; its ends have no derivative."""
    return np.unique(np.linspace(4, count - 5, min(TORQUE_POINTS, count - 8)).astype(int))


def measured_torque(data: TorqueData) -> Array:
    """Recorded torque at the compared points of all runs (E, J)."""
    return np.concatenate([t[compared_points(len(t))] for t in data.torques])


def measured_positions(data: TorqueData) -> Array:
    """Position at the compared points of all runs (E, joints)."""
    return np.concatenate([q[compared_points(len(q))] for q in data.positions])


def left_as_recorded(machine: Machine, data: TorqueData, dofs: list[int]) -> float:
    """Share of the torque's variance that model, friction and rotor inertia leave [1]."""
    needed, speed, change = needed_torque(machine, data, dofs)
    return share_left(measured_torque(data), needed, speed, change)


def share_left(measured: Array, needed: Array, speed: Array, change: Array) -> float:
    """Share of the variance that is left, mean over the joints; infinite where it overflows."""
    if not np.isfinite(needed).all():
        return np.inf
    parts = [
        with_friction(measured[:, j] - needed[:, j], speed[:, j], change[:, j])[1]
        / max(float(np.var(measured[:, j])), 1e-12 * float(np.var(measured)) + 1e-300)
        for j in range(measured.shape[1])
        if np.std(measured[:, j]) > 1e-3 * np.std(measured)
    ]
    return float(np.mean(parts)) if parts else 0.0


def nuisance(speed: Array, change: Array) -> Array:
    """Torque of friction, damping and rotor inertia of one each, and an offset (E, 4)."""
    direction = np.tanh(speed / max(STANDARD_SPEED * float(np.std(speed)), 1e-9))
    return np.stack([direction, speed, change, np.ones_like(speed)], axis=1)


def with_friction(
    residual: Array, speed: Array, change: Array, more: Sequence[Array] = ()
) -> tuple[Array, float]:
    """Non-negative coefficients of friction, rotor inertia, offset; mean square of the rest."""
    own = nuisance(speed, change)
    columns = np.column_stack([*more, own, -own[:, 3]])
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    found, norm = nnls(columns / size, residual)
    return np.asarray(found / size), float(norm**2 / len(residual))


def mapped(
    data: TorqueData, positions: Array | None = None, torques: Array | None = None
) -> TorqueData:
    """Data with columns mapped by matrices (J, J)."""
    return TorqueData(
        runs=data.runs,
        steps=data.steps,
        positions=data.positions if positions is None else [q @ positions for q in data.positions],
        torques=data.torques if torques is None else [t @ torques for t in data.torques],
    )
