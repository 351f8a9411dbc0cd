"""Inverse dynamics of models with unmeasured degrees of freedom: prescribed joint motion.

A compliant drive or one with backlash has more coordinates than the measured ones. The measured
joints follow their motion, the others move freely: each measured joint gets a rotor far heavier
than all it carries, and a force that moves this rotor as measured. The torque of the model is the
force beyond that which moves the rotor.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.interpolate import make_interp_spline

from loose_env.gap.data.smoothing import SmoothedMotion
from loose_env.gap.model.hypothesis import Hypothesis, compiled
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulation.applied_torque_terms import torque_terms
from loose_env.typing import Array

_HEAVY = 1e5
"""Inertia of the added rotors, over what the joint moves."""
_FOLLOW = 20.0
"""Rate at which a joint returns to the measured motion [1/s]."""
_SETTLE = 1.0
"""How long the model moves beforehand, so that what is not measured takes part [s]."""
_SHARE_OF_PERIOD = 1 / 12
"""Longest step over the shortest period of the compared torques."""
_SLOW = 2 * np.pi * 2.0
"""Rate at which at least a joint that is not measured comes to rest by then [1/s]."""


class PrescribedMotionSimulator:
    """Drives the measured joints of a model along prescribed motions."""

    def __init__(self, machine: NominalModel, *, threads: int = 0, step: float = 0.0) -> None:
        self.machine, self.threads = machine, threads
        self.step = step or machine.time_step

    def torque(self, hypothesis: Hypothesis, motion: SmoothedMotion) -> Array:
        """Drive torques of the measured joints, on the motion's grid (G, joints) [N·m, N]."""
        joints = self.machine.joints
        interval = float(motion.time[1])
        # steps of a grid interval, and grid intervals of a step; one of the two is 1
        inside = max(1, int(np.ceil(interval / self.step - 1e-6)))
        joined = max(1, int(min(self.step, _SHARE_OF_PERIOD / motion.band.end) / interval + 1e-6))
        step = interval * joined / inside
        model, rotors = self._model(hypothesis, step)
        dofs = [int(model.joint(name).dofadr[0]) for name in joints]
        places = [int(model.joint(name).qposadr[0]) for name in joints]
        # Before the run, its beginning is extrapolated by point reflection at the first sample.
        before = min(len(motion.time) - 1, round(_SETTLE / interval)) // joined * joined
        turned = 2 * motion.position[0] - motion.position[before:0:-1]
        positions = np.concatenate([turned, motion.position])
        speeds = np.concatenate([motion.speed[before:0:-1], motion.speed])
        # Leapfrog: MuJoCo's semi-implicit step has speeds half a step before positions.
        grid = interval * np.arange(len(positions), dtype=np.float64)
        count = -(-(len(grid) - 1) * inside // joined) + 1
        times = step * np.arange(count, dtype=np.float64)
        middles = step * (np.arange(len(times) + 1, dtype=np.float64) - 0.5)
        position = _between(grid, positions, times)
        speed = _between(grid, speeds, middles)
        rate, speed = np.diff(speed, axis=0) / step, speed[:-1]
        control = np.zeros((1, len(times), model.nu))
        control[0, :, -len(joints) :] = rotors * (
            rate + 2 * _FOLLOW * speed + _FOLLOW**2 * position
        )
        measured = before * inside // joined
        batch = Batch(_sluggish(model, joints), 1, self.threads)
        batch.qpos[:, places] = position[0]
        batch.qvel[:, dofs] = speed[0]
        spec = int(mujoco.mjtState.mjSTATE_CTRL)
        batch.rollout(measured, control[:, :measured], control_spec=spec, record=("qpos",))
        state = batch.qpos.copy(), batch.qvel.copy()
        batch = Batch(model, 1, self.threads)
        batch.qpos[:], batch.qvel[:] = state
        recorded = ("actuator_force", "qacc")
        out = batch.rollout(
            len(times) - measured, control[:, measured:], control_spec=spec, record=recorded
        )
        given = out["actuator_force"][0, :, -len(joints) :]
        led = (given - rotors * out["qacc"][0][:, dofs])[::inside]
        if joined > 1:
            led = _between(times[measured:], led, grid[before:])
        return np.asarray(led - torque_terms(hypothesis, motion.position, motion.speed))

    def _model(self, hypothesis: Hypothesis, step: float) -> tuple[mujoco.MjModel, Array]:
        """Model with heavy rotors and their drives, its own actuators without force."""
        machine = self.machine
        spec = machine.fresh()
        spec.option.timestep = step
        hypothesis.edit(spec)
        for name in machine.actuators:
            actuator = spec.actuator(name)
            actuator.gainprm, actuator.biasprm = np.zeros(10), np.zeros(10)
        rotors = _HEAVY * machine.inertias
        for name, rotor in zip(machine.joints, rotors, strict=True):
            spec.joint(name).armature += rotor
            drive = spec.add_actuator(
                name=f"{name}_led", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            drive.forcelimited = drive.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
            drive.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
            drive.dyntype, drive.dynprm = mujoco.mjtDyn.mjDYN_NONE, np.zeros(10)
            drive.gear = [1, 0, 0, 0, 0, 0]
            drive.damping, drive.armature, drive.delay, drive.nsample = (
                np.zeros_like(drive.damping), 0.0, 0.0, 0,
            )  # fmt: skip
            drive.gaintype, drive.biastype = (
                mujoco.mjtGain.mjGAIN_FIXED,
                mujoco.mjtBias.mjBIAS_AFFINE,
            )
            drive.gainprm = [1.0, *np.zeros(9)]
            drive.biasprm = [0.0, -rotor * _FOLLOW**2, -2 * rotor * _FOLLOW, *np.zeros(7)]
            spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model = compiled(spec)
        return model, rotors


def _sluggish(model: mujoco.MjModel, joints: Sequence[str]) -> mujoco.MjModel:
    """Copy with unmeasured joints damped until they do not oscillate.

    They then settle under gravity and the first motion before the run begins; lightly damped
    springs would oscillate for seconds.
    """
    found = copy.deepcopy(model)
    led = {int(model.joint(name).dofadr[0]) for name in joints}
    for joint, dof in enumerate(model.jnt_dofadr):
        if dof not in led:
            inertia = 1.0 / max(float(model.dof_invweight0[dof]), 1e-12)
            stiffness = max(float(model.jnt_stiffness[joint]), inertia * _SLOW**2)
            found.dof_damping[dof] += 2 * np.sqrt(stiffness * inertia)
    return found


def _between(grid: Array, values: Array, times: Array) -> Array:
    """Interpolate values (G, joints) to other times, by cubic spline."""
    spline = make_interp_spline(grid, values, k=3)
    return np.asarray(spline(np.clip(times, grid[0], grid[-1])))
