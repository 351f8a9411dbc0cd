"""The static-force test in space: statics of the jig, and the seats that it names."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, Mismatch, planar, six_axis
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.thesis import (
    DockedMotion,
    JigSettings,
    docked_verdict,
    measure_docked,
    seat_motion,
)
from loose_env.typing import Array

SLIDE = StructuralLooseness(
    link=2, direction=(0.6, 0.0, 0.8), gap=3e-4, stiffness=(3e7, 3e7), damping=(3e3, 3e3)
)
PLAY = Backlash(joint=3, gap=3e-4, stiffness=(5e5, 5e5), damping=(60.0, 60.0))
COMPLIANT = JigSettings(stiffness=1e5, joint_friction=0.02, rate=1000.0)


def docked(fault: Fault, settings: JigSettings, poses: int = 2) -> list[DockedMotion]:
    """Records of a six-axis arm that is not quite the nominal one."""
    arm, rng = six_axis(), np.random.default_rng(3)
    mismatch = Mismatch().draw(arm, rng)
    rms = tuple(0.1 * limit for limit in arm.torque_limits)
    shake = Excitation(torque_rms=rms, duration=0.8, band=(1.0, 8.0))
    found = []
    for _ in range(poses):
        pose = arm.random_pose(rng)
        push = torque_signals(shake, timestep=arm.timestep, before=0, after=0, rng=rng)
        found.append(
            measure_docked(arm, pose, fault, push, rng, settings=settings, mismatch=mismatch)
        )
    return found


def test_a_slide_is_named_through_a_jig_that_yields_more_than_the_gap() -> None:
    records = docked(SLIDE, COMPLIANT, 3)
    assert min(np.abs(r.forces[:3]).max() for r in records) / 1e5 > SLIDE.gap
    found = docked_verdict(records)
    assert found.hypothesis == "structural_looseness@link2"
    assert abs(found.direction @ np.array(SLIDE.direction)) > np.cos(np.radians(2.0))


def test_play_turns_the_tool_about_its_joint() -> None:
    assert docked_verdict(docked(PLAY, COMPLIANT)).hypothesis == "backlash@joint3"


def test_a_healthy_arm_leaves_the_noise_of_the_encoders_by_force_but_not_by_torque() -> None:
    records = docked(Healthy(), COMPLIANT)
    assert docked_verdict(records).hypothesis == "healthy"
    assert all(0.7 < seat_motion(record).over_noise < 1.4 for record in records)
    # Friction in the joints comes between the drives and the jig.
    assert all(seat_motion(record, by_force=False).over_noise > 10 for record in records)


def pushed(arm: Arm, torque: Array) -> tuple[Array, Array]:
    """The jig's force as torques of the joints and the joints' motion, at the end of a push."""
    push = np.repeat(np.reshape(torque, (-1, 1)), round(0.3 / arm.timestep), axis=1)
    settings = JigSettings(force_noise=0.0, encoder_noise=0.0, damping_ratio=1.0)
    rng, pose = np.random.default_rng(0), [0.3, 0.9, -0.7]
    record = measure_docked(arm, pose, Healthy(), push, rng, settings=settings)
    return record.jacobian.T @ record.forces[:, -1], record.angles[:, -1]


def test_the_jig_carries_the_push_and_not_the_weight() -> None:
    arm, torque = planar(3, vertical=True), np.array([3.0, -2.0, 1.0])
    carried, angles = pushed(arm, torque)
    # The springs that hold the joints carry what the jig yields.
    np.testing.assert_allclose(carried - arm.centring.stiffness * angles, -torque, atol=0.01)
    assert np.abs(pushed(arm, np.zeros(3))[0]).max() < 0.01


@pytest.mark.parametrize(
    ("settings", "torque", "words"),
    [
        (JigSettings(stiffness=1e9), np.zeros((3, 10)), "too stiff for a step"),
        (JigSettings(), np.zeros((2, 10)), "a row for each of 3 joints"),
    ],
)
def test_what_cannot_be_docked_is_refused(settings: JigSettings, torque: Array, words: str) -> None:
    with pytest.raises(InvalidSetting, match=words):
        measure_docked(
            planar(3),
            [0.1, 0.9, 0.2],
            Healthy(),
            torque,
            np.random.default_rng(0),
            settings=settings,
        )
