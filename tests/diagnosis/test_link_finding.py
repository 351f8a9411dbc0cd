"""Link finding by directions: turns in the plane, posterior over links, choice of moves."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    LinkFindingSettings,
    Sighting,
    ToolFrames,
    backlash_joint,
    bingham_width,
    candidate_poses,
    choose_move,
    judge_turn,
    link_posterior,
    log_mean_bingham,
    looks_healthy,
    scattered_axes,
)
from loose_env.errors import InvalidSetting
from scripts.thesis.rigs import cylindrical


def sighting(
    pose: list[float],
    direction: float,
    *,
    kurtosis: float = 0.0,
    correlation: float = 0.5,
    nominal_direction: float = 0.0,
) -> Sighting:
    return Sighting(
        pose=np.array(pose),
        direction=direction,
        correlation=correlation,
        kurtosis=kurtosis,
        nominal_direction=nominal_direction,
        nominal_correlation=1.0,
    )


def seen_in_tool_frame(link: int, angle: float, pose: list[float]) -> float:
    """Direction of looseness at a link: it turns back by the joints distal to the link."""
    return angle - float(np.sum(pose[link:]))


@pytest.mark.parametrize("link", [1, 2, 3, 4])
@pytest.mark.parametrize("joint", [2, 3, 4])
@pytest.mark.parametrize("move", [np.pi / 2, -np.pi / 4])
def test_a_direction_turns_when_a_joint_beyond_the_loose_link_moves(
    link: int, joint: int, move: float
) -> None:
    before, after = [0.1, -0.4, 0.9, 0.3], [0.1, -0.4, 0.9, 0.3]
    after[joint - 1] += move
    finding = judge_turn(
        sighting(before, seen_in_tool_frame(link, 0.7, before)),
        sighting(after, seen_in_tool_frame(link, 0.7, after)),
        joint,
        LinkFindingSettings(),
    )
    assert finding == ("turned" if joint > link else "still")


def test_healthy_asks_for_a_small_index_in_every_pose() -> None:
    settings = LinkFindingSettings(healthy_index=0.05)
    alike = sighting([0.0, 0.0], 0.0, correlation=0.99)
    unlike = sighting([0.0, 0.0], 1.2, correlation=0.4)
    assert looks_healthy([alike, alike], settings)
    assert not looks_healthy([alike, unlike], settings)


def test_index_e_sees_a_turn_that_leaves_the_correlation_as_it_was() -> None:
    turned = sighting([0.0, 0.0], 1.0, correlation=1.0)
    assert looks_healthy([turned], LinkFindingSettings(index="d"))
    assert not looks_healthy([turned], LinkFindingSettings(index="e"))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_backlash_is_motion_along_a_joints_own_line_that_is_not_normal(joint: int) -> None:
    linear = LinearArm(planar(3))
    poses = [[0.0, 0.6, -1.1], [0.0, -0.9, 0.7]]

    def seen(pose: list[float], kurtosis: float) -> Sighting:
        line = linear.at(pose).kinematic[:, joint - 1]
        return sighting(pose, float(np.arctan2(line[1], line[0])), kurtosis=kurtosis)

    settings = LinkFindingSettings(backlash_angle=5.0, backlash_kurtosis=1.0)
    assert backlash_joint(linear, [seen(p, 3.0) for p in poses], settings) == joint
    assert backlash_joint(linear, [seen(p, 0.0) for p in poses], settings) is None


ARMS = [six_axis(), scara(), cylindrical(), planar(4), vera()]
SIX = ToolFrames(six_axis())


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    v = rng.standard_normal(shape)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("arm", ARMS, ids=lambda a: a.name)
def test_images_and_lines_are_those_of_the_simulator(arm: Arm) -> None:
    frames, linear, model = ToolFrames(arm), LinearArm(arm), arm.model
    rng = np.random.default_rng(3)
    poses = np.array([arm.random_pose(rng) for _ in range(6)])
    images, lines = frames.images(poses), frames.lines(poses)
    data = mujoco.MjData(model)
    for k, pose in enumerate(poses):
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(model, data)
        tool = data.site(arm.tool).xmat.reshape(3, 3)
        for i in range(arm.n):
            link = data.body(arm.seat_bodies[i]).xmat.reshape(3, 3)
            seen = (tool.T @ link)[list(arm.axes), : len(arm.axes)]
            np.testing.assert_allclose(images[k, i], seen, atol=1e-9)
        np.testing.assert_allclose(lines[k], linear.at(pose).kinematic.T, atol=1e-9)


# The likelihood of an axis.


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("strength", [0.3, 5.0, 40.0])
def test_the_mean_over_the_sphere_is_that_of_many_draws(size: int, strength: float) -> None:
    rng = np.random.default_rng(2)
    root = rng.standard_normal((size, size))
    matrix = strength * root @ root.T
    m = unit(rng, 400_000, size)
    drawn = np.mean(np.exp(-0.5 * np.einsum("pi,ij,pj->p", m, matrix, m)))
    assert log_mean_bingham(matrix) == pytest.approx(np.log(drawn), abs=0.02)


def test_a_narrow_axis_has_the_gaussian_density() -> None:
    # Two caps of area 2 pi s1 s2 each, over 4 pi.
    s1, s2 = 1e-3, 4e-4
    log = log_mean_bingham(np.diag([0.0, s1**-2, s2**-2]))
    assert log == pytest.approx(np.log(s1 * s2), abs=1e-4)


# The posterior over links.


@pytest.mark.parametrize("link", [1, 2, 3, 4, 5, 6])
def test_the_loose_link_and_its_direction_are_found(link: int) -> None:
    rng = np.random.default_rng(link)
    z = unit(rng, 3)
    poses = np.array([SIX.arm.random_pose(rng) for _ in range(5)])
    seen = rng.choice([-1.0, 1.0], 5)[:, None] * (SIX.images(poses)[:, link - 1] @ z)
    found = link_posterior(SIX, poses, seen, width=np.radians(3))
    assert found.probabilities.argmax() == link - 1
    assert found.probabilities.max() > 0.99
    assert abs(found.directions[link - 1] @ z) == pytest.approx(1.0, abs=1e-9)
    assert found.sd[link - 1] == pytest.approx(np.radians(3) / np.sqrt(5), rel=0.01)


def test_one_direction_says_nothing_about_the_link() -> None:
    found = link_posterior(SIX, [np.zeros(6)], [np.array([0.6, 0.0, 0.8])], width=0.1)
    np.testing.assert_allclose(found.probabilities, 1 / 6, rtol=1e-6)


def test_the_posterior_is_calibrated() -> None:
    # Of the links named with a probability about p, a share p is right.
    claimed, right = [], []
    width = bingham_width(np.radians(15), 3)
    for k in range(300):
        rng = np.random.default_rng([9, k])
        link, z = int(rng.integers(6)), unit(rng, 3)
        poses = [SIX.arm.random_pose(rng) for _ in range(3)]
        # Drawn from the density itself.
        seen = [scattered_axes(SIX.images(q)[0, link] @ z, width, rng) for q in poses]
        found = link_posterior(SIX, poses, seen, width=width)
        claimed.append(found.probabilities.max())
        right.append(int(np.argmax(found.probabilities)) == link)
    assert 0.4 < np.mean(claimed) < 0.98
    assert abs(np.mean(claimed) - np.mean(right)) < 0.07


# Moves.


def test_no_other_pose_shows_the_links_that_are_left_farther_apart() -> None:
    pose, rng, sd = np.array([0.1, -0.8, 1.1, 0.3, 0.7, 0.2]), np.random.default_rng(1), 0.1
    found = link_posterior(SIX, [pose], [unit(rng, 3)], width=sd)
    where = candidate_poses(SIX, pose, np.radians([-90, -45, 45, 90]), most=512, rng=rng)
    assert all(SIX.arm.within_ranges(q).all() for q in where)

    def confused(q: np.ndarray) -> float:
        shown = np.einsum("kij,kj->ki", SIX.images(q)[0], found.directions)
        angles = np.arccos(np.minimum(np.abs(shown @ shown.T), 1.0))[np.triu_indices(6, 1)]
        return float(np.exp(-(angles**2) / (16 * sd**2)).sum())

    best = choose_move(SIX, found, where, sd=sd)
    assert confused(where[best]) <= min(map(confused, where)) * 1.001


def test_candidates_keep_sliding_joints_and_joint_1_still_and_respect_the_ranges() -> None:
    frames, rng = ToolFrames(scara()), np.random.default_rng(0)
    pose = np.array([0.0, 2.5, -0.1, 0.0])
    where = candidate_poses(frames, pose, np.array([-1.5, 1.5]), most=99, rng=rng)
    assert (where[0] == pose).all()
    assert (where[:, [0, 2]] == pose[[0, 2]]).all()
    assert set(where[:, 1]) == {2.5, 1.0}  # 4.0 would leave the range


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"order": "sideways"}, "sideways"),
        ({"joint": 0}, "1 or more"),
        ({"turned": float("nan")}, "zero or more"),
    ],
)
def test_what_cannot_be_judged_is_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetting, match=words):
        LinkFindingSettings(**wrong)
