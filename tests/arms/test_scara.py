"""The SCARA: its kinematics, the weight on its quill, its inertia."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, scara
from loose_env.arms.library import INNER, OUTER, STROKE
from loose_env.arms.linear import LinearArm
from loose_env.typing import Array

BRACKET = 0.08
POSE = np.array([0.5, 0.9, -0.08, -0.4])


@pytest.fixture(scope="module")
def arm() -> Arm:
    return scara()


@pytest.fixture(scope="module")
def linear(arm: Arm) -> LinearArm:
    return LinearArm(arm)


def inertia_at(linear: LinearArm, pose: Array) -> Array:
    return linear.at(pose).inertia[np.ix_(linear.joint_dofs, linear.joint_dofs)]


def test_the_tool_moves_as_two_arms_a_lift_and_a_wrist(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(0)
    for pose in (np.zeros(4), POSE, *(arm.random_pose(rng) for _ in range(20))):
        # In the tool's frame, which lies along the wrist's bracket.
        to_wrist = np.cumsum(pose[[0, 1]])[::-1] - (pose[0] + pose[1] + pose[3])
        arms = np.array([OUTER, INNER]) * np.exp(1j * to_wrist)
        lever = 1j * np.array([BRACKET + arms.sum(), BRACKET + arms[0], 0.0, BRACKET])
        expected = np.array([lever.real, lever.imag, [0, 0, 1, 0]])
        np.testing.assert_allclose(linear.at(pose).kinematic, expected, atol=1e-12)


def test_the_wrist_s_axis_reaches_600_mm(arm: Arm) -> None:
    at = LinearArm(arm).at(np.zeros(4))
    assert at.kinematic[1, 0] - BRACKET == pytest.approx(0.600)
    assert arm.joint_ranges[2] == (-STROKE, 0.0)


def test_only_the_quill_carries_weight(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(1)
    carried = arm.model.body("flange3").subtreemass[0]
    assert carried == pytest.approx(0.1 + 1.8 + 0.05 + 0.6)
    for _ in range(20):
        torque = linear.at(arm.random_pose(rng)).gravity_torque
        np.testing.assert_allclose(torque, [0, 0, 9.81 * carried, 0], atol=1e-9)
    assert 9.81 * carried < 0.2 * arm.torque_limits[2]


def test_inertia_is_that_of_two_arms_in_the_plane_and_a_quill(linear: LinearArm) -> None:
    hanging = 0.1 + 1.8 + 0.05 + 0.6  # at the end of the outer arm, on its own axis [kg]
    turning = 0.0002 + 0.0004 + (0.1 + 0.05) * 0.0008
    about = 0.100 + 0.4 * 0.0008 + 10.0 * 0.09**2 + hanging * OUTER**2 + turning
    first = 10.0 * 0.09 + hanging * OUTER
    inner = 0.120 + 0.5 * 0.0008 + 8.0 * 0.15**2 + (0.4 + 10.0 + hanging) * INNER**2
    wrist = 0.0004 + 0.05 * 0.0008
    for elbow in (0.0, 0.9, -2.0):
        coupling = INNER * first * np.cos(elbow)
        expected = np.array(
            [
                [1.5 + inner + about + 2 * coupling, about + coupling, 0, wrist],
                [about + coupling, 0.30 + about, 0, wrist],
                [0, 0, 8.0 + hanging, 0],
                [wrist, wrist, 0, 0.02 + wrist],
            ]
        )
        found = inertia_at(linear, np.array([0.2, elbow, -0.1, 0.7]))
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_inertia_is_positive_definite_wherever_the_arm_is(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        # Never less than the smallest drive's inertia.
        assert np.linalg.eigvalsh(inertia_at(linear, arm.random_pose(rng)))[0] > 0.02


def test_servo_holding_has_its_own_name() -> None:
    soft = scara(hold="servo")
    assert soft.name == "scara-servo"
    assert all(s < b for s, b in zip(soft.holding.stiffness, soft.brake.stiffness, strict=True))
