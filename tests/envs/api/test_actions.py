"""What the actions do, which of them make sense, and what the levels mean."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.arms import Mismatch
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.settings import Difficulty
from loose_env.faults import Healthy
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

MOVES = (-90, -45, 0, 45, 90)
DURATIONS = (0.2, 0.4, 1.2)


def pose_of(env: DiagnosisEnv, observation: NDArray[np.float32]) -> Array:
    """The pose that an observation shows [deg]."""
    sin, cos = (env.layout.physical(observation, f"now.{part}_pose") for part in ("sin", "cos"))
    return np.degrees(np.arctan2(sin, cos))


def valid(env: DiagnosisEnv, observation: NDArray[np.float32]) -> list[bool]:
    return [bool(v) for v in env.layout.physical(observation, "valid").ravel()]


def mask_parts(env: DiagnosisEnv, mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """The mask, one array for each entry of the action."""
    return np.split(mask, np.cumsum(env.actions.nvec)[:-1])


# ---- what stands where


@pytest.mark.parametrize(
    ("name", "arguments", "joints"),
    [("vera", {}, 2), ("planar", {}, 4), ("planar", {"n_links": 7, "vertical": True}, 7)],
)
def test_an_action_is_moves_then_levels_then_length_then_verdict(
    make_env: Callable[..., DiagnosisEnv], name: str, arguments: dict[str, Any], joints: int
) -> None:
    env = make_env(name, **arguments)
    hypotheses = 1 + 2 * joints
    assert env.action_space == spaces.MultiDiscrete(
        [5] * joints + [4] * joints + [3, 1 + hypotheses + 1]
    )


def test_each_joint_makes_the_move_its_entry_names(make_env: Callable[..., DiagnosisEnv]) -> None:
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


def test_all_joints_move_in_one_step(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env(n_links=3)
    env.reset(seed=0, options={"pose": np.radians([10.0, 20.0, -30.0])})
    observation = env.step(env.actions.encode(moves=np.array([4, 3, 1])))[0]
    np.testing.assert_allclose(pose_of(env, observation), [100.0, 65.0, -75.0], atol=1e-4)


def test_a_joint_without_limits_turns_all_the_way_round(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    env = make_env("vera")
    start = env.reset(seed=0)[0]
    action = env.actions.encode(moves=np.array([4, 0]))
    for _ in range(4):
        observation, _, _, _, info = env.step(action)
        assert not info["move_ignored"].any()
    np.testing.assert_allclose(pose_of(env, observation), pose_of(env, start), atol=1e-3)


def test_each_joint_is_shaken_at_the_level_its_entry_names(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    env = make_env(n_links=3, raw=True)
    for levels in ([0, 2, 0], [1, 0, 3], [3, 3, 3]):
        env.reset(seed=0)
        flat, _, _, _, info = env.step(env.actions.encode(levels=np.array(levels), duration=0))
        shaken = np.array(levels) > 0
        seen = env.layout.physical(flat["statistics"], "level")[0]
        np.testing.assert_allclose(seen, levels, rtol=1e-6)
        measurement = info["measurement"]
        np.testing.assert_array_equal(measurement.excited, shaken)
        np.testing.assert_array_equal(measurement.command.any(axis=1), shaken)


def test_a_higher_level_shakes_harder(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env("vera")
    env.reset(seed=1)
    motion = []
    for level in (1, 2, 3):
        env.step(env.actions.encode(levels=np.array([0, level]), duration=0))
        motion.append(np.std(env.batch.episode(0).last.tool))  # type: ignore[union-attr]
    assert motion == sorted(motion)


def test_a_record_is_as_long_as_its_entry_says(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env(n_links=2, raw=True)
    env.reset(seed=0)
    for k, seconds in enumerate(DURATIONS):
        action = env.actions.encode(levels=np.array([1, 0]), duration=k)
        observation, _, _, _, info = env.step(action)
        assert info["measurement"].tool.shape[1] == round(seconds * info["measurement"].rate)
        seen = env.layout.physical(observation["statistics"], "duration")[k]
        np.testing.assert_allclose(seen, seconds, rtol=1e-6)


# ---- joints that slide


def test_a_sliding_joint_goes_through_its_range_in_proportion(
    make_env: Callable[..., DiagnosisEnv],
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


def test_a_sliding_joint_stays_where_its_range_ends(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env("scara")
    _, info = env.reset(seed=0, options={"pose": [0.0, 0.0, -0.05, 0.0]})
    parts = mask_parts(env, info["action_mask"])
    assert parts[2].tolist() == [True, True, True, False, False]
    observation, _, _, _, info = env.step(env.actions.encode(moves=np.array([3, 2, 4, 2])))
    assert info["move_ignored"].tolist() == [False, False, True, False]
    found = env.layout.pose_of(observation)
    np.testing.assert_allclose(found, [np.pi / 4, 0.0, -0.05, 0.0], atol=1e-6)


def test_every_move_of_a_mask_stays_in_range(make_env: Callable[..., DiagnosisEnv]) -> None:
    for name in ("six_axis", "scara", "desk"):
        env = make_env(name, max_records=40)
        rng = np.random.default_rng(0)
        _, info = env.reset(seed=1)
        for _ in range(40):
            parts = mask_parts(env, info["action_mask"])[: env.arm.n]
            moves = np.array([rng.choice(np.flatnonzero(part)) for part in parts])
            info = env.step(env.actions.encode(moves=moves))[-1]
            assert not info["move_ignored"].any()
            pose = env.batch.episode(0).pose  # type: ignore[union-attr]
            assert env.arm.within_ranges(pose).all()


# ---- verdicts and records without excitation


def test_verdict_k_names_hypothesis_k(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env("vera")
    assert env.hypotheses == (
        "healthy",
        "structural_looseness@link1",
        "structural_looseness@link2",
        "backlash@joint1",
        "backlash@joint2",
    )
    for k, name in enumerate(env.hypotheses, start=1):
        env.reset(seed=k, options={"fault": name})
        env.step(env.actions.encode())
        _, reward, terminated, truncated, info = env.step(env.actions.encode(verdict=k))
        assert (reward, terminated, truncated) == (1.0, True, False)
        assert info["verdict"] == info["fault"] == name


def test_with_a_verdict_nothing_is_measured_and_the_rest_is_ignored(
    make_env: Callable[..., DiagnosisEnv], spy_on: Callable[..., Any]
) -> None:
    env = make_env(n_links=3)
    spy = spy_on(env)
    env.reset(seed=0, options={"fault": "healthy"})
    before = env.step(env.actions.encode(levels=np.array([0, 1, 0]), duration=0))[0]
    action = env.actions.encode(
        moves=np.array([0, 4, 1]), levels=np.array([3, 3, 3]), duration=2, verdict=1
    )
    after, reward, terminated, _, info = env.step(action)
    assert len(spy.jobs) == 1
    assert (reward, terminated, info["records"]) == (1.0, True, 1)
    np.testing.assert_array_equal(after, before)


def test_with_every_joint_off_the_last_one_is_excited(
    make_env: Callable[..., DiagnosisEnv], spy_on: Callable[..., Any]
) -> None:
    env = make_env(n_links=2, max_records=4)
    spy = spy_on(env)
    found = []
    for levels in ((0, 0), (0, 3)):
        env.reset(seed=0, options={"pose": np.zeros(2)})
        action = env.actions.encode(moves=np.array([4, 3]), levels=np.array(levels), duration=0)
        found.append(env.step(action)[:2])
    assert [job.excitation.excited for job in spy.jobs] == [(False, True)] * 2
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1] == pytest.approx(-(0.05 + 0.2 * 0.02 + 3 * 0.002))


# ---- masks


@pytest.mark.parametrize("name", ["planar", "vera"])
def test_the_mask_has_an_entry_for_every_choice_and_is_the_one_in_info(
    make_env: Callable[..., DiagnosisEnv], name: str
) -> None:
    env = make_env(name, max_records=3)
    _, info = env.reset(seed=0)
    masks = [info["action_mask"]]
    np.testing.assert_array_equal(env.action_masks(), masks[-1])
    for action in (env.actions.encode(),) * 3 + (env.actions.encode(verdict=1),):
        info = env.step(action)[-1]
        masks.append(info["action_mask"])
        np.testing.assert_array_equal(env.action_masks(), masks[-1])
    for mask in masks:
        assert mask.dtype == bool
        assert mask.shape == (env.action_space.nvec.sum(),)
        # Every entry has at least one choice left.
        assert all(part.any() for part in mask_parts(env, mask))


def test_moves_past_a_joint_limit_are_masked(make_env: Callable[..., DiagnosisEnv]) -> None:
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


def test_joints_without_limits_may_always_move(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env("vera")
    for seed in range(10):
        _, info = env.reset(seed=seed)
        assert info["action_mask"][:10].all()


def test_verdicts_wait_for_the_first_record_and_going_on_ends_with_the_last(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    env = make_env(n_links=2, max_records=2)
    _, info = env.reset(seed=0)
    seen = [mask_parts(env, info["action_mask"])[-1].tolist()]
    for _ in range(2):
        info = env.step(env.actions.encode())[-1]
        seen.append(mask_parts(env, info["action_mask"])[-1].tolist())
    assert seen == [[True] + [False] * 6, [True] * 6 + [False], [False] + [True] * 6]


def test_levels_and_lengths_are_never_masked(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env(n_links=3, max_records=1)
    for mask in (env.reset(seed=0)[1], env.step(env.actions.encode())[-1]):
        assert all(part.all() for part in mask_parts(env, mask["action_mask"])[3:-1])


def test_a_joint_told_to_pass_its_limit_stays_and_the_others_move(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    env = make_env(n_links=3)
    env.reset(seed=0, options={"pose": np.radians([0.0, 140.0, -20.0])})
    observation, _, _, _, info = env.step(env.actions.encode(moves=np.array([3, 4, 0])))
    assert info["move_ignored"].tolist() == [False, True, False]
    np.testing.assert_allclose(pose_of(env, observation), [45.0, 140.0, -110.0], atol=1e-4)


def test_a_verdict_before_the_first_record_is_ignored(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    env = make_env(n_links=2)
    levels = np.array([0, 1])
    env.reset(seed=0)
    early, reward, terminated, truncated, info = env.step(
        env.actions.encode(levels=levels, duration=0, verdict=3)
    )
    assert info["verdict_ignored"] and not terminated and not truncated
    env.reset(seed=0)
    plain, plain_reward, _, _, info = env.step(env.actions.encode(levels=levels, duration=0))
    assert not info["verdict_ignored"]
    assert reward == plain_reward
    np.testing.assert_array_equal(early, plain)


def test_going_on_after_the_last_record_ends_the_episode(
    make_env: Callable[..., DiagnosisEnv], spy_on: Callable[..., Any]
) -> None:
    env = make_env(n_links=2, max_records=1)
    spy = spy_on(env)
    env.reset(seed=0)
    action = env.actions.encode(levels=np.array([1, 0]), duration=0)
    assert env.step(action)[2:4] == (False, False)
    assert env.step(action)[2:4] == (True, False)
    assert len(spy.jobs) == 1


def test_a_masked_policy_takes_the_masks(
    make_env: Callable[..., DiagnosisEnv], tmp_path: Path
) -> None:
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
    from stable_baselines3.common.logger import configure

    env = make_env(n_links=2, max_records=3)
    assert is_masking_supported(env)
    model = MaskablePPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0)
    model.set_logger(configure(str(tmp_path), []))  # by itself it would write beside the tests
    model.learn(32)
    for seed in range(10):
        observation, info = env.reset(seed=seed)
        masks = get_action_masks(env)
        np.testing.assert_array_equal(masks, info["action_mask"])
        for _ in range(5):
            action, _ = model.predict(observation, action_masks=masks)
            chosen = zip(mask_parts(env, masks), action, strict=True)
            assert all(part[choice] for part, choice in chosen)


# ---- what a level means


NOMINAL = Difficulty(mismatch=Mismatch().scaled(0.0))
"""True arms equal to the nominal one."""


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("planar", {"n_links": 3}),
        ("planar", {"n_links": 3, "vertical": True}),
        ("planar", {"n_links": 3, "hold": "servo"}),
        ("vera", {}),
        ("six_axis", {}),
        ("scara", {}),
        ("desk", {}),
    ],
    ids=["planar", "vertical", "servo", "vera", "six_axis", "scara", "desk"],
)
def test_a_level_is_the_rms_acceleration_of_the_nominal_tool_and_its_share_of_it_where_clipped(
    make_env: Callable[..., DiagnosisEnv], name: str, arguments: dict[str, Any]
) -> None:
    env = make_env(
        name,
        **arguments,
        difficulty=NOMINAL,
        sensors=SensorSuite.ideal(),
        raw=True,
        max_records=150,
    )
    env.reset(seed=0, options={"fault": Healthy()})
    rng = np.random.default_rng(1)
    n = env.arm.n
    reached: dict[bool, list[float]] = {True: [], False: []}
    for k in range(150):
        if min(len(found) for found in reached.values()) >= 6:
            break
        levels, level, joint = np.zeros(n, dtype=int), 2 + k % 2, k // 2 % n
        levels[joint] = level
        action = env.actions.encode(moves=rng.integers(0, 5, n), levels=levels, duration=2)
        info = env.step(action)[-1]
        share = info["level_share"][joint]
        rms = np.sqrt(info["measurement"].tool.var(axis=1).sum())
        reached[share < 1].append(rms / (share * env.arm.levels[level - 1]))
    for found in reached.values():
        # One record of 1.2 s scatters by 5 %.
        assert len(found) >= 6
        assert np.sqrt(np.mean(np.square(found))) == pytest.approx(
            1.0, abs=4 * 0.05 / np.sqrt(len(found))
        )


def test_a_clipped_level_shows_in_the_observation(make_env: Callable[..., DiagnosisEnv]) -> None:
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
