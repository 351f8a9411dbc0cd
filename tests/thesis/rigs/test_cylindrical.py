"""The cylindrical arm: its kinematics, its weight, its column's mode."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm
from loose_env.rig import PlantShop
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.cylindrical import (
    LIFT,
    REACH,
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


def rings_at(arm: Arm, lift: float, reach: float) -> float:
    """Frequency of the column after a push fore and aft, joints locked, under gravity [Hz]."""
    model = arm.spec.copy().compile()
    data = mujoco.MjData(model)
    for name in arm.joints:  # a lock: so much armature that the joint stays where it is
        model.dof_armature[model.joint(name).dofadr[0]] = 1e9
    data.joint("joint2").qpos[0], data.joint("joint3").qpos[0] = lift, reach
    data.joint("lean_fore").qvel[0] = 1e-3
    model.opt.timestep = 5e-4
    lean = np.empty(4000)
    for k in range(len(lean)):
        mujoco.mj_step(model, data)
        lean[k] = data.joint("lean_fore").qvel[0]
    # Velocities: gravity moves the middle of the angle, but not theirs.
    crossings = np.flatnonzero((lean[:-1] < 0) & (lean[1:] >= 0))
    return float((len(crossings) - 1) / ((crossings[-1] - crossings[0]) * model.opt.timestep))


def test_the_column_rings_freely_as_the_thesis_saw_with_the_arm_raised_and_extended(
    arm: Arm,
) -> None:
    # The stiffness was set from the inertia alone; damping, gravity, which topples, and the locked
    # joints' share are what the simulation adds.
    told = printed("experiment_one")["mode_raised_extended_hz"]
    assert rings_at(arm, LIFT, REACH) == pytest.approx(told, rel=0.02)


def test_the_column_rings_faster_lowered_and_drawn_in(arm: Arm) -> None:
    found = [rings_at(arm, lift, reach) for lift, reach in ((LIFT, REACH), (LIFT, 0), (0, 0))]
    data = mujoco.MjData(arm.model)
    wanted = []
    for lift, reach in ((LIFT, REACH), (LIFT, 0.0), (0.0, 0.0)):
        data.joint("joint2").qpos[0], data.joint("joint3").qpos[0] = lift, reach
        mujoco.mj_kinematics(arm.model, data)
        # Steiner's rule about the foot; the bodies' own inertia about y from their boxes.
        place, mass = data.xipos, arm.model.body_mass
        own = np.einsum("bi,bi->b", data.ximat.reshape(-1, 3, 3)[:, 1] ** 2, arm.model.body_inertia)
        wanted.append(float(np.sum(mass * (place[:, 0] ** 2 + place[:, 2] ** 2) + own)))
    for f, inertia in zip(found[1:], wanted[1:], strict=True):
        assert f / found[0] == pytest.approx(np.sqrt(wanted[0] / inertia), rel=0.02)
    assert found[0] < found[1] < found[2]


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
