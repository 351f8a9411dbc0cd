"""The cylindrical arm: its kinematics, its weight, its column's mode."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm
from loose_env.rig import PlantShop
from loose_env.thesis.rigs.cylindrical import (
    COLUMN_MODE_HZ,
    LIFT,
    REACH,
    SIDE_STIFFNESS,
    cylindrical,
)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return cylindrical()


def test_it_moves_in_cylindrical_coordinates(arm: Arm) -> None:
    swing, lift, reach = 0.4, 0.3, 0.7
    at = LinearArm(arm).at([swing, lift, reach, 0.0, 0.0, 0.0])
    radius = 0.15 + 0.55 + 0.12 + 0.10 + 0.14 + reach
    # Swing, lift and reach in the tool frame: sideways by the radius, up, and out.
    np.testing.assert_allclose(
        at.kinematic[:, :3], [[0, 0, 1], [radius, 0, 0], [0, 1, 0]], atol=1e-12
    )


def test_lift_carries_the_weight_in_newtons(arm: Arm) -> None:
    at = LinearArm(arm).at([0.0, 0.2, 0.5, 0.0, 0.0, 0.0])
    carried = arm.model.body("flange2").subtreemass[0]
    assert at.gravity_torque[1] == pytest.approx(9.81 * carried)
    assert at.gravity_torque[1] < arm.torque_limits[1]
    np.testing.assert_allclose(at.gravity_torque[[0, 2]], 0.0, atol=1e-9)


def test_the_column_rings_as_the_thesis_saw_with_the_arm_raised_and_extended(arm: Arm) -> None:
    model, data = arm.model, mujoco.MjData(arm.model)
    data.joint("joint2").qpos[0], data.joint("joint3").qpos[0] = LIFT, REACH
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    modes = []
    for name in ("lean_fore", "lean_side"):
        joint = model.joint(name)
        inertia = full[joint.dofadr[0], joint.dofadr[0]]
        modes.append(np.sqrt(joint.stiffness[0] / inertia) / (2 * np.pi))
    assert modes[0] == pytest.approx(COLUMN_MODE_HZ)
    assert modes[1] > np.sqrt(SIDE_STIFFNESS) * modes[0]


def test_every_link_takes_a_seat(arm: Arm) -> None:
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    sizes = {shop.template(link, "slide").nv for link in range(1, arm.n + 1)}
    assert sizes == {arm.model.nv + 1}


def test_poses_stay_in_their_ranges(arm: Arm) -> None:
    rng = np.random.default_rng(0)
    poses = np.array([arm.random_pose(rng) for _ in range(50)])
    assert all(arm.within_ranges(pose).all() for pose in poses)
    assert poses[:, 2].max() <= REACH
    assert poses[:, 1].min() >= 0.0


def test_servo_holding_has_its_own_name() -> None:
    soft = cylindrical(hold="servo")
    assert soft.name == "cylindrical-servo"
    assert max(soft.holding.stiffness) < max(soft.brake.stiffness)
