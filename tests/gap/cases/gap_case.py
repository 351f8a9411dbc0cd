"""Recordings of a small arm, and of one that lacks what its model has not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from loose_env.gap import GapSettings, GapSolution, solve_gap
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array

FRICTION = 0.8
"""Dry friction at the elbow that the recorded arm has beyond its model [N·m]."""
STEP, COUNT = 0.005, 800
FEW = GapSettings(
    threads=1, simulate=False, kinds=("coulomb_friction", "viscous_friction", "actuator_gain")
)
"""Settings of a quick comparison."""
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><joint axis="0 1 0" armature="0.1" damping="0.3"/></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder"/>
      <inertial pos="0.15 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow"/>
        <inertial pos="0.12 0 0" mass="1" diaginertia="0.003 0.008 0.008"/>
        <site name="tool" pos="0.25 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="motor1" joint="shoulder" kp="150" kv="8"/>
    <position name="motor2" joint="elbow" kp="60" kv="3"/>
  </actuator>
  <sensor>
    <jointpos name="encoder1" joint="shoulder"/>
    <jointpos name="encoder2" joint="elbow"/>
  </sensor>
</mujoco>
"""


def model_with(suffix: str) -> str:
    """The model whose joints, links, servos and sensors have names with a suffix."""
    names = r'"(shoulder|elbow|upper|lower|(?:motor|encoder)\d)"'
    return re.sub(names, lambda m: f'"{m[1]}{suffix}"', MODEL)


def lacks_friction(suffix: str = "") -> Callable[[mujoco.MjSpec], None]:
    """Edit that adds dry friction at the elbow."""

    def edit(spec: mujoco.MjSpec) -> None:
        spec.joint(f"elbow{suffix}").frictionloss = FRICTION

    return edit


def record(
    folder: Path,
    *,
    runs: int = 3,
    suffix: str = "",
    edit: Callable[[mujoco.MjSpec], None] | None = None,
    steps_s: float = 0.0,
) -> Recording:
    """Write a recording of the arm under servos, by default with friction that its model lacks.

    Its commands are two sines a joint, or steps between which it stands still.
    """
    spec = mujoco.MjSpec.from_string(model_with(suffix))
    (lacks_friction(suffix) if edit is None else edit)(spec)
    model, rng = spec.compile(), np.random.default_rng(8)
    time, found = np.arange(COUNT) * STEP, []
    inside = round(STEP / model.opt.timestep)
    for k in range(runs):
        rates = np.array([[2.1 + 0.6 * k, 3.4 - 0.5 * k], [4.3 - 0.7 * k, 6.1 + 0.8 * k]])
        controls = 0.6 * np.sin(time[:, None] * rates[0]) + 0.25 * np.sin(time[:, None] * rates[1])
        controls *= np.minimum(time, 1.0)[:, None]
        if steps_s:
            goals = rng.uniform(-0.6, 0.6, (int(COUNT * STEP / steps_s) + 1, 2))
            controls = goals[(time // steps_s).astype(int)]
        data, shown = mujoco.MjData(model), np.zeros((COUNT, 2))
        mujoco.mj_step(model, data, 3000)
        for row, command in zip(shown, controls, strict=True):
            data.ctrl[:] = command
            mujoco.mj_forward(model, data)
            row[:] = data.qpos
            mujoco.mj_step(model, data, inside)
        shown += rng.normal(0, 2e-5, shown.shape)
        found.append(
            Run(
                name=f"run-{k + 1:02d}.csv",
                time=time,
                controls={f"motor{j + 1}{suffix}": controls[:, j] for j in range(2)},
                sensors={f"encoder{j + 1}{suffix}": shown[:, j] for j in range(2)},
            )
        )
    return write_recording(folder, model_xml=model_with(suffix), runs=found, file_format="csv")


def torque_log(
    folder: Path,
    edit: Callable[[mujoco.MjSpec], None] = lambda spec: None,
    *,
    runs: int = 2,
    nominal: str = MODEL,
) -> Recording:
    """Write a recording of motion and measured torque of an arm with an edit."""
    spec = mujoco.MjSpec.from_string(nominal)
    edit(spec)
    model, rng = spec.compile(), np.random.default_rng(4)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data, time, found = mujoco.MjData(model), np.arange(COUNT) * STEP, []
    for k in range(runs):
        position, torque = np.zeros((2, COUNT, 2))
        for row in range(COUNT):
            q, v, a = _wave(float(time[row]), k)
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            position[row], torque[row] = q, data.qfrc_inverse
        position += rng.normal(0, 2e-5, position.shape)
        torque += rng.normal(0, 0.02, torque.shape)
        found.append(
            Run(
                name=f"run-{k + 1:02d}.csv",
                time=time,
                sensors={f"encoder{j + 1}": position[:, j] for j in range(2)},
                torques={name: torque[:, j] for j, name in enumerate(("shoulder", "elbow"))},
            )
        )
    return write_recording(folder, model_xml=nominal, runs=found, file_format="csv")


def _wave(time: float, run: int) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of both joints."""
    rate = np.array([[2.1 + 0.6 * run, 3.4 - 0.5 * run], [4.3 - 0.7 * run, 6.1 + 0.8 * run]])
    size = np.array([[0.6, 0.6], [0.25, 0.25]])
    angle = rate * time
    return (
        (size * np.sin(angle)).sum(axis=0),
        (size * rate * np.cos(angle)).sum(axis=0),
        -(size * rate**2 * np.sin(angle)).sum(axis=0),
    )


def solution_for(recording: Recording, settings: GapSettings = FEW) -> GapSolution:
    """The finished comparison of a recording."""
    return solve_gap(recording, settings)
