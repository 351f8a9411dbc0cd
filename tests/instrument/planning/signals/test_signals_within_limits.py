"""Signals within the limits of a controller, by kind of command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.instrument.model.instrumented_arm import read_arm
from loose_env.instrument.model.motion_limits import motion_limits
from loose_env.instrument.planning.next_measurement import NextSettings
from loose_env.instrument.planning.plan import Plan, plan
from loose_env.instrument.planning.signals.transit import transit
from loose_env.instrument.settings.arm_and_plan import PlanSettings
from loose_env.instrument.settings.motion import MotionSettings
from tests.instrument.arms.plan_arms import MOTORS, SERVOED, written
from tests.instrument.arms.playing import play

FEW = NextSettings(poses=4, seconds=1.2)


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def motors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("motors"), MOTORS)


def largest(values: np.ndarray, rate: float, power: int) -> float:
    """Largest derivative of a command as a controller forms it."""
    return float(np.abs(np.diff(values, n=power)).max() * rate**power)


def keeps_all(made: Plan) -> bool:
    return all(peak.within for signal in made.signals for peak in signal.peaks)


@pytest.mark.parametrize(
    "limits",
    [
        {"max_speed_rad_s": (1.0,)},
        {"max_acceleration_rad_s2": (60.0,)},
        {"max_jerk_rad_s3": (2e4,)},
        {"max_speed_rad_s": (0.5, 2.0, 1.0), "max_acceleration_rad_s2": (300.0,)},
    ],
)
def test_the_command_of_a_servo_keeps_within_every_limit(
    servoed: Path, limits: dict[str, tuple[float, ...]]
) -> None:
    motion = MotionSettings(**limits)  # type: ignore[arg-type]
    made = plan(servoed, choice=FEW, motion=motion)
    signal = made.signals[0]
    j = made.arm.joints.index(signal.joint)
    drive = made.arm.drives[j]
    assert drive is not None
    joint = signal.commands[drive.actuator] * drive.gain / drive.stiffness
    for power, quantity in enumerate(("speed", "acceleration", "jerk"), start=1):
        found = largest(joint, signal.rate_hz, power)
        assert found <= made.limits.limit(quantity, j) * (1 + 1e-6)  # type: ignore[arg-type]
    assert keeps_all(made)
    assert signal.limited_by


def test_the_predicted_speed_is_that_of_the_played_signal(servoed: Path) -> None:
    made = plan(servoed, choice=FEW, own=PlanSettings(joint="lift", hold_s=1.0))
    did = play(made, step=5e-5)
    signal = made.signals[0]
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    sensor = made.arm.recording_model.positions[made.arm.joints.index("lift")]
    speed = np.abs(np.diff(did.columns[f"sensor.{sensor}"][on])).max() * signal.rate_hz
    wanted = next(
        p for p in signal.peaks if (p.joint, p.of, p.quantity) == ("lift", "joint", "speed")
    )
    assert speed == pytest.approx(wanted.value, rel=0.1)


def test_a_torque_rate_limit_lowers_the_torque_of_motors(motors: Path) -> None:
    own = PlanSettings(joint="lift")
    free = plan(motors, choice=FEW, own=own).signals[0]
    rate = MotionSettings(max_torque_rate_nm_s=(100.0,))
    slow = plan(motors, choice=FEW, own=own, motion=rate).signals[0]
    torque = slow.commands["m1"] * 50.0
    assert largest(torque, slow.rate_hz, 1) <= 100.0 * (1 + 1e-6)
    assert slow.torque_rms < free.torque_rms
    assert "torque rate" in slow.limited_by


def test_what_cannot_be_detected_within_the_limits_is_said(servoed: Path) -> None:
    slow = MotionSettings(max_acceleration_rad_s2=(0.2,))
    made = plan(servoed, choice=FEW, own=PlanSettings(hold_s=5.0), motion=slow)
    assert any("no fault is detectable in this run" in warning for warning in made.warnings)
    assert any("acceleration of the command" in warning for warning in made.warnings)


def test_the_band_ends_at_the_bandwidth_of_the_commands(servoed: Path) -> None:
    motion = MotionSettings(command_bandwidth_hz=25.0)
    made = plan(servoed, choice=FEW, motion=motion)
    low, high = made.next.band_hz
    assert 2.0 <= low < high <= 25.0
    command = next(iter(made.signals[0].played.values()))
    assert np.isfinite(command).all()
    with pytest.raises(InvalidSetting, match=r"followed up to 3 Hz.*--excitation hammer"):
        plan(servoed, choice=FEW, motion=replace(motion, command_bandwidth_hz=3.0))


def test_commands_have_the_rate_of_the_controller(servoed: Path) -> None:
    made = plan(servoed, choice=FEW, motion=MotionSettings(command_rate_hz=250.0))
    signal = made.signals[0]
    assert signal.rate_hz == pytest.approx(250.0)
    assert made.next.band_hz[1] <= 100.0
    assert made.next.rate_hz == FEW.rate_hz  # that of the recorder


def test_positions_are_the_motion_that_the_torque_would_make(servoed: Path) -> None:
    own = PlanSettings(joint="lift", pose_deg=(0.0, -20.0, 60.0))
    made = plan(servoed, choice=FEW, own=own, motion=MotionSettings(commands="position"))
    signal = made.signals[0]
    assert list(signal.played) == ["position.pan", "position.lift", "position.elbow"]
    lift = signal.played["position.lift"]
    assert lift[0] == lift[-1] == pytest.approx(made.pose[1])
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    omega = 2j * np.pi * np.fft.rfftfreq(int(on.sum()), 1 / signal.rate_hz)
    acceleration = np.fft.irfft(omega**2 * np.fft.rfft(lift[on] - made.pose[1]), int(on.sum()))
    assert np.sqrt(np.mean(acceleration**2)) == pytest.approx(signal.joint_rms, rel=1e-6)
    assert (signal.played["position.pan"] == made.pose[0]).all()


def test_velocities_lead_where_the_positions_are(servoed: Path) -> None:
    own = PlanSettings(joint="lift", pose_deg=(0.0, -20.0, 60.0))
    where, fast = (
        plan(servoed, choice=FEW, own=own, motion=MotionSettings(commands=kind)).signals[0]
        for kind in ("position", "velocity")
    )
    held = np.cumsum(fast.played["velocity.lift"]) / fast.rate_hz
    moved = where.played["position.lift"] - where.played["position.lift"][0]
    assert held[:-1] == pytest.approx(moved[1:], abs=1e-12)


def test_the_way_to_the_pose_keeps_within_a_share_of_the_limits(servoed: Path) -> None:
    arm = read_arm(servoed)
    motion = MotionSettings(
        max_speed_rad_s=(1.0,), max_acceleration_rad_s2=(4.0,), max_jerk_rad_s3=(20.0, 40.0, 40.0)
    )
    limits = motion_limits(arm, motion)
    start, end = np.zeros(3), np.array([1.2, -0.7, 0.4])
    move = transit(arm, start, end, limits, 500.0, share=0.5)
    assert move.positions[0] == pytest.approx(start)
    assert move.positions[-1] == pytest.approx(end)
    assert move.time[-1] == pytest.approx(move.duration_s)
    for power, quantity in enumerate(("speed", "acceleration", "jerk"), start=1):
        found = np.abs(np.diff(move.positions, n=power, axis=0)).max(axis=0) * 500.0**power
        assert (found <= 0.5 * limits.values[quantity] * (1 + 1e-6)).all()  # type: ignore[index]
    shorter = transit(arm, start, end, limits, 500.0, share=1.0)
    assert shorter.duration_s < move.duration_s
    assert transit(arm, end, end, limits, 500.0).duration_s == 0


def test_a_plan_for_an_arm_of_180_degrees_a_second_asks_for_no_more(servoed: Path) -> None:
    """Without limits the position command of a servo is asked for many times that."""
    free = plan(servoed, choice=FEW, motion=MotionSettings(max_speed_rad_s=(1e6,)))
    assert max(p.value for p in free.signals[0].peaks if p.quantity == "speed") > 3.14
    made = plan(servoed, choice=FEW)
    assert max(p.value for p in made.signals[0].peaks if p.quantity == "speed") <= 3.14 + 1e-9
    assert max(one.deviations for one in made.expected.values()) > 4.0  # faults stay detectable
