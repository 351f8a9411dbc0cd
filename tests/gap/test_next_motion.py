"""The next motion: it keeps the limits, and separates what the runs left open."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap import (
    NEXT_MOTION,
    Answer,
    GapSettings,
    Hypothesis,
    Motion,
    NextMotion,
    NextMotionSettings,
    choose_next,
    find_gap,
    next_motion,
    next_motion_lines,
    write_next_motion,
)
from loose_env.gap.core.decision import decide
from loose_env.gap.core.motion import smooth
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.next_motion import FORMAT, NOTHING, Player, drive_of, limits_of, open_pairs
from loose_env.gap.servo_arm import MotionLimits
from loose_env.recording import Recording, Run, read_recording, write_recording
from loose_env.typing import Array

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
    <position name="one" joint="shoulder" kp="150" kv="8" forcerange="-40 40"/>
    <position name="two" joint="elbow" kp="60" kv="3" forcerange="-15 15"/>
  </actuator>
  <sensor><jointpos name="q1" joint="shoulder"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""
"""Two joints before a wall that the stretched arm would touch."""
RATE, FRICTION = 250.0, 0.2
HOME = np.array([0.2, 1.0])
KINDS = GapSettings(threads=1, simulate=False, kinds=("coulomb_friction", "viscous_friction"))
LIBRARY = (
    Motion(kind="holds", joints=(0,), amplitude=0.1, speed=0.8, seconds=2.0),
    Motion(kind="constant_speed", joints=(1,), amplitude=0.4, speed=1.0, seconds=3.0),
    Motion(kind="random", joints=(0,), amplitude=0.1, speed=0.5, seconds=2.0),
)


def way(seconds: float, moves: float, to: Array, home: Array = HOME) -> Array:
    """Commands from home to a pose and to rest (T, joints)."""
    s = np.clip((np.arange(round(seconds * RATE)) / RATE - 0.3) / moves, 0, 1)[:, None]
    return np.asarray(home + s**3 * (10 - 15 * s + 6 * s**2) * (to - home))


def recorded(
    name: str, commands: Array, spec: mujoco.MjSpec | None = None, at: str = "elbow"
) -> Run:
    """A run of an arm with dry friction at a joint, the elbow of the two joints."""
    spec = mujoco.MjSpec.from_string(MODEL) if spec is None else spec.copy()
    spec.joint(at).frictionloss = FRICTION
    spec.option.timestep = 1 / RATE
    model, rng = spec.compile(), np.random.default_rng(len(name))
    data, shown = mujoco.MjData(model), np.zeros_like(commands)
    data.qpos[:], data.ctrl[:] = commands[0], commands[0]
    mujoco.mj_step(model, data, 500)
    for row, command in zip(shown, commands, strict=True):
        mujoco.mj_forward(model, data)
        row[:], data.ctrl[:] = data.qpos, command
        mujoco.mj_step(model, data)
    shown += rng.normal(0, 4e-5, shown.shape)
    return Run(
        name=name, time=np.arange(len(commands)) / RATE,
        controls={model.actuator(k).name: own for k, own in enumerate(commands.T)},
        sensors={model.sensor(k).name: own for k, own in enumerate(shown.T)},
    )  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Runs in which the elbow turns once: friction is not told from nothing."""
    ends = ((0.25, 1.4), (0.25, 1.5))
    runs = [recorded(f"{'a' * k}.csv", way(3, 2.4, np.array(e))) for k, e in enumerate(ends, 1)]
    return write_recording(tmp_path_factory.mktemp("arm"), model_xml=MODEL, runs=runs)


@pytest.fixture(scope="module")
def answer(recording: Recording) -> Answer:
    return find_gap(recording, KINDS)


@pytest.fixture(scope="module")
def chosen(answer: Answer) -> tuple[NextMotion, Run]:
    found = choose_next(answer, Hypothesis(), motions=LIBRARY)
    assert found is not None
    return found


