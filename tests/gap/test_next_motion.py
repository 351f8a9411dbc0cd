"""The next motion: it keeps the limits, and separates what the runs left open."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap import NextMotionSettings, next_motion_lines, read_next_motion
from loose_env.gap.data.aligned_run import Channel, align_run
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.next_motion import (
    NEXT_MOTION,
    Hypotheses,
    NextMotion,
    choose_motion,
    open_hypotheses,
    write_next_motion,
)
from loose_env.gap.experiment_design.next_motion.limits import limits_of
from loose_env.gap.experiment_design.next_motion.motion_trials import MotionRuns, drive_of
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.recording import Run, read_recording
from loose_env.typing import Array
from tests.gap.cases.gap_case import stated

MODEL = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.004" integrator="implicitfast"/>
  <custom><numeric name="max_speed_rad_s" data="1.2"/></custom>
  <default><joint axis="0 1 0" damping="0.5" armature="0.1"/><geom mass="0" size="0.04"/></default>
  <worldbody>
    <geom name="wall" type="box" pos="0.83 0 0" size="0.05 0.5 0.5"/>
    <body name="upper">
      <joint name="shoulder" range="-0.8 0.8"/>
      <inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.03 0.03"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="elbow" range="-0.6 2" armature="0.05"/>
        <inertial pos="0.15 0 0" mass="1" diaginertia="0.004 0.01 0.01"/>
        <geom name="fist" type="sphere" pos="0.36 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="one" joint="shoulder" kp="600" kv="30" forcerange="-40 40"/>
    <position name="two" joint="elbow" kp="300" kv="12" forcerange="-15 15"/>
  </actuator>
  <sensor><jointpos name="q1" joint="shoulder"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""
"""Two joints before a wall that the stretched arm would touch."""
RATE, STEP = 125.0, 0.004
HOME = np.array([0.2, 1.0])
CHANNELS = (Channel("sensor.q1"), Channel("sensor.q2"))
MACHINE = NominalModel(mujoco.MjSpec.from_string(MODEL), step=STEP)
EFFECT = CATALOGUE["viscous_friction"](MACHINE, "elbow")
RIVALS = [CATALOGUE["coulomb_friction"](MACHINE, "elbow")]


def recorded(commands: Array) -> ResidualModel:
    """A run of the arm with a damper at the elbow, and noise."""
    run = Run(
        name="a.csv", time=np.arange(len(commands)) / RATE,
        controls={"one": commands[:, 0], "two": commands[:, 1]},
        sensors={"q1": commands[:, 0], "q2": commands[:, 1]},
    )  # fmt: skip
    trial = align_run(run, MACHINE, CHANNELS, step=STEP)
    floors = np.full(2, 5e-4)
    plain = ResidualModel(MACHINE, [trial], CHANNELS, floors, threads=1)
    shown = plain.predict([Hypothesis(effects=(EFFECT,), values=(np.array([1.0]),))])[0][0]
    shown = shown + np.random.default_rng(2).normal(0, floors, shown.shape)
    return ResidualModel(MACHINE, [replace(trial, measured=shown)], CHANNELS, floors, threads=1)


@pytest.fixture(scope="module")
def comparison() -> ResidualModel:
    """Three seconds in which the elbow turns once: damper and dry friction look much alike."""
    time = np.arange(round(3 * RATE)) / RATE
    way = np.clip((time - 0.3) / 2.4, 0, 1)
    smooth = way**3 * (10 - 15 * way + 6 * way**2)
    return recorded(HOME + smooth[:, None] * np.array([0.05, 0.12]))


@pytest.fixture(scope="module")
def hypotheses(comparison: ResidualModel) -> Hypotheses:
    best = with_new_jacobian(stated(comparison, [EFFECT], [np.array([1.0])]), comparison)
    return open_hypotheses(comparison, best, [((EFFECT.kind, EFFECT.where), RIVALS)])


LIBRARY = (
    Motion(kind="holds", joints=(0,), amplitude=0.1, speed=0.8, seconds=2.0),
    Motion(kind="constant_speed", joints=(1,), amplitude=0.4, speed=1.0, seconds=3.0),
    Motion(kind="random", joints=(0,), amplitude=0.1, speed=0.5, seconds=2.0),
)


@pytest.fixture(scope="module")
def chosen(comparison: ResidualModel, hypotheses: Hypotheses) -> NextMotion:
    found = choose_motion(comparison, hypotheses, motions=LIBRARY)
    assert found is not None
    return found


def test_the_chosen_motion_separates_better_than_a_random_one(
    comparison: ResidualModel, hypotheses: Hypotheses, chosen: NextMotion
) -> None:
    (pair,) = hypotheses.pairs
    assert pair.description == "viscous_friction at elbow from coulomb_friction at elbow"
    assert pair.nats < 5  # open before the motion
    assert chosen.candidate.motion == LIBRARY[1]
    random = choose_motion(comparison, hypotheses, motions=LIBRARY[2:])
    (gain,) = chosen.gains
    assert gain.nats > 5
    assert random is None or gain.nats > 2 * random.gains[0].nats


def test_the_expected_gain_comes_true(
    comparison: ResidualModel, hypotheses: Hypotheses, chosen: NextMotion
) -> None:
    commands = chosen.candidate.played.controls
    both = ResidualModel(
        MACHINE, [*comparison.trials, *recorded(commands).trials], CHANNELS, comparison.floors,
        threads=1,
    )  # fmt: skip
    best = with_new_jacobian(stated(both, [EFFECT], [np.array([1.0])]), both)
    after = open_hypotheses(both, best, [((EFFECT.kind, EFFECT.where), RIVALS)])
    (before,), (now,) = hypotheses.pairs, after.decided
    expected = chosen.gains[0].if_effect_nats
    # Half a sum of squares of a known mean has a variance of twice its mean.
    assert now.nats - before.nats == pytest.approx(expected, abs=3 * np.sqrt(2 * expected))


@pytest.mark.parametrize(
    ("settings", "pose", "reason"),
    [
        ({}, (0.2, 2.2), "elbow would move"),
        ({"next_max_speed_rad_s": 0.15}, (0.5, 1.4), "need a speed"),
        ({}, (0.0, 0.0), "lower and world would touch"),
        ({"next_torque_share": 0.05}, (0.5, 1.4), "need a torque"),
    ],
)
def test_a_motion_beyond_a_limit_is_refused(
    comparison: ResidualModel,
    hypotheses: Hypotheses,
    settings: dict[str, Any],
    pose: tuple[float, float],
    reason: str,
) -> None:
    limits = limits_of(MACHINE, comparison.trials, NextMotionSettings(**settings))
    likely = hypotheses.answer.hypothesis.of_model
    runs = MotionRuns(comparison, likely, hypotheses.weights)
    way = np.clip((np.arange(round(4.2 * RATE)) / RATE - 0.3) / 3.6, 0, 1)[:, None]
    played = runs.played(HOME + way**3 * (10 - 15 * way + 6 * way**2) * (np.array(pose) - HOME))
    assert reason in limits.refusal(played)


def test_the_files_read_as_a_run_of_the_recording(chosen: NextMotion, tmp_path: Path) -> None:
    summary, (csv, parquet, described) = write_next_motion(tmp_path, chosen, NextMotionSettings())
    again = read_next_motion(described)
    assert again.words == summary.words and again.refused == summary.refused
    assert again.pairs[0].nats == pytest.approx(summary.pairs[0].nats, rel=1e-5)
    assert {p.name for p in (csv, parquet)} == {f"{NEXT_MOTION}.csv", f"{NEXT_MOTION}.parquet"}
    text = '{"format": "loose-recording/1", "model": "m.xml", "runs": [{"file": "%s"}]}'
    (tmp_path / "m.xml").write_text(MODEL)
    found = []
    for file in (csv, parquet):
        (tmp_path / "recording.json").write_text(text % file.name)
        (run,) = read_recording(tmp_path).runs
        assert run.comparison == "forward"
        assert np.array_equal(run.controls["two"], chosen.candidate.played.controls[:, 1])
        found.append(run)
    assert np.array_equal(found[0].sensors["q1"], found[1].sensors["q1"])
    assert summary.settings == asdict(NextMotionSettings())
    lines = next_motion_lines(summary)
    assert "viscous_friction at elbow from coulomb_friction at elbow" in lines[1]


def test_where_no_motion_can_be_chosen_none_is(
    comparison: ResidualModel, hypotheses: Hypotheses
) -> None:
    assert choose_motion(comparison, replace(hypotheses, pairs=())) is None
    free = ResidualModel(
        MACHINE, [replace(t, form="free") for t in comparison.trials], CHANNELS,
        comparison.floors, threads=1,
    )  # fmt: skip
    with pytest.raises(InvalidData, match="neither commands nor torques"):
        choose_motion(free, hypotheses, motions=LIBRARY)
    spec = mujoco.MjSpec.from_string(MODEL)
    spec.actuator("two").set_to_motor()
    with pytest.raises(InvalidData, match="position and torque commands"):
        drive_of(NominalModel(spec))
    with pytest.raises(InvalidSetting, match="next_seconds must be positive"):
        NextMotionSettings(next_seconds=0.0)


def test_torque_commands_follow_the_desired_positions_and_replay() -> None:
    spec = mujoco.MjSpec.from_string(MODEL)
    for motor in spec.actuators:
        motor.set_to_motor()
        motor.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    machine = NominalModel(spec, step=STEP)
    time = np.arange(round(2 * RATE)) / RATE
    noise = np.random.default_rng(3).normal(0, 1e-4, (4, len(time)))
    wave = HOME[:, None] + 0.1 * np.sin(2 * time) + noise[:2]
    run = Run(
        name="a.csv", time=time, sensors={"q1": wave[0], "q2": wave[1]},
        controls={"one": 20 * np.sin(2 * time) + noise[2], "two": np.cos(time) + noise[3]},
    )  # fmt: skip
    trial = align_run(run, machine, CHANNELS, step=STEP)
    comparison = ResidualModel(machine, [trial], CHANNELS, np.full(2, 1e-4), threads=1)
    runs = MotionRuns(comparison, Hypothesis(), np.ones(2))
    assert runs.drive == "torque"
    way = np.clip(np.arange(round(3 * RATE)) / RATE - 0.3, 0, 2)[:, None] / 2
    played = runs.played(HOME + 0.4 * way**3 * (10 - 15 * way + 6 * way**2))
    assert np.abs(played.position - played.desired).max() < 0.05
    assert played.controls.shape == (len(way), 2)
    compared = runs.compared([played])
    assert np.isfinite(compared.measured).all() and len(compared) == 2 * len(way) - 26
