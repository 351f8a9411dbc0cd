"""Runs that begin at rest, set off by their first command, in motion, or let go: exact models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.data.initial_rest import comes_to_rest
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import prepare
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


def test_an_arm_that_stands_under_its_first_command_is_held_by_it(tmp_path: Path) -> None:
    commands = np.tile([0.4, 0.1], (COUNT, 1))
    commands[100:] += 0.2
    model = mujoco.MjModel.from_xml_string(SERVOS)
    data = mujoco.MjData(model)
    data.ctrl[:] = commands[0]
    for _ in range(3000):
        mujoco.mj_step(model, data)
    positions = motion(SERVOS, data.qpos.copy(), commands)
    noisy = positions + np.random.default_rng(1).normal(0, 1e-4, positions.shape)
    run = Run(
        name="run.csv",
        time=np.arange(COUNT) * EVERY * 0.002,
        controls={"hip_drive": commands[:, 0], "knee_drive": commands[:, 1]},
        sensors={"hip_at": noisy[:, 0], "knee_at": noisy[:, 1]},
    )
    write_recording(
        tmp_path / "recording", model_xml=SERVOS, runs=[run, replace(run, name="other.csv")]
    )
    problem = prepare(read_recording(tmp_path / "recording"), GapSettings(kinds=KINDS, threads=1))
    assert all(trial.resting for trial in problem.search.trials)


@pytest.mark.parametrize("at", [0.41, 0.44, 0.5, 0.56, 0.595])
def test_a_window_that_begins_where_a_joint_was_not_read_begins_between_its_readings(
    at: float,
) -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(SERVOS))
    time = np.arange(600) * 0.002
    angle = np.stack([0.8 + 0.3 * np.sin(3 * time), 0.4 * time], axis=1)
    read = angle + np.random.default_rng(5).normal(0, 1e-4, angle.shape)
    read[(time >= 0.4) & (time <= 0.6), 0] = np.nan
    commands = {"hip_drive": angle[:, 0], "knee_drive": angle[:, 1]}
    sensors = {"hip_at": read[:, 0], "knee_at": read[:, 1]}
    run = Run(name="run.csv", time=time, controls=commands, sensors=sensors)
    trial = align_run(run, machine, channels_of([run]), step=0.002)
    first = round(at / 0.002)
    window = trial.between(first, 600)
    assert not window.resting
    # A straight line over 0.2 s of a swing is off by its curvature.
    assert window.position == pytest.approx(angle[first], abs=0.02)
    assert window.speed == pytest.approx([0.9 * np.cos(3 * at), 0.4], abs=0.3)


def test_a_window_that_begins_before_a_joint_was_read_begins_at_its_first_reading() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(SERVOS))
    time, angle = np.arange(600) * 0.002, np.full((600, 2), 0.7)
    angle[:100, 0] = np.nan
    commands = {"hip_drive": np.full(600, 0.7), "knee_drive": np.full(600, 0.7)}
    sensors = {"hip_at": angle[:, 0], "knee_at": angle[:, 1]}
    run = Run(name="run.csv", time=time, controls=commands, sensors=sensors)
    trial = align_run(run, machine, channels_of([run]), step=0.002)
    window = trial.between(20, 600)
    assert window.position.tolist() == pytest.approx([0.7, 0.7])
    assert window.speed.tolist() == [0.0, 0.0]
    # A joint that was never read stands where the run began.
    nowhere = replace(trial, motion={**trial.motion, "hip": np.full(600, np.nan)})
    assert nowhere.between(20, 600).position[0] == trial.position[0]