def player_of(recording: Recording, model: str = MODEL) -> tuple[Player, MotionLimits]:
    """Player and limits of a recording."""
    machine = NominalModel(mujoco.MjSpec.from_string(model))
    motion = smooth(recording, machine)
    limits = limits_of(machine, motion, NextMotionSettings())
    return Player(recording, machine, motion, Hypothesis()), limits


def test_the_chosen_motion_shows_what_the_runs_left_open(
    recording: Recording, answer: Answer, chosen: tuple[NextMotion, Run]
) -> None:
    assert not any(f.named for f in answer.decision.findings)
    (pair,) = open_pairs(answer)
    assert pair.effect is None and pair.rival.words == "coulomb_friction at elbow"
    motion, run = chosen
    (gain,) = motion.pairs
    assert gain.effect == NOTHING and gain.nats > 5 and abs(gain.so_far_nats) < 5
    commands = np.stack([run.controls[name] for name in ("one", "two")], axis=1)
    runs = (*recording.runs, *(recorded(f"{'next' * k}.csv", commands) for k in (1, 2)))
    after = find_gap(replace(recording, runs=runs), KINDS)
    (found,) = [f for f in after.decision.findings if f.named]
    assert found.term.name == ("coulomb_friction", "elbow")
    assert found.values[0] == pytest.approx(FRICTION, rel=0.3)
    narrower = choose_next(
        after, Hypothesis((found.term.effect,), (found.values,)), motions=LIBRARY[1:2]
    )
    if narrower is not None:
        assert not narrower[0].pairs and narrower[0].narrowed[0].share < 0.7


def test_a_rival_is_separated_by_what_it_cannot_do(
    answer: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(next_motion, "DECIDED", 1e9)
    term = open_pairs(answer)[0].rival.term
    fit = answer.selection.solve((term,))
    finding = decide(answer.selection, fit).findings[0]
    finding = replace(finding, doubt="", confusable=(("viscous_friction", "elbow"),))
    likely = replace(answer, decision=replace(answer.decision, findings=(finding,), fit=fit))
    pairs = {(p.effect and p.effect.words, p.rival.words) for p in open_pairs(likely)}
    assert ("coulomb_friction at elbow", "viscous_friction at elbow") in pairs
    named = Hypothesis((term.effect,), (finding.values,))
    found = choose_next(likely, named, motions=LIBRARY[1:2])
    assert found is not None
    gain = next(g for g in found[0].pairs if g.rival == "viscous_friction at elbow")
    assert gain.if_effect_nats > 1 and gain.if_rival_nats >= 0
    assert any("from viscous_friction" in line for line in next_motion_lines(found[0]))


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
    recording: Recording, settings: dict[str, Any], pose: tuple[float, float], reason: str
) -> None:
    player, _ = player_of(recording)
    motion = smooth(recording, player.machine)
    limits = limits_of(player.machine, motion, NextMotionSettings(**settings))
    assert reason in limits.refusal(player.play(way(4.2, 3.6, np.array(pose))))


def test_the_files_read_as_a_run_of_the_recording(
    chosen: tuple[NextMotion, Run], tmp_path: Path
) -> None:
    csv, parquet, described = write_next_motion(tmp_path, *chosen)
    again, (summary, planned) = json.loads(described.read_text("utf-8")), chosen
    assert again["format"] == FORMAT and again["words"] == summary.words
    gained = again["pairs"][0]["if_rival_nats"]
    assert gained == pytest.approx(summary.pairs[0].if_rival_nats, rel=1e-5)
    assert {p.name for p in (csv, parquet)} == {f"{NEXT_MOTION}.csv", f"{NEXT_MOTION}.parquet"}
    text = '{"format": "loose-recording/1", "model": "m.xml", "runs": [{"file": "%s"}]}'
    (tmp_path / "m.xml").write_text(MODEL)
    found = []
    for file in (csv, parquet):
        (tmp_path / "recording.json").write_text(text % file.name)
        (run,) = read_recording(tmp_path).runs
        assert run.comparison == "forward"
        assert np.array_equal(run.controls["two"], planned.controls["two"])
        found.append(run)
    assert np.array_equal(found[0].sensors["q1"], found[1].sensors["q1"])
    assert summary.settings == asdict(NextMotionSettings())
    lines = next_motion_lines(summary)
    assert "shows coulomb_friction at elbow if it is there" in lines[1]


