"""The thesis's equations against closed forms, derivatives, simulations and the source's tables."""

from __future__ import annotations

import inspect
import re
from importlib import import_module

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar
from loose_env.errors import InvalidData
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from scripts.thesis import loose_joint as loose_joints
from scripts.thesis import planar_motion
from scripts.thesis.link_finding import (
    JOINTS,
    SLIDES,
    chance_of,
    named,
    pair_count,
    predicted_slides,
    scatter,
)
from scripts.thesis.page import SECTIONS, text_of
from scripts.thesis.planar_motion import (
    LoosePlanarArm,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from scripts.thesis.rigs import cylindrical, slide_rig
from scripts.thesis.shaken_vera import poses

PLANE, POSE = [0, 1, 5], np.array([0.3, 0.9, -0.7])
SLIDE = StructuralLooseness(
    link=2, direction=(0.6, 0.8, 0.0), gap=2e-4, stiffness=(1e6, 1e6), damping=(100, 100)
)


def cited(source: str) -> set[str]:
    """Numbers of equations in a text, ranges such as 3.15-3.17 spelt out."""
    found = re.findall(r"\b(\d)\.(\d+)\)?(?:(?:-| to )\(?(\d)\.(\d+))?", " ".join(source.split()))
    return {f"{c}.{k}" for c, a, _, b in found for k in range(int(a), int(b or a) + 1)}


@pytest.mark.parametrize("key", list(SECTIONS))
def test_every_equation_has_a_function_that_cites_it(key: str) -> None:
    assert callable(getattr(import_module(f"scripts.thesis.{SECTIONS[key]}"), key))
    for path, numbers in text_of(key).get("equations", {}).items():
        parts, found = path.split("."), None
        for k in range(len(parts) - 1, 0, -1):  # a method stands behind its class
            try:
                found = import_module(".".join(parts[:k]))
            except ModuleNotFoundError:
                continue
            for part in parts[k:]:
                found = getattr(found, part)
            break
        assert callable(found)
        assert set(numbers.split()) <= cited(inspect.getdoc(found) or ""), path


def test_the_looseness_joint_is_a_column_that_locates_its_link() -> None:
    chain, step = Chain.of(planar(4), [0.2, 0.5, -0.8, 0.6]), 1e-6
    for kind, axis in (("prismatic", [1, 2, 0]), ("revolute", [0, 0, 1])):
        loose = loose_joints.insert_looseness(chain, 2, axis, kind=kind)
        ends = [loose_joints.displaced(chain, 2, axis, s * step, kind=kind).tool for s in (1, -1)]
        column = geometric_jacobian(loose)[:3, 2]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * step), atol=1e-8)
    for link in range(1, 5):
        moved = loose_joints.displaced(chain, link, [1, 2, 0], 2e-4)
        for frame in ("tool", "world", "base"):
            pair = (geometric_jacobian(c, frame) for c in (chain, moved))
            changed = loose_joints.changed_columns(*pair)
            proximal = np.arange(1, 5) <= link
            assert changed.tolist() == (~proximal if frame == "base" else proximal).tolist()
            found = loose_joints.link_of_changed_columns(changed, frame)
            assert found == (0 if frame == "base" and link == 4 else link)
    with pytest.raises(InvalidData, match="one block"):
        loose_joints.link_of_changed_columns([False, True], "tool")
    direction = loose_joints.slot_direction([0, 0, 1], [np.cos(0.6), np.sin(0.6), 0])  # (3.27)
    transform = loose_joints.looseness_transform(direction, 0.01)  # (3.26)
    np.testing.assert_allclose(transform[:3, :3], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(transform[:3, 3], 0.01 * direction, atol=1e-14)
    loose = geometric_jacobian(loose_joints.insert_looseness(chain, 1, [0, 1, 0]))
    error = loose @ [1, 0.05, 2, 3, 4] - geometric_jacobian(chain) @ [1, 2, 3, 4]
    np.testing.assert_allclose(error, [0, 0.05, 0, 0, 0, 0], atol=1e-15)  # (3.34)


def test_the_recursion_finds_lengths_and_offsets_in_any_pose_and_frame() -> None:
    lengths, offsets = np.array([0.5, 0.35, 0.4, 0.2]), np.array([0.0, 0.3, -1.0, 0.7])
    rates, rng = np.array([0.4, -0.7, 0.5, 1.1]), np.random.default_rng(5)

    def velocities(angles: np.ndarray) -> np.ndarray:
        heading = np.cumsum(angles + offsets)
        links = lengths[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        arms = np.cumsum(links[::-1], axis=0)[::-1]
        return loose_joints.velocity_components([-arms[:, 1], arms[:, 0]], rates)

    for _ in range(10):
        q = rng.uniform(-np.pi, np.pi, 4)
        v = velocities(q)
        for turned in (v, v @ [[0.6, 0.8], [-0.8, 0.6]]):
            found = loose_joints.identify_planar(turned, rates, q)
            np.testing.assert_allclose(found.lengths, lengths, rtol=1e-10)
            error = np.angle(np.exp(1j * (found.offsets - offsets[1:])))
            np.testing.assert_allclose(error, 0, atol=1e-10)
    # Only the last joint moves; the printed angle (3.65) of inner joints changes with it.
    one, other = (
        loose_joints.distended_angles(velocities(np.array([0.0, 0.2, 0.3, last])), rates)
        for last in (0.1, 0.9)
    )
    assert np.angle(np.exp(1j * (other[-1] - one[-1]))) == pytest.approx(0.8)
    assert np.abs(other[:2] - one[:2]).min() > 0.02


def nominal_and_loose(n: int, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    chain = Chain.of(planar(n), pose)
    axis = loose_joints.link_frames(planar(n), pose)[1] @ SLIDE.direction
    both = (chain, loose_joints.insert_looseness(chain, 2, axis))
    return tuple(geometric_jacobian(c)[PLANE] for c in both)  # type: ignore[return-value]


def test_a_docked_arm_moves_only_if_it_is_loose_or_has_a_joint_to_spare() -> None:
    for n, healthy in ((3, 0), (4, 1)):
        nominal, loose = nominal_and_loose(n, np.linspace(0.3, 1.0, n))
        assert loose_joints.remaining_motions(nominal).shape[1] == healthy
        motion = loose_joints.remaining_motions(loose)
        assert motion.shape[1] == healthy + 1
        np.testing.assert_allclose(loose @ motion, 0, atol=1e-12)
    arm, torque = planar(3), np.array([5.0, -2.0, 0.0, 1.0])
    nominal, loose = nominal_and_loose(3, POSE)
    inertia = loose_joints.seated_inertia(arm, POSE, Healthy())
    still = loose_joints.docked_acceleration(nominal, inertia, torque[[0, 1, 3]])
    np.testing.assert_allclose(still, 0, atol=1e-9)
    seated = loose_joints.seated_inertia(arm, POSE, SLIDE)[np.ix_([0, 1, 3, 2], [0, 1, 3, 2])]
    force = loose_joints.dock_force(loose, seated, torque)
    held = loose @ np.linalg.solve(seated, torque + loose.T @ force)
    np.testing.assert_allclose(held, 0, atol=1e-9)
    assert np.abs(loose_joints.docked_acceleration(loose, seated, torque)).max() > 0.1
    velocity = np.array([0.1, 0.2, 0.3])
    power = loose_joints.joint_torques(nominal, [3.0, -2.0, 0.5]) @ velocity
    assert power == pytest.approx(np.array([3.0, -2.0, 0.5]) @ nominal @ velocity)  # (3.10)


def test_tool_motion_is_the_derivative_of_the_one_before() -> None:
    arm, speed = LoosePlanarArm(length1=0.5, length2=0.3, beta=0.7), np.array([[1.3], [-0.8]])
    t, h = np.linspace(0.0, 2.0, 25), 1e-6

    def motion(t: np.ndarray) -> list[np.ndarray]:
        q, qd = np.sin(speed * t), speed * np.cos(speed * t)
        d, dd = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t)
        return [q, qd, -(speed**2) * q, d, dd, -9 * d]

    q, qd, qdd, d, dd, ddd = motion(t)
    before, after = motion(t - h), motion(t + h)
    ends = [tool_position(arm, m[0], m[3]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_velocity(arm, q, qd, d, dd), slope, atol=1e-8)  # (5.4)
    ends = [tool_velocity(arm, m[0], m[1], m[3], m[4]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_acceleration(arm, q, qd, qdd, d, dd, ddd), slope, atol=1e-8)
    tight = tool_velocity(arm, q, qd, 0.0, 0.0)  # (3.71)
    ends = [tool_position(arm, m[0], 0.0) for m in (before, after)]
    np.testing.assert_allclose(tight, (ends[1] - ends[0]) / (2 * h), atol=1e-8)
    assert planar_motion.link_rate([0.7, -0.2]) == pytest.approx(0.5)
    reach = [0.5 * np.cos(0.3) + 0.3 * np.cos(1.4), 0.5 * np.sin(0.3) + 0.3 * np.sin(1.4)]
    np.testing.assert_allclose(tool_position(arm, [0.3, 1.1], 0.0), reach)  # (6.1)


def test_a_slide_is_carried_along_by_the_joints_beyond_it() -> None:
    from loose_env.diagnosis import ToolFrames

    frames, before, after = ToolFrames(planar(3)), np.zeros(3), np.array([0.0, 0.7, 0.0])
    found = predicted_slides(frames, before, after, np.array([1.0, 0.0]))  # (4.27)
    turned = [np.cos(0.7), -np.sin(0.7)]
    np.testing.assert_allclose(found, [turned, [1.0, 0.0], [1.0, 0.0]], atol=1e-12)


def test_the_cylindrical_arm_moves_in_cylindrical_coordinates_and_carries_its_weight() -> None:
    arm = cylindrical()
    at = LinearArm(arm).at([0.4, 0.3, 0.7, 0.0, 0.0, 0.0])
    radius = 0.15 + 0.55 + 0.12 + 0.10 + 0.14 + 0.7
    expected = [[0, 0, 1], [radius, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(at.kinematic[:, :3], expected, atol=1e-12)
    carried = arm.model.body("flange2").subtreemass[0]
    assert at.gravity_torque[1] == pytest.approx(9.81 * carried)
    assert slide_rig(looseness_angle=1.0).shaker.stand == "bench"


def test_the_link_is_the_one_in_whose_frame_a_direction_is_fixed() -> None:
    theta2 = np.array(poses())
    assert named(0.4 - theta2) == SLIDES[0] and pair_count(0.4 - theta2)[0] == 0
    assert scatter(0.4 - theta2)[SLIDES[0]] == pytest.approx(0.0, abs=1e-9)
    assert named([0.4] * 5) == SLIDES[1] and pair_count([0.4] * 5)[0] == 9
    # Play in joint 2 moves the tool across link 2; the line of joint 1 lies half its angle on.
    assert scatter(np.full(5, np.pi / 2))[JOINTS[1]] == pytest.approx(0.0, abs=1e-9)
    assert scatter(np.pi / 2 - theta2 / 2)[JOINTS[0]] == pytest.approx(0.0, abs=1e-6)
    assert chance_of(np.radians(60.0), 0) > 0.95 and chance_of(np.radians(10.0), 0) < 0.01
