"""Plans keep a machine's limits, are written for it, and go on from what was found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.instrument import (
    PRESETS,
    Diagnosis,
    Place,
    PlanSettings,
    commands_of,
    next_number,
    plan,
    read_plan,
    write_plan,
)
from loose_env.recording import read_description
from tests.instrument.machine import JOINTS, LINKS, NOMINAL


def derivatives(played: np.ndarray, commands: str, rate: float) -> list[np.ndarray]:
    """Speed, acceleration and jerk of commands (T, n)."""
    speed = np.diff(played, axis=0) * rate if commands == "position" else played
    acceleration = np.diff(speed, axis=0) * rate
    return [speed, acceleration, np.diff(acceleration, axis=0) * rate]


@pytest.mark.parametrize("commands", ["position", "velocity"])
@pytest.mark.parametrize("controller", list(PRESETS))
def test_limits_are_kept_from_the_first_sample_on(controller: str, commands: str) -> None:
    own = PlanSettings(
        controller=controller, commands=commands, poses=3, rate_hz=1000.0,
        max_jerk_rad_s3=(1500.0,),
    )  # fmt: skip
    made, arm = plan(SIX_AXIS_SERVO_ARM, own)
    limits = own.limits
    most = (limits.max_speed_rad_s[0], limits.max_acceleration_rad_s2[0], 1500.0)
    for run in made.runs:
        _, played = commands_of(made, arm, run)
        for values, limit in zip(derivatives(played, commands, 1000.0), most, strict=True):
            assert np.abs(values).max() <= 1.01 * limit
        if commands == "position":
            assert (played >= arm.low).all() and (played <= arm.high).all()
            np.testing.assert_allclose(played[0], [run.pose[j] for j in arm.joints], atol=1e-9)
        else:
            np.testing.assert_allclose(played[0], 0, atol=1e-9)


@pytest.mark.parametrize(
    ("order", "limits"),
    [(0, {"max_speed_rad_s": (0.05, 0.1, 0.2)}), (1, {"max_acceleration_rad_s2": (1.0, 2.0, 4.0)})],
)
def test_a_limit_of_each_joint_holds_for_it(bench: Path, order: int, limits: Any) -> None:
    made, arm = plan(bench, PlanSettings(poses=3, rate_hz=1000.0, **limits))
    for run in made.runs:
        values = derivatives(commands_of(made, arm, run)[1], "position", 1000.0)[order]
        reached = np.abs(values).max(0) / next(iter(limits.values()))
        assert (reached <= 1.01).all() and reached.max() > 0.9


def test_drives_can_give_the_torque_that_a_plan_asks_for(bench: Path) -> None:
    torque = (60.0, 90.0, 40.0)
    own = PlanSettings(poses=4, max_torque_nm=torque, max_acceleration_rad_s2=(1e3,))
    made, arm = plan(bench, own)
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    data = mujoco.MjData(model)
    model.dof_armature[:] = 0.0  # rotors and friction take the rest of the drives' torque
    for run in made.runs:
        _, played = commands_of(made, arm, run)
        speed, acceleration, _ = derivatives(played, "position", own.limits.rate_hz)
        asked = []
        for q, v, a in zip(played[1:-1], speed[1:], acceleration, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(model, data)
            asked.append(data.qfrc_inverse.copy())
        assert (np.abs(asked).max(0) <= torque).all()
    own = replace(own, commands="torque")
    made, arm = plan(bench, own)
    for run in made.runs:
        pose = np.array([run.pose[j] for j in JOINTS])
        added = np.abs(commands_of(made, arm, run)[1]).max(0)
        assert (added + np.abs(arm.at(pose).torque) <= torque).all()


def test_lines_are_odd_and_the_same_every_month(bench: Path) -> None:
    made, _ = plan(bench, PlanSettings(poses=3))
    assert plan(bench, PlanSettings(poses=3))[0] == made
    assert all(k % 2 for k in (*made.signal.excited, *made.signal.silent))
    assert max(made.signal.excited) / made.signal.period_s <= PlanSettings().limits.bandwidth_hz
    arm_poses = np.array([[run.pose[j] for j in JOINTS] for run in made.runs])
    spread = np.abs(arm_poses[:, None] - arm_poses[None]).max(-1)
    assert (spread + np.eye(3) > 0.1).all()


def test_levels_and_a_reference_are_runs_of_their_own(bench: Path) -> None:
    made, _ = plan(bench, PlanSettings(poses=3, levels=(0.4, 1.0), reference=True))
    assert [r.file for r in made.runs[:6]] == [f"run-{k:02d}.csv" for k in range(1, 7)]
    assert [r.file for r in made.runs[6:]] == [f"reference-{k:02d}.csv" for k in range(1, 7)]
    low, full = made.runs[0], made.runs[3]
    assert low.pose == full.pose and (low.level, full.level) == (0.4, 1.0)
    for joint, peak in full.peak.items():
        assert low.peak[joint] == pytest.approx(0.4 * peak, abs=1e-3)
    assert {r.condition for r in made.runs[6:]} == {"healthy"}
    assert made.seconds == pytest.approx(6 * made.signal.signal.seconds)


def test_a_plan_is_written_read_back_and_ready_to_be_filled(bench: Path, tmp_path: Path) -> None:
    made, arm = plan(bench, PlanSettings(poses=3, commands="velocity", reference=True))
    written = write_plan(tmp_path, made, arm)
    assert all(path.is_file() for path in written)
    assert read_plan(tmp_path) == read_plan(tmp_path / "recording") == made
    for run in (r for r in made.runs if r.condition == "suspect"):
        table = np.genfromtxt(tmp_path / run.file, delimiter=",", names=True)
        names = (tmp_path / run.file).read_text().splitlines()[0].split(",")
        assert names == ["time", *(f"velocity.{j}" for j in JOINTS)]
        time, played = commands_of(made, arm, run)
        np.testing.assert_allclose(table["time"], time)
        np.testing.assert_allclose(np.array(table.tolist())[:, 1:], played, atol=1e-12)
    entries = read_description(tmp_path / "recording" / "recording.json").runs
    assert made.sweep is not None
    assert [e.file for e in entries] == [r.file for r in (made.sweep, *made.runs)]
    assert all(e.planned for e in entries)
    stated = mujoco.MjModel.from_xml_path(str(tmp_path / "recording" / "model.xml"))
    assert stated.sensor("acc").type == mujoco.mjtSensor.mjSENS_ACCELEROMETER
    assert next_number(tmp_path) == 1
    described = tmp_path / "recording" / "recording.json"
    other = json.loads(described.read_text())
    other["runs"] += [{"file": "knock.csv"}, {"file": "extra-7.csv"}]
    described.write_text(json.dumps(other))
    for name in ("knock", "extra-7"):
        (tmp_path / "recording" / f"{name}.csv").write_text("time\n0\n")
    assert next_number(tmp_path) == 8


def diagnosed(verdict: str, **verdicts: str) -> Diagnosis:
    places = [("structural_looseness", at) for at in LINKS] + [("backlash", at) for at in JOINTS]
    return Diagnosis(
        verdict=verdict, headline="", remedy="", settled=False,
        places=tuple(
            Place(kind=kind, at=at, verdict=verdicts.get(at, "tight"), probability=0.0,
                  rhythm=0.0, tested=1.0)
            for kind, at in places
        ),
    )  # fmt: skip


def test_a_second_plan_goes_on_with_the_numbers(bench: Path, tmp_path: Path) -> None:
    made, arm = plan(bench, PlanSettings(poses=3))
    write_plan(tmp_path, made, arm)
    for run in made.runs[:2]:
        (tmp_path / "recording" / run.file).write_text("time\n0\n")
    assert next_number(tmp_path) == 3
    known = diagnosed("loose", fore="suspect", bend="suspect")
    second, arm = plan(bench, PlanSettings(poses=3), known=known, first=3)
    assert [r.file for r in second.runs] == ["run-03.csv", "run-04.csv", "run-05.csv"]
    assert [r.pose for r in second.runs] != [r.pose for r in made.runs]
    write_plan(tmp_path, second, arm)
    whole = read_plan(tmp_path)
    assert whole.runs == (*made.runs[:2], *second.runs)
    entries = read_description(tmp_path / "recording" / "recording.json").runs
    assert [e.file for e in entries] == [r.file for r in whole.runs]


def test_a_folder_or_a_diagnosis_of_another_session_is_refused(bench: Path, tmp_path: Path) -> None:
    made, arm = plan(bench, PlanSettings(poses=3))
    write_plan(tmp_path, made, arm)
    (tmp_path / "recording" / "run-01.csv").write_text("time\n0\n")
    with pytest.raises(InvalidData, match=r"run-01\.csv is measured already"):
        write_plan(tmp_path, made, arm)
    slower = plan(bench, PlanSettings(poses=3, bandwidth_hz=15.0), first=2)
    with pytest.raises(InvalidData, match=r"planned with another signal, up to 2\d Hz"):
        write_plan(tmp_path, *slower)
    other = plan(bench, PlanSettings(poses=3, payload_kg=1.0), first=2)
    with pytest.raises(InvalidData, match="planned with another model, tool or payload"):
        write_plan(tmp_path, *other)
    assert read_plan(tmp_path) == made
    with pytest.raises(InvalidData, match="the diagnosis is of another arm"):
        plan(SIX_AXIS_SERVO_ARM, PlanSettings(poses=3), known=diagnosed("tight"))


@pytest.mark.parametrize(
    ("own", "says"),
    [
        ({"poses": 2}, "poses is 3 to 24, got 2"),
        ({"levels": (1.0, 0.5)}, "levels go upwards"),
        ({"levels": (0.0,)}, "above 0"),
        ({"levels": ()}, "above 0"),
        ({"commands": "force"}, "position, velocity or torque"),
        ({"corner_hz": 0.0}, "above 0 Hz"),
        ({"rate_hz": -1.0}, "rate_hz is above 0"),
        ({"bandwidth_hz": 5.0}, "8 Hz or more"),
        ({"max_speed_rad_s": (-1.0,)}, "one positive number"),
        ({"max_speed_rad_s": (1.0, 1.0)}, "one value for all joints"),
        ({"payload_kg": -1.0}, "zero or more"),
        ({"payload_kg": float("nan")}, "zero or more"),
        ({"low": (0.0,)}, "one position for each of turn, lift, bend; got 1"),
        ({"low": (3.0,) * 3}, "joint turn has no room"),
        ({"low": (0.0, 0.95, 1.2), "high": (0.1, 1.05, 1.3)}, "free of collisions and above the"),
        ({"controller": "ur_rtd"}, "did you mean 'ur_rtde'"),
        ({"tool": "flange"}, "flange"),
    ],
)
def test_settings_that_make_no_sense_are_refused_in_a_line(
    bench: Path, own: dict[str, Any], says: str
) -> None:
    with pytest.raises((InvalidSetting, UnknownName), match=says) as refused:
        plan(bench, PlanSettings(**own))
    assert "\n" not in str(refused.value)