def test_where_no_motion_can_be_chosen_the_reason_is_said(
    recording: Recording, answer: Answer
) -> None:
    sure = replace(answer, decision=replace(answer.decision, findings=(), rivals=()))
    assert choose_next(sure, Hypothesis(), motions=LIBRARY) is None
    free = replace(recording, runs=tuple(replace(r, controls={}) for r in recording.runs))
    with pytest.raises(InvalidData, match="neither commands nor torques"):
        player_of(free)
    with pytest.raises(InvalidData, match=r"no motion fits the machine; .* takes longer than 1 s"):
        choose_next(answer, Hypothesis(), NextMotionSettings(next_seconds=1.0), motions=LIBRARY)
    spec = mujoco.MjSpec.from_string(MODEL)
    spec.actuator("two").set_to_motor()
    with pytest.raises(InvalidData, match="position and torque commands"):
        drive_of(NominalModel(spec))
    with pytest.raises(InvalidSetting, match="next_seconds must be positive"):
        NextMotionSettings(next_seconds=0.0)


def test_torque_commands_and_torque_logs_follow_the_desired_positions(
    recording: Recording,
) -> None:
    motors = re.sub(r"<position (.*?) kp.*?/>", r"<motor \1/>", MODEL)
    player, _ = player_of(recording, motors)
    desired = way(3, 2.0, HOME + 0.4)
    played = player.play(desired)
    assert player.drive == "torque" and played.controls.shape == desired.shape
    assert np.abs(played.position - played.desired).max() < 0.05
    log = [
        replace(r, controls={}, torques={"shoulder": r.controls["one"], "elbow": r.controls["two"]})
        for r in recording.runs
    ]
    player, _ = player_of(replace(recording, runs=tuple(log)))
    played = player.play(desired)
    run = player.run("log", played)
    assert np.abs(played.position - played.desired).max() < 0.05
    assert run.comparison == "inverse" and set(run.torques) == {"shoulder", "elbow"}


@pytest.mark.slow
def test_the_library_of_a_six_joint_arm_has_a_motion_that_shows_what_is_open(
    tmp_path: Path,
) -> None:
    spec = mujoco.MjSpec.from_file(str(SIX_AXIS_SERVO_ARM))
    names = [joint.name for joint in spec.joints]
    for name in names:
        spec.add_sensor(
            name=f"{name}_pos", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name,
        )  # fmt: skip
    home = np.array(spec.keys[0].qpos)
    ends = home + 0.2 * np.array([[1, -1, 1, -1, 1, -1], [-1, -1, 1, 1, 1.2, 1]])
    runs = [
        recorded(f"{'a' * k}.csv", way(3, 2.4, end, home), spec, at="joint5")
        for k, end in enumerate(ends, 1)
    ]
    found = find_gap(write_recording(tmp_path, model_xml=spec.to_xml(), runs=runs), KINDS)
    named = [f for f in found.decision.findings if f.named]
    corrected = Hypothesis(tuple(f.term.effect for f in named), tuple(f.values for f in named))
    chosen = choose_next(found, corrected)
    assert chosen is not None
    motion, run = chosen
    assert motion.considered > 10 and ("joint5" in motion.words or "all joints" in motion.words)
    assert set(run.controls) == {f"motor{k}" for k in range(1, 7)}
    assert np.ptp(run.controls["motor5"]) > 0.005  # it moves the joint that is open
    gains = [pair.nats for pair in motion.pairs if pair.separates]
    assert gains or min(each.share for each in motion.narrowed) < 0.7
