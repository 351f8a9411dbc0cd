"""Limits on the joints that are excited or moved at once, levels and gravity as arguments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import planar, six_axis, with_compliance
from loose_env.envs import ActionLayout, DiagnosisSettings, Difficulty, FaultSampler, Prices
from loose_env.errors import InvalidAction, InvalidSetting, UnknownName
from loose_env.registration import TIERS


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


def test_a_limit_no_lower_than_the_joints_changes_nothing() -> None:
    assert layout(max_moved=3, max_excited=3).nvec.tolist() == layout().nvec.tolist()
    with pytest.raises(InvalidSetting, match="max_excited"):
        DiagnosisSettings(max_excited=0)


@pytest.mark.parametrize("name", ["max_moved", "max_excited"])
def test_a_limit_above_the_joints_is_refused_with_what_is_allowed(name: str) -> None:
    with pytest.raises(InvalidSetting, match=f"{name} is 1 to 3 .* got 4"):
        layout(**{name: 4})
    with pytest.raises(InvalidSetting, match=f"{name} is 1 to 2"):
        gymnasium.make("loose_env/Vera-v0", **{name: 9})


def test_actions_have_numbers() -> None:
    actions = layout(max_moved=1, max_excited=2)
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.integers(actions.nvec)
        assert actions.from_code(actions.code(action)).tolist() == action.tolist()
    assert actions.code(np.zeros(5, dtype=int)) == "0"
    for wrong in ("", "-1", "?", np.base_repr(int(np.prod(actions.nvec)), 36)):
        with pytest.raises(InvalidAction, match="not the number of an action"):
            actions.from_code(wrong)


def test_a_moved_joint_has_its_price() -> None:
    env: Any = gymnasium.make(
        "loose_env/Planar-v0", n_links=2, engine="reduced", durations=(0.2,),
        prices=Prices(record=0.0, second=0.0, level=0.0, move=0.125),
    ).unwrapped  # fmt: skip
    env.reset(seed=0, options={"pose": [0.0, np.radians(149.0)]})
    action = env.actions.encode(moves=np.array([0, 4]), levels=np.array([1, 0]))
    _, reward, _, _, info = env.step(action)
    assert info["move_ignored"].tolist() == [False, True]  # it stayed, and cost nothing
    assert reward == -0.125


def test_weaker_levels_leave_the_friction_of_the_seats() -> None:
    arm = six_axis()
    weak = arm.with_levels([1, 2]).with_levels((0.5,))
    assert (weak.levels, weak.top_level, arm.top_level) == ((0.5,), 4.0, 4.0)
    env: Any = gymnasium.make("loose_env/SixAxis-v0", levels=[1, 2], engine="reduced").unwrapped
    usual: Any = gymnasium.make("loose_env/SixAxis-v0", engine="reduced").unwrapped
    for made in (env, usual):
        made.reset(seed=3, options={"fault": "structural_looseness@link2"})
    assert env.batch.episode(0).fault == usual.batch.episode(0).fault
    assert env.action_space.nvec[6] == usual.action_space.nvec[6] - 1
    for wrong in ([], [2, 1], [0.0, 1.0], ["a"], "12"):
        with pytest.raises(InvalidSetting, match="levels"):
            arm.with_levels(wrong)  # type: ignore[arg-type]


def test_gravity_is_an_argument_of_every_arm() -> None:
    env: Any = gymnasium.make("loose_env/Planar-v0", n_links=2, gravity=[0, -3.7, 0]).unwrapped
    assert env.arm.model.opt.gravity.tolist() == [0.0, -3.7, 0.0]
    assert np.abs(env.batch.nominal.at(np.zeros(2)).gravity_torque).max() > 1.0
    soft = with_compliance(planar(2), mode_hz=60.0).under_gravity((0, 0, 1))
    assert soft.rigid is not None
    assert soft.rigid.model.opt.gravity.tolist() == [0.0, 0.0, 1.0]
    for wrong in ((1.0, 2.0), (0, 0, np.nan), "xyz", 9.81):
        with pytest.raises(InvalidSetting, match="gravity"):
            planar(2).under_gravity(wrong)  # type: ignore[arg-type]


def test_friction_over_the_best_pose_is_that_much_larger() -> None:
    from loose_env.arms import LinearArm

    linear = LinearArm(planar(2))
    seats = [
        FaultSampler(linear, Difficulty(friction_over=over)).draw(
            np.random.default_rng(1), hypothesis="structural_looseness@link2"
        )
        for over in ("median", "best")
    ]
    assert seats[0].friction < seats[1].friction  # type: ignore[union-attr]
    with pytest.raises(UnknownName, match="friction_over"):
        Difficulty(friction_over="mean")  # type: ignore[arg-type]


@pytest.mark.parametrize("tier", TIERS)
def test_tiers_are_environments_of_their_arms(tier: str) -> None:
    of, arguments = TIERS[tier]
    env: Any = gymnasium.make(tier, engine="reduced").unwrapped
    same: Any = gymnasium.make(of, engine="reduced", **arguments).unwrapped
    first, other = (made.reset(seed=5)[0] for made in (env, same))
    assert np.array_equal(first, other)
    action = env.actions.encode(levels=np.eye(env.arm.n, dtype=int)[0])
    assert np.array_equal(env.step(action)[0], same.step(action)[0])
    assert gymnasium.make(tier, max_records=3).unwrapped.settings.max_records == 3  # type: ignore[attr-defined]
