"""Runs that begin at rest, set off by their first command, in motion, or let go: exact models."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.initial_rest import comes_to_rest
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import find_gap
from loose_env.recording import Run, read_recording, write_recording
from loose_env.typing import Array

ARM = """<mujoco>
  <option timestep=".002" integrator="RK4"/>
  <worldbody>
    <body name="upper">
      <joint name="hip" axis="0 1 0" damping=".5" armature=".05"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="1"/>
      <body name="lower" pos=".4 0 0">
        <joint name="knee" axis="0 1 0" damping=".1" armature=".02"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass=".2"/>
        <site name="tool" pos=".2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>{}</actuator>
  <sensor><jointpos name="hip_at" joint="hip"/><jointpos name="knee_at" joint="knee"/></sensor>
</mujoco>"""
SERVOS = ARM.format(
    '<position name="hip_drive" joint="hip" kp="200" kv="10"/>'
    '<position name="knee_drive" joint="knee" kp="500" kv="10"/>'
)
MOTORS = ARM.format('<motor name="hip_drive" joint="hip"/><motor name="knee_drive" joint="knee"/>')
COUNT, EVERY = 500, 2
KINDS = ("viscous_friction", "rotor_inertia", "coulomb_friction", "joint_spring")


def motion(xml: str, start: Array, commands: Array | None) -> Array:
    """Positions every other step (COUNT, 2)."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    found = np.empty((COUNT, 2))
    for k in range(COUNT):
        found[k] = data.qpos
        if commands is not None:
            data.ctrl[:] = commands[k]
        for _ in range(EVERY):
            mujoco.mj_step(model, data)
    return found


def hanging() -> Array:
    """Where the arm without drives hangs."""
    model = mujoco.MjModel.from_xml_string(MOTORS)
    data = mujoco.MjData(model)
    for _ in range(5000):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


def recorded(number: int, begins: str) -> tuple[Array, Array | None]:
    """Positions and commands of one run of an arm that its model describes exactly."""
    time = np.arange(COUNT) * EVERY * 0.002
    tilted = np.array([1.2 + 0.2 * number, 0.1 * number])
    if begins == "let go":
        return motion(ARM.format(""), tilted, None), None
    if begins == "set off":
        commands = np.tile([0.3 + 0.1 * number, 0.0], (COUNT, 1))
        return motion(MOTORS, hanging(), commands), commands
    swing = 2 * np.pi * (0.5 + 0.2 * number) * time
    commands = np.stack([0.5 * np.sin(swing), 0.05 * np.cos(1.2 * swing)], axis=1)
    return motion(MOTORS, tilted, commands)[50:], commands[50:]


@pytest.mark.parametrize("begins", ["set off", "in motion", "let go"])
def test_an_exact_model_has_no_gap_however_its_runs_begin(begins: str, tmp_path: Path) -> None:
    rng, runs = np.random.default_rng(3), []
    for number in range(4):
        positions, commands = recorded(number, begins)
        noisy = positions + rng.normal(0, 1e-3, positions.shape)
        runs.append(
            Run(
                name=f"run-{number}.csv",
                time=np.arange(len(noisy)) * EVERY * 0.002,
                controls={}
                if commands is None
                else {"hip_drive": commands[:, 0], "knee_drive": commands[:, 1]},
                sensors={"hip_at": noisy[:, 0], "knee_at": noisy[:, 1]},
            )
        )
    model = SERVOS if begins == "let go" else MOTORS
    write_recording(tmp_path / "recording", model_xml=model, runs=runs)
    found = find_gap(read_recording(tmp_path / "recording"), GapSettings(kinds=KINDS, threads=1))
    assert found.verdict == "no_gap", (found.effects, found.base.held_out_rms)
    assert 0.9 < found.base.held_out_rms < 1.1


def test_a_servo_comes_to_rest_and_a_torque_that_nothing_opposes_does_not() -> None:
    servos = NominalModel(mujoco.MjSpec.from_string(SERVOS))
    motors = NominalModel(mujoco.MjSpec.from_string(MOTORS))
    assert comes_to_rest(servos, np.zeros(2), np.array([0.4, 0.1]))
    assert comes_to_rest(motors, hanging(), np.zeros(2))
    level = ARM.format('<motor name="m" joint="hip"/>').replace(
        "<option ", '<option gravity="0 0 0" '
    )
    assert not comes_to_rest(
        NominalModel(mujoco.MjSpec.from_string(level)), np.zeros(2), np.ones(1)
    )
