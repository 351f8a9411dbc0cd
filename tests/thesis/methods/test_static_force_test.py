"""The docked test against statics, dynamics and a simulated arm."""

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.looseness.looseness_joint import insert_looseness, seated_inertia
from loose_env.thesis.methods.looseness.static_force_test import (
    compatible_links,
    dock_force,
    docked_acceleration,
    joint_torques,
    link_frames,
    moving_directions,
    remaining_motions,
    seat_twist,
    simulate_docked,
    tool_acceleration,
)

PLANE = [0, 1, 5]
POSE = np.array([0.3, 0.9, -0.7])
DIRECTION = (0.6, 0.8, 0.0)
LOOSE = StructuralLooseness(
    link=2, direction=DIRECTION, gap=2e-4, stiffness=(1e6, 1e6), damping=(100, 100)
)


def nominal(arm, pose):
    return geometric_jacobian(Chain.of(arm, pose))[PLANE]


def loose(arm, pose):
    axis = link_frames(arm, pose)[1] @ DIRECTION
    return geometric_jacobian(insert_looseness(Chain.of(arm, pose), 2, axis))[PLANE]


def wiggle(n, fault, pose, jig="clamp"):
    arm = planar(n)
    shake = Excitation(
        torque_rms=tuple(0.03 * t for t in arm.torque_limits), duration=1.0, band=(1.0, 12.0)
    )
    torque = torque_signals(
        shake, timestep=arm.timestep, before=0, after=0, rng=np.random.default_rng(4)
    )
    return arm, simulate_docked(arm, pose, fault, torque, jig=jig, every=10)


def test_statics_and_power_agree():
    j, f, q = nominal(planar(3), POSE), np.array([3.0, -2.0, 0.5]), np.array([0.1, 0.2, 0.3])
    assert joint_torques(j, f) @ q == pytest.approx(f @ (j @ q))


def test_the_count_of_remaining_motions():
    for n, healthy in ((3, 0), (4, 1)):
        arm, pose = planar(n), np.linspace(0.3, 1.0, n)
        assert remaining_motions(nominal(arm, pose)).shape[1] == healthy
        motion = remaining_motions(loose(arm, pose))
        assert motion.shape[1] == healthy + 1
        np.testing.assert_allclose(loose(arm, pose) @ motion, 0, atol=1e-12)


def test_a_docked_arm_stands_still_unless_it_is_loose():
    arm = planar(3)
    torque = np.array([5.0, -2.0, 1.0])
    m, j = seated_inertia(arm, POSE, Healthy()), nominal(arm, POSE)
    np.testing.assert_allclose(docked_acceleration(j, m, torque), 0, atol=1e-9)
    ml, jl = seated_inertia(arm, POSE, LOOSE), loose(arm, POSE)
    with_seat = np.insert(torque, 2, 0.0)
    f = dock_force(jl, ml, with_seat)
    np.testing.assert_allclose(tool_acceleration(jl, ml, with_seat, f), 0, atol=1e-9)
    moving = docked_acceleration(jl, ml, with_seat)
    assert np.abs(moving).max() > 0.1
    free = remaining_motions(jl)[:, 0]
    np.testing.assert_allclose(np.abs(moving @ free), np.linalg.norm(moving), rtol=1e-9)


def test_balanced_torques_load_no_slide():
    arm = planar(3)
    jl = loose(arm, POSE)
    torque = np.array([5.0, -2.0, 0.0, 1.0])
    free = remaining_motions(jl)  # torque along them is balanced by no force at the tool
    held = torque - free @ (free.T @ torque)
    f = np.linalg.lstsq(jl.T, held, rcond=None)[0]
    np.testing.assert_allclose(joint_torques(jl, f), held, atol=1e-9)
    # A force across the slide leaves the seat alone, one along it does not.
    axis = (link_frames(arm, POSE)[1] @ DIRECTION)[:2]
    across = np.array([-axis[1], axis[0], 0.0])
    assert joint_torques(jl, across)[2] == pytest.approx(0.0, abs=1e-12)
    assert joint_torques(jl, [*axis, 0.0])[2] == pytest.approx(1.0)


def test_simulated_forces_obey_statics():
    arm, record = wiggle(3, Healthy(), POSE)
    wrench = np.vstack([record.forces, record.moments])
    rest = record.torques + joint_torques(nominal(arm, POSE), wrench)
    assert np.abs(rest).max() < 0.005 * np.abs(record.torques).max()


@pytest.mark.parametrize("n", [3, 4])
def test_the_seat_shows_its_direction_and_its_link(n):
    directions, frames = [], []
    for k in range(3):
        pose = np.random.default_rng([7, k]).uniform(-1.8, 1.8, n)
        arm, record = wiggle(n, LOOSE, pose)
        twist = seat_twist(nominal(arm, pose), record.angles)
        assert twist.first_share > 0.99
        axis = (link_frames(arm, pose)[1] @ DIRECTION)[:2]
        assert abs(twist.direction[:2] @ axis) > np.cos(np.radians(1.0))
        assert abs(twist.direction[2]) < 0.01
        assert twist.size == pytest.approx(record.seat.std(), rel=0.02)
        directions.append(twist.direction[:2])
        frames.append(link_frames(arm, pose)[:, :2, :2])
    found = compatible_links(directions, frames)
    assert found.best == 2
    assert found.misfit[1] < 0.02 < 0.2 < np.delete(found.misfit, 1).min()
    assert abs(found.direction @ DIRECTION[:2]) > np.cos(0.02)


def test_play_moves_its_own_joint_only():
    play = Backlash(joint=2, gap=5e-4, stiffness=(1e5, 1e5), damping=(50, 50))
    _, record = wiggle(3, play, POSE)
    assert np.argmax(record.angles.std(axis=1)) == 1
    assert np.delete(record.angles.std(axis=1), 1).max() < 1e-3 * record.angles[1].std()


def test_a_pin_lets_a_healthy_arm_turn_about_the_tool():
    for jig, count in (("pin", 1), ("clamp", 0)):
        _, record = wiggle(3, Healthy(), POSE, jig)
        assert len(moving_directions(record.angles, 2.6e-6)) == count
    _, record = wiggle(3, Healthy(), POSE, "pin")
    motion = moving_directions(record.angles, 2.6e-6)[0]
    expected = remaining_motions(nominal(planar(3), POSE)[:2])[:, 0]
    assert abs(motion @ expected) > 0.9999


def test_bad_input_is_refused():
    with pytest.raises(InvalidData, match="no motion"):
        seat_twist([[1.0]], np.zeros((1, 9)))
