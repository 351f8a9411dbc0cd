"""Motions keep to the limits of the arm, and what does not fit is refused with its reason."""

import dataclasses
from pathlib import Path
from typing import get_args

import mujoco
import numpy as np
import pytest

from loose_env.arms import SERVO_ARM
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import Motion, ServoArm, check_motion, read_servo_arm, scaled_to_fit
from loose_env.gap.experiment_design.candidates import rays_of
from loose_env.gap.experiment_design.motions import MotionKind


@pytest.fixture(scope="module")
def arm() -> ServoArm:
    return read_servo_arm(SERVO_ARM)


@pytest.mark.parametrize("kind", get_args(MotionKind))
def test_a_motion_starts_and_ends_at_rest_at_home_within_amplitude_and_speed(
    kind: MotionKind, arm: ServoArm
) -> None:
    motion = Motion(kind=kind, joints=(0, 2), amplitude=0.2, speed=9.0, seconds=3.0)

    commands = motion.commands(arm)

    off = commands - arm.home
    assert np.all(off[0] == 0) and np.all(off[-1] == 0)
    assert np.all(off[:, 1] == 0)  # a joint that is not excited stays
    assert 0.01 < np.abs(off).max() <= 0.2 + 1e-9
    assert np.abs(np.diff(commands, axis=0)).max() * arm.sensing.rate <= arm.max_speed + 1e-9
    assert np.abs(np.diff(off[:70], axis=0)).max() < 1e-9


def test_a_motion_about_another_pose_goes_there_and_back(arm: ServoArm) -> None:
    centre = (0.5, -1.0, 0.8)
    motion = Motion(kind="steps", joints=(1,), amplitude=0.05, speed=1.0, centre=centre)

    commands = motion.commands(arm)

    assert np.allclose(commands[len(commands) // 2], centre, atol=0.11)
    assert np.allclose(commands[[0, -1]], arm.home)


def test_a_motion_that_leaves_a_range_is_refused_and_then_reduced(arm: ServoArm) -> None:
    centre = (0.0, -0.7, 2.2)
    motion = Motion(kind="holds", joints=(2,), amplitude=0.5, speed=1.5, centre=centre)

    with pytest.raises(InvalidSetting, match=r"takes joint3 to .* its range is"):
        motion.commands(arm)
    fitting, checked = scaled_to_fit(motion, arm)

    assert fitting.amplitude < motion.amplitude
    assert not checked.refusal


def test_a_motion_into_the_table_is_refused(arm: ServoArm) -> None:
    low = Motion(kind="holds", joints=(1,), amplitude=0.1, speed=1.0, centre=(0.0, 0.5, 0.4))

    assert "touch" in check_motion(low, arm).refusal
    with pytest.raises(InvalidSetting, match=r"does not fit the arm: .* would touch"):
        scaled_to_fit(low, arm)


def test_a_weak_drive_gets_a_smaller_motion() -> None:
    spec = mujoco.MjSpec.from_file(str(SERVO_ARM))
    for motor in spec.actuators:
        motor.forcerange = [-45.0, 45.0]
    arm = ServoArm(spec)
    motion = Motion(kind="chirp", joints=(1,), amplitude=0.4, speed=1.8)

    fitting, checked = scaled_to_fit(motion, arm)

    assert "torque limit" in check_motion(motion, arm).refusal
    assert fitting.speed < motion.speed and checked.torque_share <= 0.8


def test_bad_motions_and_arms_are_told_what_is_allowed(tmp_path: Path, arm: ServoArm) -> None:
    good = Motion(kind="chirp", joints=(0,), amplitude=0.1, speed=1.0)
    with pytest.raises(UnknownName, match="kind is one of"):
        Motion(kind="waltz", joints=(0,), amplitude=0.1, speed=1.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match=r"highest is above 0\.5 Hz"):
        Motion(kind="chirp", joints=(0,), amplitude=0.1, speed=1.0, highest=0.5)
    with pytest.raises(InvalidSetting, match="amplitude is above 0 rad"):
        dataclasses.replace(good, amplitude=0.0)
    with pytest.raises(InvalidSetting, match="the arm drives 3 joints"):
        dataclasses.replace(good, joints=(5,)).commands(arm)
    passive = tmp_path / "passive.xml"
    passive.write_text(
        "<mujoco><worldbody><body><joint name='a'/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InvalidData, match="no position servo"):
        read_servo_arm(passive)


def test_steps_are_stable_for_a_rotor_that_a_compliance_sets_free() -> None:
    """Damping of 2000/s of the rotor inertia, as in files made for simulation alone."""
    spec = mujoco.MjSpec.from_file(str(SERVO_ARM))
    for joint in spec.joints:
        joint.armature = 0.1
        joint.damping = [200.0, 0.0, 0.0]
    arm = ServoArm(spec)
    assert arm.machine.model.opt.timestep == pytest.approx(5e-4)
    motion = Motion(kind="slow_triangle", joints=(0, 1, 2), amplitude=0.2, speed=0.8)
    soft = next(ray for ray in rays_of(arm, ["joint_compliance"]))

    readings = [
        arm.simulate([soft.hypothesis(soft.values(soft.smallest * size))], motion.commands(arm))[0]
        for size in (1.0, 1.1)
    ]

    change = np.abs(readings[1] - readings[0]) / arm.noise
    assert 0.0 < change.max() < 100.0  # an unstable rotor throws the readings off by thousands
