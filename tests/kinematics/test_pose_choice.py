"""Choice of poses: pushes against MuJoCo, bounds, and sets that beat random ones."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, planar, vera
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.kinematics import (
    chebyshev_nodes,
    chebyshev_poses,
    choose_poses,
    reactions,
    worst_push,
    wrench_rank,
)
from scripts.thesis.rigs import cylindrical


def by_inverse_dynamics(
    arm: Arm, pose: np.ndarray, acceleration: np.ndarray, body: int
) -> np.ndarray:
    """Force and moment on a body at its frame's origin, in its axes, without gravity."""
    model = arm.spec.copy().compile()
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qpos[arm.pose_addresses] = pose
    for name, value in zip(arm.joints, acceleration, strict=True):
        data.joint(name).qacc[0] = value
    mujoco.mj_inverse(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    force = data.cfrc_int[body, 3:]
    away = data.xpos[body] - data.subtree_com[model.body_rootid[body]]
    moment = data.cfrc_int[body, :3] - np.cross(away, force)
    frame = data.xmat[body].reshape(3, 3)
    return np.concatenate([force @ frame, moment @ frame])


@pytest.mark.parametrize("arm", [vera(), planar(4), cylindrical()], ids=lambda a: a.name)
def test_reactions_are_those_of_inverse_dynamics(arm: Arm) -> None:
    pose = arm.random_pose(np.random.default_rng(0))
    found = reactions(arm, pose)
    for link, joint in ((1, arm.n), (arm.n, 1), (arm.n, arm.n)):
        body = arm.model.body(arm.seat_bodies[link - 1]).id
        expected = by_inverse_dynamics(arm, pose, found.accelerations[:, joint - 1], body)
        size = np.abs(expected).max()
        wrench = found.per_torque[link - 1, :, joint - 1]
        np.testing.assert_allclose(wrench, expected, atol=1e-9 * size)


def test_energy_bounds_the_push_by_the_mass_carried() -> None:
    """A momentum p of mass m needs an energy of at least p² / 2m."""
    arm = planar(4)
    rng = np.random.default_rng(1)
    for _ in range(20):
        push = reactions(arm, arm.random_pose(rng)).per_energy
        mass = [arm.model.body_subtreemass[arm.model.body(b).id] for b in arm.seat_bodies]
        assert (np.linalg.norm(push[:, :3], axis=1) <= np.sqrt(mass)[:, None] + 1e-9).all()


def test_units_of_drive_do_not_change_the_energy_push() -> None:
    """Twice the mass everywhere: push per energy grows by √2, push per torque stays."""
    light = planar(3)
    spec = light.spec.copy()
    for body in spec.bodies[1:]:
        body.mass, body.inertia = 2 * body.mass, 2 * np.array(body.inertia)
    for joint in spec.joints:
        joint.armature = 2 * joint.armature
    from dataclasses import replace

    heavy = replace(light, spec=spec)
    pose = [0.1, 0.7, -1.2]
    a, b = reactions(light, pose), reactions(heavy, pose)
    np.testing.assert_allclose(b.per_energy, np.sqrt(2) * a.per_energy, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(b.per_torque, a.per_torque, rtol=1e-9, atol=1e-12)


def test_a_straight_arm_pushes_nowhere_along_itself() -> None:
    found = reactions(planar(4), [0.4, 0.0, 0.0, 0.0]).per_torque
    for link in range(4):
        for joint in range(4):
            assert found[link, 0, joint] == pytest.approx(0, abs=1e-12)  # along the link
        assert wrench_rank(found[link, :2])[0] == 1
    assert wrench_rank(reactions(planar(4), [0.4, 0.9, 0, 0]).per_torque[3, :2])[0] == 2
    assert worst_push(planar(4), [0.4, 0.0, 0.0, 0.0]) == pytest.approx(0, abs=1e-9)


def test_chebyshev_points_are_the_zeros() -> None:
    nodes = chebyshev_nodes(-2.0, 4.0, 7)
    scaled = (nodes - 1) / 3
    np.testing.assert_allclose(np.cos(7 * np.arccos(scaled)), 0, atol=1e-12)
    assert (np.diff(nodes) > 0).all()
    poses = chebyshev_poses(vera(), 5)
    assert poses.shape == (25, 2) and np.abs(poses).max() < np.pi
    with pytest.raises(InvalidSetting, match="at most 14"):
        chebyshev_poses(planar(4), 40)


def test_the_set_differs_in_every_joint() -> None:
    poses = np.radians([[0, 0], [90, 0], [90, 90], [180, 180], [5, 90]])
    # The first has the best score; only 90,90 and 180,180 and 5,90 move both joints.
    chosen = choose_poses(poses, [5, 4, 3, 2, 1], 3, keep=1.0)
    assert chosen.tolist() == [0, 3, 2]
    assert choose_poses(poses, [5, 4, 3, 2, 1], 2, keep=0.4).tolist() == [0, 1]
    # A move past half a turn is a smaller one the other way.
    assert choose_poses(np.radians([[0], [350], [100]]), [3, 2, 1], 2, keep=1.0).tolist() == [0, 2]


def test_bad_input_is_refused() -> None:
    with pytest.raises(InvalidSetting, match="2 finite numbers"):
        reactions(vera(), [0.0, np.nan])
    with pytest.raises(InvalidData, match="finite"):
        choose_poses([[0.0], [1.0]], [1.0, np.nan], 1)
    with pytest.raises(InvalidSetting, match="choose 1 to 1"):
        choose_poses([[0.0], [1.0]], [1.0, 2.0], 2, keep=0.5)
