"""Findings of the preflight: units, signs, axes, clocks, sampling, channels, entries; report."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from loose_env.doctor import DoctorSettings, Finding, Report, examine
from loose_env.errors import InvalidSetting
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array
from tests.doctor.machine import (
    JOINTS,
    MOTORS,
    each_run,
    late,
    record,
    with_controls,
    with_sensors,
    xml,
)

Change = Callable[[Recording], Recording]
Columns = Callable[[Array], Array]
G = 9.80665
WRONG = "run-1.parquet"
ENCODERS = {f"sensor.q_{joint}" for joint in JOINTS}
COMMANDS = {f"ctrl.m_{joint}" for joint in JOINTS}


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """The same arm on position servos, on torque motors, and with torques in place of commands."""
    home = tmp_path_factory.mktemp("doctor")
    motor = record(home / "motor", MOTORS)
    torques = each_run(motor, lambda run: as_torques(run, 1.0))
    return {"servo": record(home / "servo"), "motor": motor, "torques": torques}


@pytest.fixture
def servo(machines: dict[str, Recording]) -> Recording:
    return machines["servo"]


def as_torques(run: Run, factor: float) -> Run:
    return replace(run, controls={}, torques={j: factor * run.controls[f"m_{j}"] for j in JOINTS})


def sensors(prefix: str, change: Columns) -> Change:
    return lambda recording: with_sensors(recording, prefix, change)


def controls(change: Columns) -> Change:
    return lambda recording: with_controls(recording, change)


def runs(change: Callable[[Run], Run]) -> Change:
    return lambda recording: each_run(recording, change)


def both(*changes: Change) -> Change:
    def changed(recording: Recording) -> Recording:
        for change in changes:
            recording = change(recording)
        return recording

    return changed


def in_one_run(change: Change) -> Change:
    """A change of one run alone."""

    def changed(recording: Recording) -> Recording:
        wrong = change(recording).runs
        pairs = zip(recording.runs, wrong, strict=True)
        return replace(recording, runs=tuple(w if r.name == WRONG else r for r, w in pairs))

    return changed


WITHOUT_POSES = runs(lambda run: replace(run, pose=None))
SILENT = runs(lambda run: replace(run, controls={}, excited=(), pose=None))


def test_a_clean_recording_has_no_finding(machines: dict[str, Recording]) -> None:
    for recording in machines.values():
        assert not examine(recording).findings


# ---------------------------------------------------------- contradictions of model and channels

CONTRADICTIONS: dict[str, tuple[str, Change, str, set[str], str]] = {
    "degrees": ("servo", sensors("q_", np.degrees), "units", ENCODERS, "degrees"),
    "degrees by limits alone": (
        "motor", both(sensors("q_", np.degrees), WITHOUT_POSES), "units", ENCODERS, "degrees"),
    "a pose in degrees": (
        "servo",
        runs(lambda run: replace(run, pose={j: np.degrees(q) for j, q in run.pose.items()})),
        "units", {f"pose of {j}" for j in JOINTS}, "degrees"),
    "an encoder against its pose": (
        "servo", sensors("q_upper", np.negative), "sign", {"sensor.q_upper"}, ""),
    "gravity against an encoder": (
        "motor",
        both(sensors("q_upper", np.negative), sensors("v_upper", np.negative), WITHOUT_POSES),
        "axes", {"sensor.acc"}, "opposite sign of joint upper's encoder"),
    "a reversed axis": (
        "motor", sensors("acc", lambda v: v * [-1, 1, 1]), "axes", {"sensor.acc"}, "x = -x"),
    "exchanged axes": (
        "motor", sensors("acc", lambda v: v[:, [0, 2, 1]]), "axes", {"sensor.acc"},
        "y = z of the recording, z = y of the recording"),
    "g": ("servo", sensors("acc", lambda v: v / G), "units", {"sensor.acc"}, "g instead of m/s²"),
    "a gyroscope in degrees": (
        "servo", sensors("gyro", np.degrees), "units", {"sensor.gyro"}, ""),
    "a reversed gyroscope": ("servo", sensors("gyro", np.negative), "sign", {"sensor.gyro"}, ""),
    "reversed torques": (
        "torques", runs(lambda r: replace(r, torques={j: -t for j, t in r.torques.items()})),
        "sign", {"torque.fore"}, ""),
    "millimetres": (
        "torques", runs(lambda r: replace(r, torques={j: 1e3 * t for j, t in r.torques.items()})),
        "units", {"torque.fore"}, ""),
    "reversed motors": ("motor", controls(np.negative), "sign", {"ctrl.m_fore"}, ""),
    "motors in millimetres": ("motor", controls(lambda v: 1e3 * v), "units", {"ctrl.m_fore"}, ""),
    "commands in degrees": ("servo", controls(np.degrees), "units", COMMANDS, ""),
    "reversed commands": ("servo", controls(np.negative), "sign", COMMANDS, ""),
}  # fmt: skip


@pytest.mark.parametrize("kind", CONTRADICTIONS)
def test_what_contradicts_the_model_or_another_channel_is_an_error(
    machines: dict[str, Recording], kind: str
) -> None:
    base, change, check, channels, words = CONTRADICTIONS[kind]
    found = [one for one in examine(change(machines[base])).errors if one.check == check]
    named = {one.channel for one in found}
    assert all(any(name.startswith(each) for name in named) for each in channels), named
    assert any(words in one.found for one in found)
    if check == "axes":
        assert {one.unit for one in found} == {"deg"}


@pytest.mark.parametrize("consistent", [True, False])
def test_a_joint_without_limits_that_turns_many_times_is_no_angle_in_degrees(
    servo: Recording, tmp_path: Path, consistent: bool
) -> None:
    free = xml().replace('name="base"', 'name="base" limited="false"')
    time = np.arange(800) / 100
    angle = 30 * np.sin(time)
    speed = 30 * np.cos(time) * (1.0 if consistent else np.pi / 180)
    turning = Run(name="a.csv", time=time, sensors={"q_base": angle, "v_base": speed})
    found = examine(write_recording(tmp_path / "table", model_xml=free, runs=[turning])).findings
    assert [one.channel for one in found if one.check == "units"] == (
        [] if consistent else ["sensor.q_base"]
    )


def test_a_piezoelectric_accelerometer_is_only_noted_and_its_g_known_by_the_motion(
    machines: dict[str, Recording],
) -> None:
    motor = machines["motor"]
    report = examine(with_sensors(motor, "acc", lambda v: v - v.mean(axis=0)))
    assert [(one.check, one.severity) for one in report.findings] == [("gravity", "note")]
    found = examine(with_sensors(motor, "acc", lambda v: (v - v.mean(axis=0)) / G))
    # Without gravity in the reading, a rigid arm's motion may only remark upon the unit.
    assert not found.errors
    assert any(one.check == "units" and one.channel.startswith("sensor.acc")
               for one in found.findings)  # fmt: skip


@pytest.mark.parametrize("seconds", [0.005, -0.003, 0.0021])
def test_a_late_accelerometer_is_measured_with_its_uncertainty(
    servo: Recording, seconds: float
) -> None:
    wrong = with_sensors(servo, "acc", lambda v: late(v, seconds))
    (found,) = examine(wrong).findings
    assert (found.check, found.severity, found.unit) == ("clock", "warning", "s")
    assert found.value == pytest.approx(seconds, abs=1e-4)
    word = "late" if seconds > 0 else "early"
    assert f"clock is {1e3 * abs(seconds):.1f} ms {word} (standard deviation" in found.found
    assert examine(wrong, DoctorSettings(clock_s=0.01)).findings[0].severity == "note"
    with pytest.raises(InvalidSetting, match="clock_s"):
        DoctorSettings(clock_s=0.0)


def test_late_commands_are_told_from_late_readings(machines: dict[str, Recording]) -> None:
    wrong = with_controls(machines["motor"], lambda v: late(v - v.mean(), 0.004) + v.mean())
    (found,) = examine(wrong).findings
    assert "torques and commands are 4.0 ms late" in found.found


def test_joints_that_move_before_their_commands_are_told(servo: Recording) -> None:
    rng, time = np.random.default_rng(2), np.arange(4000) / 200
    slow = signal.butter(2, (0.3, 5.0), "bandpass", fs=200, output="sos")
    path = 0.2 * signal.sosfiltfilt(slow, rng.normal(size=4100))
    path /= 5 * path.std()

    def moved(by: int) -> Run:  # the motion, and commands logged some rows later
        given = {f"m_{j}": path[50 - by : 4050 - by] for j in JOINTS}
        read = {f"q_{j}": path[50:4050] + 1e-4 * rng.normal(size=4000) for j in JOINTS}
        return Run(name="a.csv", time=time, controls=given, sensors=read)

    (found,) = [f for f in examine(replace(servo, runs=(moved(4),))).findings if f.check == "clock"]
    assert "move before their commands: 20.0 ms early" in found.found
    assert found.severity == "warning" and found.value == pytest.approx(-0.02, abs=1e-4)
    assert not [
        f for f in examine(replace(servo, runs=(moved(-4),))).findings if f.check == "clock"
    ]


def resonant(values: Array) -> Array:
    """Reading behind a resonance of 25 Hz, as of a compliant link."""
    w = 2 * np.pi * 25.0
    ringing = signal.bilinear([w**2], [1.0, 0.1 * w, w**2], 1000.0)
    mean = values.mean(axis=0)
    return mean + signal.lfilter(*ringing, values - mean, axis=0)


def test_a_resonance_is_no_offset_of_clocks(servo: Recording) -> None:
    report = examine(with_sensors(servo, "acc", resonant))
    assert not [one.found for one in report.findings if one.check == "clock"]


def test_torques_in_another_unit_than_the_commands_are_told(machines: dict[str, Recording]) -> None:
    wrong = each_run(
        machines["motor"], lambda run: replace(as_torques(run, 50), controls=run.controls)
    )
    found = {one.channel: one for one in examine(wrong).warnings}
    assert found["torque.base"].value == pytest.approx(50, rel=1e-3)


# ---------------------------------------------------------- one run alone


def at_zero(run: Run) -> Run:
    q = run.sensors["q_fore"]
    return replace(run, sensors={**run.sensors, "q_fore": q - q.mean() + 0.02})


IN_ONE_RUN: dict[str, tuple[str, Change, str, set[str]]] = {
    "a joint near zero has the unit of the others": (
        "servo", both(runs(at_zero), sensors("q_", np.degrees)), "units", ENCODERS),
    "sign by the pose": ("servo", sensors("q_upper", np.negative), "sign", {"sensor.q_upper"}),
    "g": ("servo", sensors("acc", lambda v: v / G), "units", {"sensor.acc"}),
    "newton millimetres": (
        "torques",
        runs(lambda r: replace(r, torques={**r.torques, "upper": 1e3 * r.torques["upper"]})),
        "units", {"torque.upper"}),
    "commands in degrees": ("servo", controls(np.degrees), "units", COMMANDS),
}  # fmt: skip


@pytest.mark.parametrize("kind", IN_ONE_RUN)
def test_what_is_wrong_in_one_run_is_found_there(machines: dict[str, Recording], kind: str) -> None:
    base, change, check, channels = IN_ONE_RUN[kind]
    sound = machines[base]
    if "zero" in kind:
        sound = each_run(sound, lambda run: replace(run, pose=None, controls={}))
    report = examine(in_one_run(change)(sound))
    # What one joint's unit makes of another that says nothing itself is no error.
    errors = (*report.errors, *(one for one in report.warnings if one.check == "units"))
    assert {(check, WRONG, name) for name in channels} <= {
        (one.check, one.run, one.channel) for one in errors
    }
    assert [one.channel for one in report.warnings if one.check == "units"] == (
        ["sensor.q_fore"] if "zero" in kind else []
    )
    if kind != "g":  # what the accelerometer's axes say then is of the whole recording
        assert {one.run for one in errors if one.check == check} == {WRONG}


# ---------------------------------------------------------- channels, sampling, entries


def frozen(values: Array) -> Array:
    held = values.copy()
    held[500:700] = held[500]
    return held


def lost(values: Array) -> Array:
    gone = values + 5.0
    gone[300:305] = 0.0
    return gone


def clipped(values: Array) -> Array:
    return np.clip(values, *np.percentile(values, [3, 97], axis=0))


def holed(values: Array) -> Array:
    return np.where(np.arange(len(values))[:, None] % 10 == 3, np.nan, values)


def times(change: Columns) -> Change:
    return runs(lambda run: replace(run, time=change(run.time)))


def jittered(time: Array) -> Array:
    return time + 4e-4 * np.random.default_rng(0).uniform(-1, 1, len(time))


def first_run(**changes: object) -> Change:
    def changed(recording: Recording) -> Recording:
        one, *others = recording.runs
        return replace(recording, runs=(replace(one, **changes), *others))

    return changed


DEFECTS: dict[str, tuple[Change, str, str]] = {
    "frozen": (sensors("acc", frozen), "dropout", "warning"),
    "lost": (sensors("v_base", lost), "dropout", "warning"),
    "clipped": (sensors("acc", clipped), "saturation", "warning"),
    "holed": (sensors("acc", holed), "missing", "warning"),
    "stuck": (sensors("acc", np.zeros_like), "stuck", "error"),
    "out of range": (sensors("acc", lambda v: v * 1e9), "range", "error"),
    "pause": (times(lambda t: t + 0.3 * (t > 1.0)), "pauses", "warning"),
    "milliseconds": (times(lambda t: t * 1000), "rate", "error"),
    "milliseconds at 4 Hz": (times(lambda t: t * 4000), "rate", "error"),
    "nanoseconds": (times(lambda t: t * 1e-9), "rate", "error"),
    "jitter": (times(jittered), "uneven", "note"),
    "no commands in a run": (first_run(controls={}), "commands", "warning"),
}


@pytest.mark.parametrize("kind", DEFECTS)
def test_a_defect_of_channels_times_or_entries_is_found(servo: Recording, kind: str) -> None:
    change, check, severity = DEFECTS[kind]
    findings = examine(change(servo)).findings
    assert (check, severity) in {(one.check, one.severity) for one in findings}
    assert all(one.found and one.consequence and one.remedy for one in findings)
    severities = [one.severity for one in findings]
    assert severities == sorted(severities, key=["error", "warning", "note"].index)


def test_stuck_encoders_and_axes_are_errors_where_their_joint_is_shaken(servo: Recording) -> None:
    wrong = with_sensors(servo, "q_base", lambda v: np.full_like(v, v[0]))
    found = [one for one in examine(wrong).errors if one.check == "stuck"]
    assert [(one.run, one.channel) for one in found] == [("run-0.parquet", "sensor.q_base")]
    found = examine(with_sensors(servo, "acc", lambda v: v * [1, 1, 0])).errors
    dead = [one for one in found if one.check == "stuck"]
    # The first joint turns about the vertical: it moves the tool sideways alone.
    assert {(one.run, one.channel) for one in dead} >= {(WRONG, "sensor.acc.z")}
    assert all("all its axes or none" in one.remedy for one in dead)
    assert all("the encoders imply motion there" in one.found for one in dead)


@pytest.mark.parametrize("joint", JOINTS)
def test_an_encoder_that_reads_nothing_blames_no_other_channel(
    servo: Recording, joint: str
) -> None:
    quiet = each_run(servo, lambda run: replace(run, pose=None, excited=()))
    dead = with_sensors(quiet, f"q_{joint}", lambda v: np.full_like(v, 0.4))
    found = [one for one in examine(dead).findings if one.severity != "note"]
    assert ("stuck", f"sensor.q_{joint}") in {(one.check, one.channel) for one in found}
    assert [one for one in found if one.severity == "error"] == []


def test_exchanged_poses_and_joints_outside_their_limits_are_named(servo: Recording) -> None:
    one, two, three = servo.runs
    wrong = replace(servo, runs=(replace(one, pose=two.pose), replace(two, pose=one.pose), three))
    found = [f for f in examine(wrong).warnings if f.check == "pose"]
    assert {f.run for f in found} == {one.name, two.name}
    assert f"the pose noted for {two.name}" in found[0].found
    wrong = each_run(
        with_sensors(servo, "q_fore", lambda v: v + 2.0),
        lambda run: replace(run, pose={**run.pose, "fore": run.pose["fore"] + 2.0}),
    )
    found = [f for f in examine(wrong).warnings if f.check == "range"]
    assert {f.run for f in found} == {"run-0.parquet", "run-2.parquet"}


def test_commands_that_are_missing_are_told_with_the_consequence(servo: Recording) -> None:
    found = [one for one in examine(SILENT(servo)).findings if one.check == "commands"]
    assert [one.severity for one in found] == ["warning"]
    assert "model has actuators" in found[0].found and "free response" in found[0].consequence
    missing = next(iter(servo.runs[0].controls))

    def partly(run: Run) -> Run:
        kept = {k: v for k, v in run.controls.items() if k != missing}
        return replace(run, controls=kept, excited=(), pose=None)

    found = [one for one in examine(each_run(servo, partly)).findings if one.check == "commands"]
    assert {one.channel for one in found} == {f"ctrl.{missing}"}
    assert all("simulated with a command of 0" in one.consequence for one in found)


def test_the_text_writes_a_defect_of_many_runs_once_and_the_json_lists_all(
    servo: Recording,
) -> None:
    report = examine(with_sensors(servo, "acc", frozen))
    text = report.text()
    assert len(report.warnings) == 9
    assert text.count("consequence:") == 1 and "and 6 more of this kind" in text
    whole = json.loads(report.to_json())
    assert whole["format"] == "loose-doctor/1"
    assert (whole["errors"], whole["warnings"], len(whole["findings"])) == (0, 9, 9)
    one = Finding(
        check="units", severity="error", channel="sensor.q", found="in degrees",
        consequence="wrong", remedy="convert",
    )  # fmt: skip
    report = Report(recording="arm", runs=2, seconds=4.0, findings=(one,) * 5)
    assert "  and 2 more of this kind" in report.lines()  # of the whole recording, of no run
    some = replace(report, findings=(one,) * 4 + (replace(one, run="a.csv"),))
    assert "  and 2 more of this kind, in 1 run" in some.lines()


def test_torques_clear_joints_of_the_unit_of_another(machines: dict[str, Recording]) -> None:
    free = each_run(machines["torques"], lambda run: replace(run, pose=None))
    report = examine(sensors("q_upper", np.degrees)(free))
    assert [one.channel for one in report.findings if one.check == "units"] == ["sensor.q_upper"]
