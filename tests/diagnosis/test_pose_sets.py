"""Pose sets and the limits of what they separate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import erf

from loose_env.arms import Arm, planar, scara, six_axis
from loose_env.diagnosis import (
    PLANNED,
    PoseSets,
    bingham_width,
    direction_limit,
    pose_sets,
    scattered_axes,
)
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.kinematics import worst_push

MOVES = np.radians([m for m in range(-90, 91, 15) if m])


def a_set(arm: Arm, strategy: str, count: int = 5, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return PoseSets(arm, moves=MOVES).make(strategy, arm.random_pose(rng), count, rng)


@pytest.mark.parametrize("strategy", PLANNED)
@pytest.mark.parametrize("make", [lambda: planar(2), scara, six_axis])
def test_every_set_has_its_poses_within_the_ranges(
    monkeypatch: pytest.MonkeyPatch, make: Callable[[], Arm], strategy: str
) -> None:
    monkeypatch.setattr(pose_sets, "_CHEBYSHEV_GRID", 100)
    monkeypatch.setattr(pose_sets, "_POOL", 100)
    arm = make()
    poses = a_set(arm, strategy)
    assert poses.shape == (5, arm.n)
    assert all(arm.within_ranges(q).all() for q in poses)
    np.testing.assert_array_equal(poses, a_set(arm, strategy))


def test_one_joint_at_a_time_goes_from_the_base_outward() -> None:
    poses = a_set(planar(4), "one joint", 7)
    moved = np.abs(np.diff(poses, axis=0)) > 1e-9
    assert moved.sum(axis=1).tolist() == [1] * 6
    assert np.argmax(moved, axis=1).tolist() == [1, 2, 3, 1, 2, 3]
    # In the first round by the move that turns a direction most.
    np.testing.assert_allclose(np.degrees(np.abs(np.diff(poses, axis=0))[:3].max(axis=1)), 90)


def test_all_joints_at_once_moves_every_hinge_that_turns_a_direction() -> None:
    arm = scara()  # joint 3 slides
    moved = np.abs(np.diff(a_set(arm, "all joints"), axis=0)) > 1e-9
    np.testing.assert_array_equal(moved, np.tile([False, True, False, True], (4, 1)))


def test_reaction_wrenches_choose_poses_that_load_the_worst_seat_more() -> None:
    arm = planar(3)
    loaded = np.mean([worst_push(arm, q) for q in a_set(arm, "reaction wrenches")])
    usual = np.mean([worst_push(arm, q) for q in a_set(arm, "random", 40)])
    assert loaded > 1.3 * usual


def test_largest_differences_beat_random_poses_in_their_least_moved_joint() -> None:
    def least(poses: np.ndarray) -> float:
        one, other = np.triu_indices(len(poses), 1)
        turn = np.abs((poses[one] - poses[other] + np.pi) % (2 * np.pi) - np.pi)
        return float(turn.min())

    arm = planar(3)
    chosen = np.mean([least(a_set(arm, "largest differences", 3, s)) for s in range(8)])
    drawn = np.mean([least(a_set(arm, "random", 3, s)) for s in range(8)])
    assert chosen > 2 * drawn


def test_unknown_strategies_and_bad_settings_are_refused_with_words() -> None:
    sets, rng = PoseSets(planar(2), moves=MOVES), np.random.default_rng(0)
    with pytest.raises(UnknownName, match="one joint"):
        sets.make("best", np.zeros(2), 3, rng)
    with pytest.raises(InvalidSetting, match="2 finite numbers"):
        sets.make("random", np.zeros(3), 3, rng)
    with pytest.raises(InvalidSetting, match="1 or more"):
        sets.make("random", np.zeros(2), 0, rng)
    with pytest.raises(InvalidSetting, match="not all zero"):
        PoseSets(planar(2), moves=[0.0])
    with pytest.raises(InvalidSetting, match=r"0\.1 to 52 degrees"):
        bingham_width(np.radians(60.0), 2)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("degrees", [5.0, 20.0])
def test_axes_scatter_as_stated(dimension: int, degrees: float) -> None:
    rng = np.random.default_rng(1)
    true = rng.standard_normal(dimension)
    true /= np.linalg.norm(true)
    width = bingham_width(np.radians(degrees), dimension)
    drawn = scattered_axes(np.tile(true, (20_000, 1)), width, rng)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    angle = np.arccos(np.minimum(np.abs(drawn @ true), 1.0))
    rms = np.sqrt(np.mean(angle**2) / (dimension - 1))
    assert np.degrees(rms) == pytest.approx(degrees, rel=0.02)


def test_the_limit_of_one_move_is_the_closed_form_in_the_plane() -> None:
    for links in (2, 4, 7):
        for degrees in (5.0, 10.0):
            sd = np.radians(degrees)
            limit = direction_limit(links, 2, sd, 2, np.random.default_rng(0))
            assert limit[0] == 1 / links
            # The n images stand pi/n apart; the difference of two directions scatters by sqrt(2) s.
            assert limit[1] == pytest.approx(erf(np.pi / (4 * links * sd)), abs=0.015)


@pytest.mark.parametrize("poses", [2, 3])
def test_no_layout_of_images_passes_the_limit(poses: int) -> None:
    """Links may turn as they like here, beyond what any arm can do; the nearest one is named."""
    links, sd, cases = 5, np.radians(20.0), 4000
    limit = direction_limit(links, poses, sd, 2, np.random.default_rng(0), samples=40_000)[-1]
    width = bingham_width(sd, 2)
    rng = np.random.default_rng(2)
    best = 0.0
    for shift in range(1, links if poses > 2 else 2):
        # Link k turns by k pi / n in the second pose and by `shift` times that in the third.
        multiples = np.array([0, 1, shift])[:poses]
        turns = np.arange(links)[:, None] * multiples * np.pi / links
        truth = rng.integers(links, size=cases)
        angle = rng.uniform(0, np.pi, cases)[:, None] + turns[truth]
        seen = scattered_axes(np.stack([np.cos(angle), np.sin(angle)], axis=-1), width, rng)
        back = np.arctan2(seen[..., 1], seen[..., 0])[:, None] - turns
        fit = np.abs(np.exp(2j * back).sum(axis=-1))
        best = max(best, float(np.mean(fit.argmax(axis=1) == truth)))
    assert best < limit + 0.03  # 4000 cases, the best of four
    assert best > limit - 0.06  # and a good layout comes close
