"""Runs of motion and measured torque, and fits to them."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from loose_env.gap.fitting.gauss_newton import Fit, fit
from loose_env.gap.fitting.model_structure import ModelStructure, nuisance_of
from loose_env.gap.residuals.residual_model import ResidualModel

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of
from loose_env.recording import Run
from loose_env.statistics import noise_floor
from loose_env.typing import Array


def measurable(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The model with a position and a speed sensor at every joint, "<joint>_pos", "<joint>_vel"."""
    for joint in spec.joints:
        for ending, kind in (("pos", "JOINTPOS"), ("vel", "JOINTVEL")):
            spec.add_sensor(
                name=f"{joint.name}_{ending}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
    return spec


def waves(
    machine: NominalModel, time: Array, rng: np.random.Generator, size: float = 0.6
) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of all joints (T, joints), sums of sines up to 2 Hz."""
    count = len(machine.joints)
    found = np.zeros((3, len(time), count))
    for j, joint in enumerate(machine.joints):
        reach = size if machine.turns(joint) else 0.1 * size
        for amplitude in (1.0, 0.3, 0.1):
            rate = 2 * np.pi * rng.uniform(0.2, 0.6) / amplitude**0.5
            angle = rate * time + rng.uniform(0, 2 * np.pi)
            wave = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
            found[:, :, j] += amplitude * reach * np.array(wave)
    return found[0], found[1], found[2]


def needed(model: mujoco.MjModel, position: Array, speed: Array, acceleration: Array) -> Array:
    """MuJoCo's inverse dynamics without constraints, sample by sample (T, joints)."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    found = np.zeros_like(position)
    for k in range(len(position)):
        data.qpos[:], data.qvel[:], data.qacc[:] = position[k], speed[k], acceleration[k]
        mujoco.mj_inverse(model, data)
        found[k] = data.qfrc_inverse
    return found


def torque_run(
    machine: NominalModel,
    truth: mujoco.MjModel,
    rng: np.random.Generator,
    *,
    rate: float = 500.0,
    duration: float = 8.0,
    speeds: float | None = 2e-3,
    name: str = "run",
) -> Run:
    """A run of motion and torque: encoders of steps, speeds and torques with noise."""
    step, time = 1e-4, np.arange(round(rate * duration)) / rate
    position, speed, acceleration = waves(machine, time, rng)
    torque = needed(truth, position, speed, acceleration)
    spread = 0.01 * np.sqrt(np.mean(torque**2, axis=0))
    slides = np.array([0.1 ** (not machine.turns(j)) for j in machine.joints])
    shaken = position + slides * step * rng.normal(0, 0.5, position.shape)
    sensors = {
        f"{joint}_pos": slides[j] * step * np.round(shaken[:, j] / (slides[j] * step))
        for j, joint in enumerate(machine.joints)
    }
    if speeds is not None:
        read = speed + speeds * slides * rng.normal(size=speed.shape)
        sensors |= {f"{joint}_vel": read[:, j] for j, joint in enumerate(machine.joints)}
    torque = torque + spread * rng.normal(size=torque.shape)
    torques = {joint: torque[:, j] for j, joint in enumerate(machine.joints)}
    return Run(name=name, time=time, sensors=sensors, torques=torques)


def compared(machine: NominalModel, runs: Sequence[Run]) -> ResidualModel:
    """Comparison of runs, on one thread."""
    channels = channels_of(list(runs))
    trials = [align_run(run, machine, channels, step=0.0025) for run in runs]
    read = np.array([[noise_floor(c) for c in trial.measured.T] for trial in trials])
    return ResidualModel(machine, trials, channels, np.nanmedian(read, axis=0), threads=1)


def fitted(comparison: ResidualModel, effects: Sequence[Effect]) -> tuple[Fit, list[Array]]:
    """Fit effects beside the nuisance parameters; values of each of the effects."""
    nuisance = nuisance_of(comparison, tolerance=0.005)
    structure = ModelStructure(nuisance=nuisance, effects=tuple(effects))
    begin = [free_of(e.parameters, np.array(e.starts[0])) for e in effects]
    found = fit(comparison, structure, np.concatenate([structure.nominal_start, *begin]))
    return found, list(found.hypothesis.values)
