"""Runs as they are compared: time stamps, pauses, and exact models."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import GapSettings, solve_gap
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import Trial, align_run, channels_of, measured_runs, pieces_of
from loose_env.recording import Run, read_recording, write_recording
from loose_env.typing import Array

ONE = """<mujoco><worldbody><body><joint name="q" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.01"/></body></worldbody>
<actuator><position name="servo" joint="q" kp="50" kv="5"/></actuator>
<sensor><jointpos name="encoder" joint="q"/><jointvel name="rate" joint="q"/></sensor></mujoco>"""
ROWS = 400


def aligned(time: Array, step: float) -> Trial:
    """A run on the steps of a simulation; its command counts its rows."""
    rows = np.arange(float(len(time)))
    run = Run(name="r.csv", time=time, controls={"servo": rows}, sensors={"encoder": 1e-3 * rows})
    machine = NominalModel(mujoco.MjSpec.from_string(ONE))
    return align_run(run, machine, channels_of([run]), step=step)


@pytest.mark.parametrize(
    ("rate", "decimals", "begin"),
    [(100.0, 9, 0.0), (90.9, 3, 0.0), (30.0, 3, 0.0), (90.9, 9, 1727771234.12)],
)
def test_rounded_stamps_make_no_command_late(rate: float, decimals: int, begin: float) -> None:
    trial = aligned(np.round(begin + np.arange(ROWS) / rate, decimals), step=0.004)
    parts = round(1 / rate / trial.step)
    assert parts == np.ceil(1 / rate / 0.004)
    assert trial.step * parts == pytest.approx(1 / rate, rel=1e-4)
    held = np.arange(trial.steps) // parts
    assert np.array_equal(trial.controls[:, 0], np.minimum(held, ROWS - 1))
    assert np.allclose(np.diff(trial.time), trial.step * parts, rtol=1e-9)


def test_uneven_stamps_and_lost_rows_keep_their_times() -> None:
    rng = np.random.default_rng(1)
    time = 0.01 * np.arange(ROWS) + rng.uniform(-0.003, 0.003, ROWS)
    trial, step = aligned(time, step=0.002), 0.002
    assert trial.step == step and np.allclose(trial.time, time - time[0])
    first = np.searchsorted(trial.controls[:, 0], np.arange(1.0, ROWS - 1.0)) * step
    late = first - (time - time[0])[1:-1]
    assert np.all(np.abs(late) <= 0.5 * step + 1e-12)
    assert abs(np.mean(late)) < 0.1 * step
    time = np.delete(0.01 * np.arange(ROWS), 200)
    trial = aligned(time, step=0.005)
    assert np.allclose(trial.time, time)
    assert list(trial.controls[[401, 402], 0]) == [199, 200]  # held until the next row there is


def test_a_run_is_cut_where_the_recorder_paused_and_not_where_it_was_slow() -> None:
    def run(time: Array) -> Run:
        return Run(name="a.csv", time=time, sensors={"encoder": np.sin(time)})

    time = np.arange(300) / 100
    time[150:] += 1.7e9
    pieces, words = measured_runs([run(time)], mujoco.MjModel.from_xml_string(ONE))
    assert [piece.samples for piece in pieces] == [150, 150]
    assert all(np.ptp(piece.time) < 2 for piece in pieces)
    assert "compared as 2 pieces" in words[0] and "1.7e+09 s" in words[0]
    uneven = np.cumsum(np.random.default_rng(0).uniform(0.01, 1.2, 100))
    for slow in (np.arange(50) / 5.0, uneven, np.delete(np.arange(500) / 100, slice(100, 180))):
        assert pieces_of(run(slow))[0].samples == len(slow)
    time = np.arange(60) / 100
    time[5:] += 100
    (piece,) = pieces_of(run(time))
    assert piece.samples == 55
    with pytest.raises(InvalidData, match="no piece of 10 samples"):
        pieces_of(run(np.arange(20) * 0.01 + 1000 * (np.arange(20) // 8)))


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


def motion(xml: str, start: Array, commands: Array | None) -> Array:
    """Positions every other step (COUNT, 2)."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, found = mujoco.MjData(model), np.empty((COUNT, 2))
    data.qpos[:] = start
    for k in range(COUNT):
        found[k] = data.qpos
        if commands is not None:
            data.ctrl[:] = commands[k]
        mujoco.mj_step(model, data, EVERY)
    return found


def exact(number: int, begins: str) -> tuple[Array, Array | None]:
    """Positions and commands of one run of an arm that its model describes exactly."""
    tilted = np.array([1.2 + 0.2 * number, 0.1 * number])
    if begins == "let go":
        return motion(ARM.format(""), tilted, None), None
    if begins == "set off":
        model = mujoco.MjModel.from_xml_string(MOTORS)
        hanging = mujoco.MjData(model)
        mujoco.mj_step(model, hanging, 5000)
        commands = np.tile([0.3 + 0.1 * number, 0.0], (COUNT, 1))
        return motion(MOTORS, hanging.qpos, commands), commands
    swing = 2 * np.pi * (0.5 + 0.2 * number) * np.arange(COUNT) * EVERY * 0.002
    commands = np.stack([0.5 * np.sin(swing), 0.05 * np.cos(1.2 * swing)], axis=1)
    return motion(MOTORS, tilted, commands)[50:], commands[50:]


@pytest.mark.parametrize("begins", ["set off", "in motion", "let go"])
def test_an_exact_model_has_no_gap_however_its_runs_begin(begins: str, tmp_path: Path) -> None:
    rng, runs = np.random.default_rng(3), []
    for number in range(4):
        positions, commands = exact(number, begins)
        noisy = positions + rng.normal(0, 1e-3, positions.shape)
        names = () if commands is None else ("hip_drive", "knee_drive")
        runs.append(
            Run(
                name=f"run-{number}.csv",
                time=np.arange(len(noisy)) * EVERY * 0.002,
                controls={n: commands[:, j] for j, n in enumerate(names)},  # type: ignore[index]
                sensors={"hip_at": noisy[:, 0], "knee_at": noisy[:, 1]},
            )
        )
    model = SERVOS if begins == "let go" else MOTORS
    write_recording(tmp_path / "recording", model_xml=model, runs=runs)
    kinds = ("viscous_friction", "rotor_inertia", "coulomb_friction", "joint_spring")
    found = solve_gap(
        read_recording(tmp_path / "recording"), GapSettings(kinds=kinds, threads=1)
    ).result
    assert found.verdict == "no_gap", (found.effects, found.gap)
    assert 0.5 < found.gap.after < 1.6
