"""Actions: what they do, which make sense, and what a level means."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from loose_agents.base import action_of, code_of
from numpy.typing import NDArray

from loose_env.arms import planar, six_axis
from loose_env.envs import (
    ActionLayout,
    DiagnosisEnv,
    DiagnosisSettings,
)
from loose_env.errors import InvalidAction
from loose_env.typing import Array

Make = Callable[..., Any]

MOVES = (-90, -45, 0, 45, 90)


def pose_of(env: DiagnosisEnv, observation: NDArray[np.float32]) -> Array:
    """The pose that an observation shows [deg]."""
    sin, cos = (env.layout.physical(observation, f"now.{part}_pose") for part in ("sin", "cos"))
    return np.degrees(np.arctan2(sin, cos))


def mask_parts(env: DiagnosisEnv, mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """The mask, one array for each entry of the action."""
    return np.split(mask, np.cumsum(env.actions.nvec)[:-1])


def test_each_joint_makes_the_move_its_entry_names(make_env: Make) -> None:
    env = make_env(n_links=3, max_records=5)
    for joint in range(3):
        env.reset(seed=0, options={"pose": np.zeros(3)})
        place = 0
        for choice in (0, 4, 3, 1, 2):
            action = env.actions.encode()
            action[joint] = choice
            place += MOVES[choice]
            expected = np.zeros(3)
            expected[joint] = place
            np.testing.assert_allclose(pose_of(env, env.step(action)[0]), expected, atol=1e-4)


def test_a_sliding_joint_goes_through_its_range_in_proportion(
    make_env: Make,
) -> None:
    env = make_env("scara", max_records=10)
    env.reset(seed=0, options={"pose": [0.0, 0.0, -0.21, 0.0]})
    place = -0.21
    # 90 degrees are half of the 0.21 m.
    for choice, share in ((4, 0.5), (3, 0.25), (1, -0.25), (0, -0.5), (2, 0.0)):
        moves = np.array([2, 2, choice, 2])
        observation, _, _, _, info = env.step(env.actions.encode(moves=moves))
        place += share * 0.21
        assert not info["move_ignored"].any()
        found = env.layout.pose_of(observation)
        np.testing.assert_allclose(found, [0.0, 0.0, place, 0.0], atol=1e-7)
    np.testing.assert_allclose(env.actions.steps[2], [-0.105, -0.0525, 0.0, 0.0525, 0.105])
    np.testing.assert_allclose(env.actions.steps[0], np.radians(MOVES))


def test_with_every_joint_off_the_last_one_is_excited(
    make_env: Make, spy_on: Callable[..., Any]
) -> None:
    env = make_env(n_links=2, max_records=4)
    spy = spy_on(env)
    found = []
    for levels in ((0, 0), (0, 3)):
        env.reset(seed=0, options={"pose": np.zeros(2)})
        action = env.actions.encode(moves=np.array([4, 3]), levels=np.array(levels), duration=0)
        found.append(env.step(action)[:2])
    assert [trials.excited.tolist() for trials in spy.asked] == [[[False, True]]] * 2
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1] == pytest.approx(-(0.05 + 0.2 * 0.02 + 3 * 0.002))


def test_moves_past_a_joint_limit_are_masked(make_env: Make) -> None:
    env = make_env(n_links=3, max_records=2)
    limits = np.array([180.0, 150.0, 150.0])
    _, info = env.reset(seed=0, options={"pose": np.radians([100.0, 105.0, -61.0])})
    parts = mask_parts(env, info["action_mask"])
    assert [part.tolist() for part in parts[:3]] == [
        [True, True, True, True, False],
        [True, True, True, True, False],
        [False, True, True, True, True],
    ]
    for seed in range(20):
        observation, info = env.reset(seed=seed)
        for joint, pose in enumerate(pose_of(env, observation)):
            allowed = np.abs(pose + np.array(MOVES)) <= limits[joint]
            np.testing.assert_array_equal(mask_parts(env, info["action_mask"])[joint], allowed)


def test_verdicts_wait_for_the_first_record_and_going_on_ends_with_the_last(
    make_env: Make,
) -> None:
    env = make_env(n_links=2, max_records=2)
    _, info = env.reset(seed=0)
    seen = [mask_parts(env, info["action_mask"])[-1].tolist()]
    for _ in range(2):
        info = env.step(env.actions.encode())[-1]
        seen.append(mask_parts(env, info["action_mask"])[-1].tolist())
    assert seen == [[True] + [False] * 6, [True] * 6 + [False], [False] + [True] * 6]


def test_a_joint_told_to_pass_its_limit_stays_and_the_others_move(
    make_env: Make,
) -> None:
    env = make_env(n_links=3)
    env.reset(seed=0, options={"pose": np.radians([0.0, 140.0, -20.0])})
    observation, _, _, _, info = env.step(env.actions.encode(moves=np.array([3, 4, 0])))
    assert info["move_ignored"].tolist() == [False, True, False]
    np.testing.assert_allclose(pose_of(env, observation), [45.0, 140.0, -110.0], atol=1e-4)


def test_a_clipped_level_shows_in_the_observation(make_env: Make) -> None:
    env = make_env(n_links=4, vertical=True)
    levels = np.array([3, 0, 3, 0])
    env.reset(seed=0)
    observation, _, _, _, info = env.step(env.actions.encode(levels=levels, duration=0))
    share = info["level_share"]
    np.testing.assert_allclose(env.layout.physical(observation, "level_share")[0], share, rtol=1e-6)
    torque = env.layout.physical(observation, "torque")[0]
    assert share[[1, 3]].tolist() == [1.0, 1.0]  # a held joint lacks nothing
    assert share.min() < 1
    assert (torque[[0, 2]] > 0).all() and not torque[[1, 3]].any()
    # Peaks of three times the rms stay within the limit.
    assert (torque * 3 <= 1 + 1e-6).all()


def layout(**settings: Any) -> ActionLayout:
    return ActionLayout(planar(3), DiagnosisSettings(**settings), hypotheses=7)


def split(actions: ActionLayout, mask: np.ndarray) -> list[np.ndarray]:
    return np.split(mask, np.cumsum(actions.nvec)[:-1])


@pytest.mark.parametrize("limits", [{}, {"max_excited": 1}, {"max_moved": 1, "max_excited": 2}])
def test_actions_survive_encoding(limits: dict[str, int]) -> None:
    actions = layout(**limits)
    rng = np.random.default_rng(0)
    for _ in range(200):
        found = actions.decode(rng.integers(actions.nvec))
        moved, excited = np.count_nonzero(found.moves != 2), np.count_nonzero(found.levels)
        assert moved <= limits.get("max_moved", 3)
        assert 1 <= excited <= limits.get("max_excited", 3)
        again = actions.decode(actions.encode(moves=found.moves, levels=found.levels, duration=0))
        assert again.moves.tolist() == found.moves.tolist()
        assert again.levels.tolist() == found.levels.tolist()


def test_more_joints_than_allowed_leave_the_highest_levels_and_the_first_moves() -> None:
    actions = layout(max_moved=1, max_excited=1)
    found = actions.decode(actions.encode(moves=np.array([2, 0, 4]), levels=np.array([1, 3, 2])))
    assert found.moves.tolist() == [2, 0, 2]
    assert found.levels.tolist() == [0, 3, 0]


def test_the_mask_knows_each_move_of_each_joint_and_asks_for_excitation() -> None:
    actions = layout(max_moved=1, max_excited=2)
    pose = np.radians([0.0, 149.0, 0.0])
    moves, first, second, *_ = split(actions, actions.mask(pose, 0, 0))
    assert len(moves) == 1 + 3 * 4
    # Joint 2 cannot go further up; all else it can, and so can the others.
    assert moves.tolist() == [True] * 5 + [True, True, False, False] + [True] * 4
    assert first.tolist() == [False] + [True] * 9
    assert second.all()


def test_actions_have_numbers() -> None:
    actions = layout(max_moved=1, max_excited=2)
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.integers(actions.nvec)
        assert action_of(actions, code_of(actions, action)).tolist() == action.tolist()
    assert code_of(actions, np.zeros(5, dtype=int)) == "0"
    for wrong in ("", "-1", "?", np.base_repr(int(np.prod(actions.nvec)), 36)):
        with pytest.raises(InvalidAction, match="not the number of an action"):
            action_of(actions, wrong)


def test_weaker_levels_leave_the_friction_of_the_seats() -> None:
    arm = six_axis()
    weak = arm.with_levels([1, 2]).with_levels((0.5,))
    assert (weak.levels, weak.top_level, arm.top_level) == ((0.5,), 4.0, 4.0)
    env: Any = gymnasium.make("loose_env/SixAxis-v1", levels=[1, 2], engine="reduced").unwrapped
    usual: Any = gymnasium.make("loose_env/SixAxis-v1", engine="reduced").unwrapped
    for made in (env, usual):
        made.reset(seed=3, options={"fault": "structural_looseness@link2"})
    assert env.batch.episode(0).fault == usual.batch.episode(0).fault
    assert env.action_space.nvec[6] == usual.action_space.nvec[6] - 1
