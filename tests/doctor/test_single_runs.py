"""A unit or a sign that is wrong in one run alone is found there, and corrected there."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main as loose
from loose_env.doctor import Correction, Report, examine, write_corrected
from loose_env.recording import Recording, Run, read_recording, write_recording
from loose_env.typing import Array
from tests.doctor.machine import JOINTS

WRONG = "run-1.parquet"


def in_one_run(recording: Recording, change: Callable[[Run], Run]) -> Recording:
    runs = tuple(change(run) if run.name == WRONG else run for run in recording.runs)
    return replace(recording, runs=runs)


def columns(prefix: str, change: Callable[[Array], Array]) -> Callable[[Run], Run]:
    def changed(given: Mapping[str, Array]) -> dict[str, Array]:
        return {n: change(v) if n.startswith(prefix) else v for n, v in given.items()}

    return lambda run: replace(
        run, sensors=changed(run.sensors), torques=changed(run.torques), pose=run.pose
    )


def as_torques(recording: Recording) -> Recording:
    def changed(run: Run) -> Run:
        return replace(run, controls={}, torques={j: run.controls[f"m_{j}"] for j in JOINTS})

    return replace(recording, runs=tuple(map(changed, recording.runs)))


def errors(report: Report) -> set[tuple[str, str, str]]:
    return {(one.check, one.run, one.channel) for one in report.errors}


@pytest.mark.parametrize("poses", [True, False], ids=["poses noted", "limits alone"])
def test_degrees_of_one_run_are_found_and_corrected_there(
    servo: Recording, tmp_path: Path, poses: bool
) -> None:
    sound = (
        servo
        if poses
        else replace(servo, runs=tuple(replace(run, pose=None, controls={}) for run in servo.runs))
    )
    wrong = in_one_run(sound, columns("q_", np.degrees))
    report = examine(wrong)
    assert errors(report) == {("units", WRONG, f"sensor.q_{joint}") for joint in JOINTS}
    fixes = [one.fix for one in report.errors if one.fix is not None]
    assert all(WRONG in fix.words for fix in fixes)
    made = write_corrected(wrong, fixes, tmp_path / "corrected")
    for run, true in zip(made.runs, sound.runs, strict=True):
        for name, values in true.sensors.items():
            np.testing.assert_allclose(run.sensors[name], values, rtol=1e-12)


def test_a_joint_near_zero_has_the_unit_of_the_other_joints_of_its_run(servo: Recording) -> None:
    def at_zero(run: Run) -> Run:
        sensors = dict(run.sensors)
        sensors["q_fore"] = sensors["q_fore"] - sensors["q_fore"].mean() + 0.02
        return columns("q_", np.degrees)(replace(run, sensors=sensors))

    without = tuple(replace(run, pose=None, controls={}) for run in servo.runs)
    report = examine(in_one_run(replace(servo, runs=without), at_zero))
    assert ("units", WRONG, "sensor.q_fore") in errors(report)
    assert {one.run for one in report.errors if one.check == "units"} == {WRONG}


def test_a_sign_of_one_run_is_found_by_its_pose(servo: Recording) -> None:
    report = examine(in_one_run(servo, columns("q_upper", np.negative)))
    assert ("sign", WRONG, "sensor.q_upper") in errors(report)


def test_an_accelerometer_in_g_in_one_run_is_found(servo: Recording) -> None:
    report = examine(in_one_run(servo, columns("acc", lambda v: v / 9.80665)))
    assert ("units", WRONG, "sensor.acc") in errors(report)


@pytest.mark.parametrize("held", [True, False], ids=["with gravity", "added noise alone"])
def test_torques_in_newton_millimetres_in_one_run_are_found(motor: Recording, held: bool) -> None:
    sound = as_torques(motor)
    if not held:  # of the shaken joint, without the torque that holds the pose
        shaken = sound.runs[1]
        noise = {"upper": shaken.torques["upper"] - shaken.torques["upper"].mean()}
        runs = tuple(replace(shaken, name=run.name, torques=noise) for run in sound.runs)
        sound = replace(sound, runs=runs)
    assert not examine(sound).errors
    report = examine(in_one_run(sound, columns("upper", lambda v: 1e3 * v)))
    assert ("units", WRONG, "torque.upper") in errors(report)
    assert {one.run for one in report.errors} == {WRONG}


def test_a_command_in_degrees_in_one_run_is_found(servo: Recording) -> None:
    def changed(run: Run) -> Run:
        return replace(run, controls={n: np.degrees(v) for n, v in run.controls.items()})

    report = examine(in_one_run(servo, changed))
    assert {("units", WRONG, f"ctrl.m_{joint}") for joint in JOINTS} <= errors(report)


def test_equal_changes_of_a_run_are_applied_once(servo: Recording, tmp_path: Path) -> None:
    twice = Correction(kind="scale", columns=("sensor.q_base",), factor=2.0)
    made = write_corrected(servo, [twice, twice.of(WRONG)], tmp_path / "made")
    for run, true in zip(made.runs, servo.runs, strict=True):
        np.testing.assert_array_equal(run.sensors["q_base"], 2 * true.sensors["q_base"])


def test_a_corrected_recording_keeps_format_dates_and_planned_runs(
    servo: Recording, tmp_path: Path
) -> None:
    home = tmp_path / "recording"
    runs = [
        replace(run, name=f"run-{k}.csv", time=run.time[:200],
                controls={n: v[:200] for n, v in run.controls.items()},
                sensors={n: v[:200] for n, v in run.sensors.items()})
        for k, run in enumerate(servo.runs)
    ]  # fmt: skip
    write_recording(home, model_xml=servo.model_path, runs=runs, file_format="csv")
    description = json.loads(home.joinpath("recording.json").read_text("utf-8"))
    planned = {"file": "repeat-01.csv", "excited": ["fore"], "planned": True}
    description["runs"].append(planned)
    home.joinpath("recording.json").write_text(json.dumps(description), "utf-8")
    for k in range(3):
        os.utime(home / f"run-{k}.csv", (1.6e9 + k, 1.6e9 + k))
    fix = Correction(kind="shift", columns=("sensor.q_base",), seconds=0.01)
    made = write_corrected(read_recording(home), [fix], tmp_path / "corrected")
    assert [run.name for run in made.runs] == ["run-0.csv", "run-1.csv", "run-2.csv"]
    times = [made.folder.joinpath(run.name).stat().st_mtime for run in made.runs]
    assert times == [1.6e9, 1.6e9 + 1, 1.6e9 + 2]
    entry = json.loads(made.folder.joinpath("recording.json").read_text("utf-8"))["runs"][-1]
    assert entry == {**planned, "condition": "suspect"}
    moved = made.runs[0].sensors["q_base"]
    assert np.isnan(moved[-10:]).all() and np.isfinite(moved[:-10]).all()


def test_findings_are_printed_where_the_corrected_recording_cannot_be_written(
    servo: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = [columns("q_", np.degrees)(run) for run in servo.runs]
    home, out = tmp_path / "wrong", tmp_path / "taken"
    write_recording(home, model_xml=servo.model_path, runs=wrong)
    out.mkdir()
    out.joinpath("notes.txt").write_text("of the user")
    assert loose(["doctor", str(home), "--fix", str(out)]) != 0
    printed = capsys.readouterr()
    assert "degrees instead of radians" in printed.out
    assert "not empty" in printed.err and "overwrite=True" not in printed.err
    assert [each.name for each in out.iterdir()] == ["notes.txt"]
