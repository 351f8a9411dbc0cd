"""Units, signs, axes and clocks that contradict the model or another channel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from loose_env.doctor import DoctorSettings, Finding, examine
from loose_env.doctor.model_checks.clocks import delay_between
from loose_env.errors import InvalidSetting
from loose_env.recording import Recording
from loose_env.typing import Array
from tests.doctor.machine import JOINTS, each_run, late, with_controls, with_sensors


def errors(recording: Recording) -> dict[tuple[str, str], Finding]:
    return {(one.check, one.channel): one for one in examine(recording).errors}


def without_poses(recording: Recording) -> Recording:
    return each_run(recording, lambda run: replace(run, pose=None))


def as_torques(recording: Recording, factor: float) -> Recording:
    return each_run(
        recording,
        lambda run: replace(
            run, controls={}, torques={j: factor * run.controls[f"m_{j}"] for j in JOINTS}
        ),
    )


def test_a_clean_recording_has_no_finding(servo: Recording, motor: Recording) -> None:
    assert not examine(servo).findings
    assert not examine(motor).findings
    assert not examine(as_torques(motor, 1.0)).findings


def test_degrees_are_named_on_every_encoder(servo: Recording) -> None:
    found = errors(with_sensors(servo, "q_", np.degrees))
    assert set(found) == {("units", f"sensor.q_{j}") for j in JOINTS}
    assert "degrees" in found["units", "sensor.q_base"].found


def test_degrees_are_known_by_the_limits_alone(motor: Recording) -> None:
    found = errors(without_poses(with_sensors(motor, "q_", np.degrees)))
    assert {("units", f"sensor.q_{j}") for j in JOINTS} <= set(found)


def test_a_pose_noted_in_degrees_is_told_from_degrees_measured(servo: Recording) -> None:
    wrong = each_run(
        servo, lambda run: replace(run, pose={j: np.degrees(q) for j, q in run.pose.items()})
    )
    assert {name for _, name in errors(wrong)} == {f"pose of {j}" for j in JOINTS}


def test_an_encoder_against_its_pose_is_an_error_of_sign(servo: Recording) -> None:
    found = errors(with_sensors(servo, "q_upper", np.negative))
    assert ("sign", "sensor.q_upper") in found


def test_gravity_shows_a_reversed_encoder(motor: Recording) -> None:
    wrong = with_sensors(with_sensors(motor, "q_upper", np.negative), "v_upper", np.negative)
    found = errors(without_poses(wrong))["axes", "sensor.acc"]
    assert "opposite sign of joint upper's encoder" in found.found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v * [-1, 1, 1], "x = -x"),
        (lambda v: v[:, [0, 2, 1]], "y = z of the recording, z = y of the recording"),
    ],
)
def test_gravity_shows_wrong_axes_of_an_accelerometer(
    motor: Recording, change: Callable[[Array], Array], words: str
) -> None:
    found = errors(with_sensors(motor, "acc", change))["axes", "sensor.acc"]
    assert words in found.found
    assert found.unit == "deg"


def test_an_accelerometer_in_g_is_named(servo: Recording) -> None:
    found = errors(with_sensors(servo, "acc", lambda v: v / 9.80665))
    assert "g instead of m/s²" in found["units", "sensor.acc"].found


def test_a_piezoelectric_accelerometer_is_only_noted(motor: Recording) -> None:
    report = examine(with_sensors(motor, "acc", lambda v: v - v.mean(axis=0)))
    assert [(one.check, one.severity) for one in report.findings] == [("gravity", "note")]


def test_a_piezoelectric_accelerometer_in_g_is_known_by_the_motion(motor: Recording) -> None:
    found = errors(with_sensors(motor, "acc", lambda v: (v - v.mean(axis=0)) / 9.80665))
    assert any(check == "units" and name.startswith("sensor.acc") for check, name in found)


def test_gyroscopes_are_compared_with_the_joints(servo: Recording) -> None:
    degrees = errors(with_sensors(servo, "gyro", np.degrees))
    assert any(check == "units" and "gyro" in name for check, name in degrees)
    reversed_ = errors(with_sensors(servo, "gyro", np.negative))
    assert any(check == "sign" and "gyro" in name for check, name in reversed_)


@pytest.mark.parametrize("seconds", [0.005, -0.003, 0.0021])
def test_a_late_accelerometer_is_measured_with_its_uncertainty(
    servo: Recording, seconds: float
) -> None:
    report = examine(with_sensors(servo, "acc", lambda v: late(v, seconds)))
    (found,) = report.findings
    assert (found.check, found.severity, found.unit) == ("clock", "warning", "s")
    assert found.value == pytest.approx(seconds, abs=1e-4)
    word = "late" if seconds > 0 else "early"
    assert f"clock is {1e3 * abs(seconds):.1f} ms {word} (standard deviation" in found.found


def test_the_limit_of_a_clock_offset_can_be_set(servo: Recording) -> None:
    wrong = with_sensors(servo, "acc", lambda v: late(v, 0.003))
    assert examine(wrong, DoctorSettings(clock_s=0.01)).findings[0].severity == "note"
    with pytest.raises(InvalidSetting, match="clock_s"):
        DoctorSettings(clock_s=0.0)


def test_late_commands_are_told_from_late_readings(motor: Recording) -> None:
    wrong = with_controls(motor, lambda v: late(v - v.mean(), 0.004) + v.mean())
    (found,) = examine(wrong).findings
    assert "torques and commands are 4.0 ms late" in found.found


def test_a_delay_that_two_signals_do_not_share_is_none() -> None:
    rng = np.random.default_rng(1)
    assert delay_between(rng.normal(size=4000), rng.normal(size=4000), 1e-3) is None
    time = np.arange(4000) / 1000
    assert delay_between(np.sin(200 * time), np.sin(200 * time - 1), 1e-3) is None


@pytest.mark.parametrize(
    ("factor", "check"), [(-1.0, "sign"), (1000.0, "units")], ids=["sign", "millimetres"]
)
def test_torques_are_compared_with_gravity_and_inertia(
    motor: Recording, factor: float, check: str
) -> None:
    assert any(c == check and "fore" in name for c, name in errors(as_torques(motor, factor)))
    commands = errors(with_controls(motor, lambda v: factor * v))
    assert any(c == check and "fore" in name for c, name in commands)


def test_torques_in_another_unit_than_the_commands_are_told(motor: Recording) -> None:
    wrong = each_run(
        motor, lambda run: replace(run, torques={j: 50 * run.controls[f"m_{j}"] for j in JOINTS})
    )
    found = {one.channel: one for one in examine(wrong).warnings}
    assert found["torque.base"].value == pytest.approx(50, rel=1e-3)


@pytest.mark.parametrize(("change", "check"), [(np.degrees, "units"), (np.negative, "sign")])
def test_position_commands_are_compared_with_positions(
    servo: Recording, change: Callable[[Array], Array], check: str
) -> None:
    found = errors(with_controls(servo, change))
    assert {(check, f"ctrl.m_{j}") for j in JOINTS} <= set(found)
