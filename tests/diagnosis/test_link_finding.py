"""Link finding by directions, in the plane and in space: turns, posterior, choice of moves."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    DirectionSighting,
    LinkFindingSettings,
    Order,
    Sighting,
    ToolFrames,
    TurnSearch,
    backlash_joint,
    candidate_poses,
    choose_move,
    choose_open_move,
    confusable_faults,
    judge_turn,
    link_posterior,
    log_mean_bingham,
    looks_healthy,
    precision_of,
    scattered_axes,
)
from loose_env.diagnosis.link_finding import (
    blind_joints,
    expected_openness,
)
from loose_env.errors import InvalidData, InvalidSetting
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


def slides_only(frames: ToolFrames) -> np.ndarray:
    return np.repeat([1.0, 0.0], frames.arm.n)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    v = rng.standard_normal(shape)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def turned(p: np.ndarray, axis: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
    """Rotate vectors about axes (Rodrigues)."""
    c, s = np.cos(angle), np.sin(angle)
    along = np.sum(p * axis, axis=-1, keepdims=True) * axis
    return along + c * (p - along) + s * np.cross(axis, p)


@pytest.mark.parametrize("arm", ARMS, ids=lambda a: a.name)
def test_images_and_lines_are_those_of_the_simulator(arm: Arm) -> None:
    frames, linear, model = ToolFrames(arm), LinearArm(arm), arm.model
    rng = np.random.default_rng(3)
    poses = np.array([arm.random_pose(rng) for _ in range(6)])
    images, lines, axes = frames.images(poses), frames.lines(poses), frames.axes(poses)
    data = mujoco.MjData(model)
    for k, pose in enumerate(poses):
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(model, data)
        tool = data.site(arm.tool).xmat.reshape(3, 3)
        for i in range(arm.n):
            link = data.body(arm.seat_bodies[i]).xmat.reshape(3, 3)
            seen = (tool.T @ link)[list(arm.axes), : len(arm.axes)]
            np.testing.assert_allclose(images[k, i], seen, atol=1e-9)
            axis = tool.T @ data.joint(arm.joints[i]).xaxis
            np.testing.assert_allclose(axes[k, i], axis, atol=1e-9)
        np.testing.assert_allclose(lines[k], linear.at(pose).kinematic.T, atol=1e-9)


@pytest.mark.parametrize("order", ["outward", "inward", "bisection"])
def test_exact_directions_across_the_axes_lead_every_order_to_the_link(order: Order) -> None:
    frames, rules = ToolFrames(planar(5)), LinkFindingSettings(order=order)
    for link in range(1, 6):
        pose, search = np.array([0.1, 0.5, -0.9, 0.4, 1.2]), TurnSearch.over(5)
        z = np.array([0.8, 0.6])
        while True:
            seen = DirectionSighting.of(pose, frames.images(pose)[0, link - 1] @ z, 0.05)
            joint = search.joint(frames, seen, moves=np.array([np.pi / 2]), rules=rules)
            if joint is None:
                break
            pose = pose + np.pi / 2 * (np.arange(5) == joint - 1)
            after = DirectionSighting.of(pose, frames.images(pose)[0, link - 1] @ z, 0.05)
            search = search.after(frames, seen, after, joint=joint, rules=rules)
        assert (search.low, search.high, search.link(rules)) == (link, link, link)


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


def test_precision_is_the_inverse_covariance_across_the_axis() -> None:
    p = np.array([0.0, 0.0, -3.0])
    covariance = np.array([[0.04, 0.01, 5.0], [0.01, 0.09, 5.0], [5.0, 5.0, 1e6]])
    precision = precision_of(p, covariance)
    np.testing.assert_allclose(precision[:2, :2] @ covariance[:2, :2], np.eye(2), atol=1e-9)
    np.testing.assert_allclose(precision @ p, 0.0, atol=1e-9)
    assert not precision_of(p, np.inf).any()


# The posterior over links.


@pytest.mark.parametrize("link", [1, 2, 3, 4, 5, 6])
def test_the_loose_link_and_its_direction_are_found(link: int) -> None:
    rng = np.random.default_rng(link)
    z = unit(rng, 3)
    poses = np.array([SIX.arm.random_pose(rng) for _ in range(5)])
    signs = rng.choice([-1.0, 1.0], 5)
    seen = [
        DirectionSighting.of(q, s * p, np.radians(3))
        for q, p, s in zip(poses, SIX.images(poses)[:, link - 1] @ z, signs, strict=True)
    ]
    found = link_posterior(SIX, seen, prior=slides_only(SIX))
    assert found.best == f"structural_looseness@link{link}"
    assert found.of([found.best]) > 0.99
    assert abs(found.directions[link - 1] @ z) == pytest.approx(1.0, abs=1e-9)
    assert found.direction_sd[link - 1] == pytest.approx(np.radians(3) / np.sqrt(5), rel=0.01)


def test_one_direction_says_nothing_about_the_link() -> None:
    found = link_posterior(
        SIX, [DirectionSighting.of(np.zeros(6), [1, 2, 3], 0.1)], prior=slides_only(SIX)
    )
    np.testing.assert_allclose(found.probabilities[:6], 1 / 6, rtol=1e-6)
    blind = link_posterior(SIX, [DirectionSighting.of(np.zeros(6), [1, 2, 3], np.inf)])
    np.testing.assert_allclose(blind.probabilities, 1 / 12, rtol=1e-9)


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_play_is_told_from_slides_by_its_own_line(joint: int) -> None:
    rng = np.random.default_rng(8)
    poses = np.array([SIX.arm.random_pose(rng) for _ in range(3)])
    lines = SIX.unit_lines(poses)[:, joint - 1]
    seen = [DirectionSighting.of(q, p, 0.05) for q, p in zip(poses, lines, strict=True)]
    assert link_posterior(SIX, seen).best == f"backlash@joint{joint}"


def test_the_posterior_is_calibrated() -> None:
    # Of the links named with a probability about p, a share p is right.
    claimed, right = [], []
    sd = np.radians(15)
    for k in range(300):
        rng = np.random.default_rng([9, k])
        link, z = int(rng.integers(6)), unit(rng, 3)
        seen = []
        for _ in range(3):
            q = SIX.arm.random_pose(rng)
            true = SIX.images(q)[0, link] @ z
            # Drawn from the density itself.
            seen.append(DirectionSighting.of(q, scattered_axes(true, sd, rng), sd))
        found = link_posterior(SIX, seen, prior=slides_only(SIX))
        claimed.append(found.probabilities.max())
        right.append(int(np.argmax(found.probabilities)) == link)
    assert 0.4 < np.mean(claimed) < 0.98
    assert abs(np.mean(claimed) - np.mean(right)) < 0.07


def test_doubtful_scales_forgive_one_bad_direction() -> None:
    rng = np.random.default_rng(4)
    poses = np.array([SIX.arm.random_pose(rng) for _ in range(5)])
    p = SIX.images(poses)[:, 1] @ unit(rng, 3)
    p[2] = unit(rng, 3)
    seen = [DirectionSighting.of(q, v, np.radians(3)) for q, v in zip(poses, p, strict=True)]
    sure = link_posterior(SIX, seen, prior=slides_only(SIX))
    careful = link_posterior(SIX, seen, prior=slides_only(SIX), scales=(1.0, 3.0, 9.0))
    assert careful.probabilities.max() < sure.probabilities.max()


# Moves.


def test_moving_all_joints_beats_moving_one() -> None:
    arm = SIX.arm
    pose = np.array([0.1, -0.8, 1.1, 0.3, 0.7, 0.2])
    seen = [DirectionSighting.of(pose, [0.5, -0.4, 0.8], np.radians(5))]
    found = link_posterior(SIX, seen, prior=slides_only(SIX))
    moves = np.radians([-90, -45, 45, 90])
    left = {}
    for joints in ("one", "all"):
        where = candidate_poses(arm, pose, moves, joints=joints, sliding=SIX.slides)  # type: ignore[arg-type]
        assert all(arm.within_ranges(q).all() for q in where)
        left[joints] = choose_move(SIX, found, where, sd=np.radians(5))[1][0]
    assert left["all"] < 0.5 * left["one"] < 0.5


def test_candidates_keep_sliding_joints_and_joint_1_still_and_respect_the_ranges() -> None:
    frames = ToolFrames(scara())
    arm = frames.arm
    pose = np.array([0.0, 2.5, -0.1, 0.0])
    for joints in ("one", "all"):
        where = candidate_poses(arm, pose, [-1.5, 1.5], joints=joints, sliding=frames.slides)  # type: ignore[arg-type]
        assert (where[0] == pose).all()
        assert (where[:, [0, 2]] == pose[[0, 2]]).all()
        assert set(where[:, 1]) == {2.5, 1.0}  # 4.0 would leave the range


def test_joints_that_cannot_turn_a_direction_are_blind_and_passed_over() -> None:
    frames = ToolFrames(scara())
    pose = np.array([0.3, 0.5, -0.1, 0.2])
    assert blind_joints(frames, pose, [0.8, 0.6, 0.0]).tolist() == [False, False, True, False]
    assert blind_joints(frames, pose, [0.0, 0.05, 1.0]).all()
    axis = SIX.axes(np.zeros(6))[0, 3]
    assert blind_joints(SIX, np.zeros(6), axis)[3]
    assert not blind_joints(SIX, np.zeros(6), axis)[4]
    rules, moves = LinkFindingSettings(), np.array([np.pi / 2])
    seen = DirectionSighting.of(pose, [0.8, 0.6, 0.0], 0.05)
    held = TurnSearch(low=2, high=4)
    assert held.joint(frames, seen, moves=moves, rules=rules) == 4  # joint 3 slides
    stuck = np.array([True, True, True, False])
    assert held.joint(frames, seen, moves=moves, rules=rules, can_move=stuck) is None


@pytest.mark.parametrize(
    ("name", "direction", "alike"),
    [
        ("structural_looseness@link1", [1.0, 0, 0], {1}),
        ("structural_looseness@link2", [1.0, 0, 0], {2, 3}),  # joint 3 slides
        ("structural_looseness@link4", [0, 1.0, 0], {4}),
        ("structural_looseness@link2", [0, 0, 1.0], {1, 2, 3, 4}),  # along all axes
    ],
)
def test_links_of_a_scara_that_no_move_tells_apart(
    name: str, direction: list[float], alike: set[int]
) -> None:
    found = confusable_faults(ToolFrames(scara()), name, direction)
    assert {int(f[-1]) for f in found if f.startswith("structural")} == alike
    # Play along the quill is a slide along the vertical, seen from anywhere.
    assert ("backlash@joint3" in found) == (direction[2] == 1.0)


def test_a_planar_arm_has_no_look_alikes_among_its_links() -> None:
    frames = ToolFrames(planar(4))
    for link in range(1, 5):
        name = f"structural_looseness@link{link}"
        assert name in confusable_faults(frames, name, [0.6, 0.8])
        assert len([f for f in confusable_faults(frames, name, [0.6, 0.8]) if "link" in f]) == 1


def test_of_moves_that_tell_as_much_the_one_that_opens_the_seats_is_taken() -> None:
    linear = LinearArm(SIX.arm)
    rng = np.random.default_rng(6)
    seen = [DirectionSighting.of(SIX.arm.random_pose(rng), unit(rng, 3), 0.05)]
    found = link_posterior(SIX, seen, prior=slides_only(SIX))
    where = np.array([SIX.arm.random_pose(rng) for _ in range(40)])
    blunt = where[choose_move(SIX, found, where, sd=0.05)[0][0]]
    open_one = choose_open_move(SIX, linear, found, where, sd=0.05, level=4.0, shortlist=40)
    share = [
        expected_openness(linear, found, q, level=4.0)[0, :6].mean() for q in (blunt, open_one)
    ]
    assert share[1] > share[0]


def two_moved() -> object:
    frames = ToolFrames(planar(3))
    a, b = (DirectionSighting.of([0, q, q], [1, 0], 0.1) for q in (0, 1))
    return TurnSearch.over(3).after(frames, a, b, joint=2, rules=LinkFindingSettings())


SEEN = [DirectionSighting.of(np.zeros(6), [1, 0, 0], 0.1)]


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (lambda: precision_of([0.0, 0.0], 0.1), InvalidData, "not all zero"),
        (lambda: precision_of([1.0, 0.0], np.nan), InvalidData, "uncertainty"),
        (lambda: DirectionSighting.of([0.0, 0.0], [1.0, 0.0], 0.0), InvalidData, "above zero"),
        (lambda: link_posterior(SIX, []), InvalidData, "no direction"),
        (lambda: link_posterior(SIX, SEEN, prior=np.ones(5)), InvalidSetting, "12 weights"),
        (lambda: link_posterior(SIX, SEEN, prior=-np.ones(12)), InvalidSetting, "12 weights"),
        (lambda: link_posterior(SIX, SEEN, prior=np.zeros(12)), InvalidSetting, "no hypothesis"),
        (lambda: link_posterior(SIX, SEEN, scales=(0.0,)), InvalidSetting, "positive factors"),
        (lambda: confusable_faults(SIX, "structural_looseness@link2"), InvalidSetting, "direction"),
        (two_moved, InvalidData, "joint 2 alone"),
        (lambda: LinkFindingSettings(order="sideways"), InvalidSetting, "sideways"),  # type: ignore[arg-type]
        (lambda: LinkFindingSettings(joint=0), InvalidSetting, "1 or more"),
        (lambda: LinkFindingSettings(turned=float("nan")), InvalidSetting, "zero or more"),
    ],
)
def test_what_cannot_be_judged_is_refused(
    given: Callable[[], object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        given()
