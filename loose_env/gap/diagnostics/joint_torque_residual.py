"""Motion, joint loads and residual joint torques of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.actuator_states import activations
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.smoothing import Motion, filled, smooth_motion
from loose_env.gap.diagnostics.regressors import direction_of
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

__all__ = ["JointMotion", "joint_motion"]


_EDGE = 1.0
"""Periods of the filter's end that are left out at the ends of a run."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """Motion of all joints in one run, on a uniform time grid."""

    joints: tuple[str, ...]
    """Names of the joints."""
    units: tuple[str, ...]
    """Unit of each joint's driving force, "N·m" or "N"."""
    time: Array
    """Time [s] (T,)."""
    position: Array
    """Position [rad, m] (T, J); NaN where the joint was not measured."""
    speed: Array
    """Velocity [rad/s, m/s] (T, J)."""
    acceleration: Array
    """Acceleration [rad/s², m/s²] (T, J)."""
    load: Array
    """Inverse dynamics torque [N·m] or force [N] of the nominal model (T, J); NaN where not
    every joint was measured."""
    residual_torque: Array
    """Residual torque (T, J): applied torque less that of the nominal model. NaN where it is not
    known."""
    residual_noise: Array
    """Standard deviation of ``missing`` due to the noise of the readings (J,)."""

    def regressor(self, name: str, joint: int) -> Array:
        """Values (T,) of one regressor of `diagnostics.regressors` at a joint."""
        if name == "direction":
            return direction_of(self.speed[:, joint])
        table = {"position": self.position, "velocity": self.speed, "load": self.load}
        return np.asarray(table.get(name, self.acceleration)[:, joint])

    def at(self, name: str, joint: int, time: Array) -> Array:
        """Interpolate to other times (N,); directions are not interpolated."""
        values = self.regressor(name, joint)
        if name == "direction":
            near = np.clip(np.searchsorted(self.time, time), 0, len(self.time) - 1)
            return np.asarray(values[near])
        return np.interp(time, self.time, values)


