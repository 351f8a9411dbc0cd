"""Sampling, channels and entries of single runs, and the report of all findings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from loose_env.doctor import Finding, Report, examine
from loose_env.recording import Recording, Run
from loose_env.typing import Array
from tests.doctor.machine import each_run, with_sensors


def seen(recording: Recording) -> set[tuple[str, str]]:
    return {(one.check, one.severity) for one in examine(recording).findings}


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


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (frozen, ("dropout", "warning")),
        (clipped, ("saturation", "warning")),
        (holed, ("missing", "warning")),
        (np.zeros_like, ("stuck", "error")),
        (lambda v: np.repeat(v[::4], 4, axis=0), ("held", "note")),
        (lambda v: v * 1e9, ("range", "error")),
    ],
)
def test_a_defect_of_a_channel_is_found(
    servo: Recording, change: Callable[[Array], Array], expected: tuple[str, str]
) -> None:
    assert expected in seen(with_sensors(servo, "acc", change))


def test_lost_readings_are_told_from_readings_of_zero(servo: Recording) -> None:
    assert ("dropout", "warning") in seen(with_sensors(servo, "v_base", lost))
    assert ("dropout", "warning") not in seen(servo)


def test_a_stuck_encoder_of_the_excited_joint_is_an_error(servo: Recording) -> None:
    wrong = with_sensors(servo, "q_base", lambda v: np.full_like(v, v[0]))
    found = [one for one in examine(wrong).errors if one.check == "stuck"]
    assert [(one.run, one.channel) for one in found] == [("run-0.parquet", "sensor.q_base")]


def test_a_dead_axis_of_an_accelerometer_is_an_error_where_its_joint_is_shaken(
    servo: Recording,
) -> None:
    found = examine(with_sensors(servo, "acc", lambda v: v * [1, 1, 0]))
    dead = [one for one in found.errors if one.check == "stuck"]
    # The first joint turns about the vertical: it moves the tool sideways alone.
    assert {(one.run, one.channel) for one in dead} >= {("run-1.parquet", "sensor.acc.z")}
    assert all("all its axes or none" in one.remedy for one in dead)
    assert all("other axes of the sensor move" in one.found for one in dead)


def test_an_encoder_too_coarse_for_the_motion_is_told(servo: Recording) -> None:
    wrong = with_sensors(servo, "q_", lambda v: np.round(v / 0.03) * 0.03)
    assert ("quantisation", "warning") in seen(wrong)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda t: t + 0.3 * (t > 1.0), ("pauses", "warning")),
        (lambda t: t * 1000, ("rate", "error")),
        (lambda t: t * 4000, ("rate", "error")),
        (lambda t: t * 1e-9, ("rate", "error")),
        (lambda t: t * 8, ("rate", "warning")),
    ],
    ids=["pause", "milliseconds", "milliseconds at 4 Hz", "nanoseconds", "slow"],
)
def test_a_defect_of_the_time_is_found(
    servo: Recording, change: Callable[[Array], Array], expected: tuple[str, str]
) -> None:
    if expected == ("rate", "warning"):  # the noise of 60 Hz, sampled at 125 Hz
        slow = each_run(servo, lambda run: _thinned(run, 8))
        assert expected in seen(slow)
        return
    assert expected in seen(each_run(servo, lambda run: replace(run, time=change(run.time))))


def _thinned(run: Run, every: int) -> Run:
    return replace(
        run,
        time=run.time[::every],
        controls={n: v[::every] for n, v in run.controls.items()},
        sensors={n: v[::every] for n, v in run.sensors.items()},
    )


def test_jitter_of_the_stamps_is_told(servo: Recording) -> None:
    rng = np.random.default_rng(0)

    def jittered(run: Run) -> Run:
        return replace(run, time=run.time + 4e-4 * rng.uniform(-1, 1, run.samples))

    assert ("uneven", "note") in seen(each_run(servo, jittered))


def test_exchanged_poses_are_named(servo: Recording) -> None:
    one, two, three = servo.runs
    wrong = replace(servo, runs=(replace(one, pose=two.pose), replace(two, pose=one.pose), three))
    found = [f for f in examine(wrong).warnings if f.check == "pose"]
    assert {f.run for f in found} == {one.name, two.name}
    assert f"the pose noted for {two.name}" in found[0].found


def test_missing_and_silent_commands_are_told(servo: Recording) -> None:
    one, *others = servo.runs
    gone = replace(servo, runs=(replace(one, controls={}), *others))
    assert ("commands", "warning") in seen(gone)
    silent = replace(servo, runs=(replace(one, excited=("fore",)), *others))
    assert ("commands", "warning") in seen(silent)


def test_a_joint_outside_its_limits_is_told(servo: Recording) -> None:
    wrong = each_run(
        with_sensors(servo, "q_fore", lambda v: v + 2.0),
        lambda run: replace(run, pose={**run.pose, "fore": run.pose["fore"] + 2.0}),
    )
    found = [f for f in examine(wrong).warnings if f.check == "range"]
    assert {f.run for f in found} == {"run-0.parquet", "run-2.parquet"}


def test_every_finding_has_a_consequence_and_a_remedy(servo: Recording) -> None:
    wrong = with_sensors(with_sensors(servo, "q_", np.degrees), "acc", frozen)
    report = examine(wrong)
    assert report.errors and report.warnings
    assert all(one.found and one.consequence and one.remedy for one in report.findings)
    severities = [one.severity for one in report.findings]
    assert severities == sorted(severities, key=["error", "warning", "note"].index)


def test_the_text_writes_a_defect_of_many_runs_once(servo: Recording) -> None:
    report = examine(with_sensors(servo, "acc", frozen))
    text = report.text()
    assert len(report.warnings) == 9
    assert text.count("consequence:") == 1
    assert "and 6 more of this kind" in text


def test_the_json_lists_every_finding(servo: Recording) -> None:
    report = examine(with_sensors(servo, "acc", frozen))
    whole = json.loads(report.to_json())
    assert whole["format"] == "loose-doctor/1"
    assert (whole["errors"], whole["warnings"], len(whole["findings"])) == (0, 9, 9)


def test_findings_of_the_whole_recording_are_counted_in_no_run() -> None:
    whole = Finding(
        check="units",
        severity="error",
        channel="sensor.q",
        found="in degrees",
        consequence="wrong",
        remedy="convert",
    )
    report = Report(recording="arm", runs=2, seconds=4.0, findings=(whole,) * 5)
    assert "  and 2 more of this kind" in report.lines()
    some = replace(report, findings=(whole,) * 4 + (replace(whole, run="a.csv"),))
    assert "  and 2 more of this kind, in 1 run" in some.lines()


def test_a_model_with_actuators_and_no_commands_is_told(servo: Recording) -> None:
    def silent(run: Run) -> Run:
        return replace(run, controls={}, excited=(), pose=None)

    found = [one for one in examine(each_run(servo, silent)).findings if one.check == "commands"]
    assert [one.severity for one in found] == ["warning"]
    assert "model has actuators" in found[0].found and "free response" in found[0].consequence


def test_a_command_that_is_missing_beside_others_is_told(servo: Recording) -> None:
    missing = next(iter(servo.runs[0].controls))

    def partly(run: Run) -> Run:
        kept = {k: v for k, v in run.controls.items() if k != missing}
        return replace(run, controls=kept, excited=(), pose=None)

    assert not any(one.check == "commands" for one in examine(servo).findings)
    found = [one for one in examine(each_run(servo, partly)).findings if one.check == "commands"]
    assert {one.channel for one in found} == {f"ctrl.{missing}"}
    assert all("simulated with a command of 0" in one.consequence for one in found)