def joint_motion(
    machine: NominalModel, trial: Trial, channels: Sequence[Channel], floors: Array
) -> JointMotion:
    """Compare the measured motion of a run with the nominal model.

    In a forward run the applied torque is that of the nominal actuators at this motion; in an
    inverse run it is the measured torque; in a free run there is none. All of them pass the filter
    that smooths the motion. Where an actuator's activation is not known
    (`loose_env.gap.data.actuator_states`), neither is the applied torque.

    Parameters
    ----------
    machine : NominalModel
        The nominal model.
    trial : Trial
        The run.
    channels : sequence of Channel
        The measured channels.
    floors : ndarray (C,)
        Noise standard deviation of each channel.
    """
    joints = machine.joints
    units = tuple("N·m" if machine.turns(joint) else "N" for joint in joints)
    measured = [np.isfinite(trial.motion.get(joint, np.nan)).any() for joint in joints]
    try:
        smooth = smooth_motion(trial, machine, channels)
    except InvalidData:  # too short
        return _unknown(joints, units, trial)
    known = np.array(measured, dtype=bool)
    shape = smooth.position.shape
    load, missing = np.full(shape, np.nan), np.full(shape, np.nan)
    floor = np.full(len(joints), np.nan)
    if known.all() and machine.model.nv == len(joints):
        needed, applied = _torques(machine, trial, smooth)
        load = smooth.band.smooth(needed)
        floor = _needed_noise(machine, trial, smooth)
        if trial.form != "inverse":
            missing = smooth.band.smooth(applied) - load
        passed = np.sqrt(2 * smooth.band.end / smooth.band.rate)
        for c, channel in enumerate(channels):
            prefix, _, name = channel.column.partition(".")
            values = trial.measured[:, c]
            if prefix == "torque" and trial.form == "inverse" and np.isfinite(values).any():
                j = machine.joint_number(name)
                torque = smooth.band.smooth(filled(trial.time, values, smooth.time))
                missing[:, j] = torque - load[:, j]
                floor[j] = np.hypot(floor[j], floors[c] * passed)
        edge = min(int(_EDGE * smooth.band.rate / smooth.band.end), (len(missing) - 1) // 4)
        missing[:edge], missing[len(missing) - edge :] = np.nan, np.nan
    return JointMotion(
        joints=joints,
        units=units,
        time=smooth.time,
        position=np.where(known, smooth.position, np.nan),
        speed=np.where(known, smooth.speed, np.nan),
        acceleration=np.where(known, smooth.acceleration, np.nan),
        load=load,
        residual_torque=missing,
        residual_noise=floor,
    )


def _unknown(joints: tuple[str, ...], units: tuple[str, ...], trial: Trial) -> JointMotion:
    """Motion with known times only."""
    empty = np.full((len(trial.time), len(joints)), np.nan)
    return JointMotion(
        joints=joints,
        units=units,
        time=trial.time,
        position=empty,
        speed=empty,
        acceleration=empty,
        load=empty,
        residual_torque=empty,
        residual_noise=np.full(len(joints), np.nan),
    )


def _torques(machine: NominalModel, trial: Trial, motion: Motion) -> tuple[Array, Array]:
    """Inverse dynamics torque of the nominal model, and its actuator torque (T, J).

    The latter is NaN in a forward run where an activation is not known.
    """
    model = machine.model.__copy__()
    if machine.integrator is not None:
        model.opt.integrator = machine.integrator
    # Contacts and stops of an approximate motion would be noise.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    friction = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0.0  # a constraint, whose force at rest is not known
    data = mujoco.MjData(model)
    needed, applied = np.zeros_like(motion.position), np.zeros_like(motion.position)
    commanded = _held(trial.controls, trial.step, motion.time)
    forward, acting = trial.form == "forward", None
    if forward:
        own = activations(model, trial.controls, trial.step)
        acting = None if own is None else _held(own, trial.step, motion.time)
        if acting is None:
            applied[:] = np.nan
    for k in range(len(motion.time)):
        data.qpos[:], data.qvel[:] = motion.position[k], motion.speed[k]
        data.qacc[:] = motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
        if acting is not None:
            data.act[:] = acting[k]
            data.ctrl[: trial.controls.shape[1]] = commanded[k]
            mujoco.mj_fwdActuation(model, data)
            applied[k] = data.qfrc_actuator
    return needed + friction * np.sign(motion.speed), applied


def _held(values: Array, step: float, time: Array) -> Array:
    """Average zero-order-hold values (steps, N) about each time (T, N)."""
    half = 0.5 * float(np.median(np.diff(time)))
    edges = np.arange(len(values) + 1) * step
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    first = np.clip(time - half, 0.0, edges[-1] - step)
    last = np.clip(time + half, first + 1e-9, edges[-1])
    found = np.empty((len(time), values.shape[1]))
    for k in range(found.shape[1]):
        passed = np.interp(last, edges, sums[:, k]) - np.interp(first, edges, sums[:, k])
        found[:, k] = passed * step / (last - first)
    return found


def _needed_noise(machine: NominalModel, trial: Trial, motion: Motion) -> Array:
    """Noise of the inverse dynamics torque less the applied torque (J,)."""
    model = machine.model
    data = mujoco.MjData(model)
    data.qpos[:] = motion.position[len(motion.time) // 2]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    spring, damper = np.zeros(model.nv), model.dof_damping.copy()
    if trial.form == "forward":
        for k, name in enumerate(machine.actuators):
            joint = machine.actuated_joint.get(name)
            if joint is not None:
                j, gear = machine.joint_number(joint), float(model.actuator_gear[k, 0])
                spring[j] += abs(gear**2 * model.actuator_biasprm[k, 1])
                damper[j] += abs(gear**2 * model.actuator_biasprm[k, 2])
    position, speed, acceleration = motion.noise**2
    variance = mass**2 @ acceleration + damper**2 * speed + spring**2 * position
    return np.asarray(np.sqrt(variance))
