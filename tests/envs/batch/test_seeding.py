"""The same seed is the same episode, whatever runs beside it, before it or is done in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.envs.actions import ActionLayout
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.vector_env import DiagnosisVectorEnv, batch_seeds
from loose_env.rig import Measurement

MakeEnv = Callable[..., DiagnosisEnv]
MakeVector = Callable[..., DiagnosisVectorEnv]
RECORDS = 2
NAMES = ["planar", "vera", "six_axis", "scara", "desk"]

Episode = list[Any]
"""First observation, then observation, reward and ends of every step, then the truth."""


def plan(layout: ActionLayout, seed: int, number: int) -> list[NDArray[np.int64]]:
    """What is done in an episode: two records and a verdict, different from episode to episode."""
    rng = np.random.default_rng([seed, number])
    n = layout.arm.n
    actions = [
        layout.encode(
            moves=rng.integers(0, 5, n), levels=rng.integers(1, 4, n), duration=rng.integers(0, 2)
        )
        for _ in range(RECORDS)
    ]
    return [*actions, layout.encode(verdict=1 + number % 2)]


def play_single(env: DiagnosisEnv, seed: int, episodes: int) -> list[Episode]:
    found = []
    for number in range(episodes):
        episode: Episode = [env.reset(seed=seed if number == 0 else None)[0]]
        for action in plan(env.actions, seed, number):
            observation, reward, terminated, truncated, info = env.step(action)
            episode.append((observation, reward, terminated, truncated))
        episode.append(info["fault_figures"])
        found.append(episode)
    return found


def play_vector(
    env: DiagnosisVectorEnv, seeds: list[int], episodes: int, **reset: Any
) -> list[list[Episode]]:
    """Play on with autoreset; episodes of every environment."""
    observation, _ = env.reset(**(reset or {"seed": seeds}))
    found: list[list[Episode]] = [[] for _ in seeds]
    for number in range(episodes):
        running: list[Episode] = [[observation[i]] for i in range(len(seeds))]
        plans = [plan(env.actions, seed, number) for seed in seeds]
        for step in range(RECORDS + 1):
            actions = np.stack([p[step] for p in plans])
            observation, rewards, terminated, truncated, infos = env.step(actions)
            for i, episode in enumerate(running):
                seen = infos["final_obs"][i] if terminated[i] else observation[i]
                episode.append((seen, rewards[i], terminated[i], truncated[i]))
        for i, episode in enumerate(running):
            episode.append(infos["final_info"]["fault_figures"][i])
            found[i].append(episode)
    return found


def assert_same(found: list[Episode], expected: list[Episode]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        for step, other_step in zip(one[1:-1], other[1:-1], strict=True):
            for x, y in zip(step, other_step, strict=True):
                np.testing.assert_array_equal(x, y)
        assert one[-1] == other[-1]


# ---- the same seed


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_is_the_same_run_of_episodes(make_env: MakeEnv, name: str) -> None:
    first = play_single(make_env(name), 7, 3)
    assert_same(play_single(make_env(name), 7, 3), first)
    # The episodes of one run differ from each other.
    assert len({episode[0].tobytes() for episode in first}) == 3


def test_what_ran_before_changes_nothing(make_env: MakeEnv) -> None:
    expected = play_single(make_env(n_links=3), 7, 2)
    env = make_env(n_links=3)
    play_single(env, 8, 3)
    env.reset(seed=9, options={"fault": "backlash@joint1", "pose": np.zeros(3)})
    env.step(env.actions.encode(levels=np.array([3, 3, 3])))
    assert_same(play_single(env, 7, 2), expected)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("num_envs", "threads"), [(1, 1), (3, 2), (8, 1), (8, 3)])
def test_a_batch_plays_the_episodes_of_its_seeds_at_any_size_and_thread_count(
    make_env: MakeEnv, make_vector: MakeVector, name: str, num_envs: int, threads: int
) -> None:
    # Second and third episodes come from autoreset here and from reset() in the single form.
    seeds = [40 + 3 * i for i in range(num_envs)]
    found = play_vector(make_vector(name, num_envs=num_envs, threads=threads), seeds, 3)
    for i in {0, num_envs // 2, num_envs - 1}:
        assert_same(found[i], play_single(make_env(name), seeds[i], 3))


def test_a_batch_too_large_for_one_go_plays_the_same_episodes(
    make_env: MakeEnv, make_vector: MakeVector
) -> None:
    seeds = list(range(37))
    found = play_vector(make_vector(n_links=2, num_envs=37, threads=2), seeds, 2)
    for i in (0, 15, 16, 31, 32, 36):
        assert_same(found[i], play_single(make_env(n_links=2), seeds[i], 2))


def test_one_seed_for_a_batch_is_spread(make_env: MakeEnv, make_vector: MakeVector) -> None:
    seeds = batch_seeds(12, 3)
    found = play_vector(make_vector(n_links=2, num_envs=3), seeds, 2, seed=12)
    for i, seed in enumerate(seeds):
        assert_same(found[i], play_single(make_env(n_links=2), seed, 2))


def test_seeding_again_starts_the_run_again(make_env: MakeEnv, make_vector: MakeVector) -> None:
    single, batch = make_env(n_links=2), make_vector(n_links=2, num_envs=2)
    expected = play_single(single, 5, 2)
    assert_same(play_single(single, 5, 2), expected)
    for _ in range(2):
        assert_same(play_vector(batch, [4, 5], 2)[1], expected)


def test_a_fault_drawn_by_name_depends_on_the_seed_alone(make_env: MakeEnv) -> None:
    env = make_env(n_links=3)
    drawn = []
    for seed in (1, 2, 1):
        env.reset(seed=seed, options={"fault": "structural_looseness@link2"})
        drawn.append(env.batch.episode(0).fault)  # type: ignore[union-attr]
    assert drawn[0] == drawn[2] != drawn[1]


def test_options_disturb_no_other_draw(make_env: MakeEnv) -> None:
    # The same true arm and the same pose, with another fault in it.
    env = make_env(n_links=2)
    poses, arms = [], []
    for options in (None, {"fault": "healthy"}, {"fault": "backlash@joint2"}):
        observation, _ = env.reset(seed=4, options=options)
        poses.append(observation)
        arms.append(env.batch.rig.plants[0].mismatch)  # type: ignore[attr-defined]
    for pose, arm in zip(poses, arms, strict=True):
        np.testing.assert_array_equal(pose, poses[0])
        for field, value in vars(arm).items():
            np.testing.assert_array_equal(value, getattr(arms[0], field))


# ---- different seeds


def test_different_seeds_hide_different_arms_in_different_poses(make_env: MakeEnv) -> None:
    env = make_env(n_links=3)
    first, shaken, faults = set(), set(), set()
    for seed in range(30):
        first.add(env.reset(seed=seed)[0].tobytes())
        faults.add(env.batch.episode(0).fault)  # type: ignore[union-attr]
        shaken.add(env.step(env.actions.encode(levels=np.ones(3), duration=0))[0].tobytes())
    assert len(first) == len(shaken) == 30
    healthy = any(fault.kind == "healthy" for fault in faults)
    assert healthy and len(faults) > 10


def test_without_a_seed_every_environment_goes_its_own_way(
    make_env: MakeEnv, make_vector: MakeVector
) -> None:
    assert not np.array_equal(make_env(n_links=2).reset()[0], make_env(n_links=2).reset()[0])
    observation, _ = make_vector(n_links=2, num_envs=3).reset()
    assert len(np.unique(observation, axis=0)) == 3


# ---- what is done in the episode


def last(env: DiagnosisEnv) -> Measurement:
    episode = env.batch.episode(0)
    assert episode is not None and episode.last is not None
    return episode.last


def test_the_excitation_of_a_record_does_not_depend_on_what_was_done_before(
    make_env: MakeEnv,
) -> None:
    env = make_env(n_links=3)
    encode = env.actions.encode
    before = [
        [encode(), encode()],
        [encode(levels=np.array([3, 0, 0]), duration=2), encode()],
        [encode(moves=np.array([0, 1, 3]), levels=np.array([1, 2, 3]), duration=1)] * 2,
    ]
    played, readings = [], []
    for actions in before:
        env.reset(seed=6)
        for action in actions:
            env.step(action)
        env.step(encode(levels=np.array([1, 0, 1]), duration=0))
        measurement = last(env)
        torque = np.array(measurement.excitation.torque_rms)[[0, 2], None]
        played.append(measurement.command[[0, 2]] / torque)
        readings.append(measurement.tool)
    np.testing.assert_allclose(played[1:], np.stack([played[0]] * 2), rtol=1e-9, atol=1e-9)
    # In the same pose the readings are the same too, noise included.
    np.testing.assert_array_equal(readings[1], readings[0])


def test_the_excitation_of_a_joint_does_not_depend_on_the_others(make_env: MakeEnv) -> None:
    env = make_env(n_links=3)
    played = []
    for levels in ([0, 1, 0], [2, 1, 3]):
        env.reset(seed=6)
        env.step(env.actions.encode(levels=np.array(levels), duration=0))
        measurement = last(env)
        played.append(measurement.command[1] / measurement.excitation.torque_rms[1])
    np.testing.assert_allclose(played[1], played[0], rtol=1e-9, atol=1e-9)


def test_every_record_and_every_episode_has_an_excitation_of_its_own(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    commands = []
    for seed in (1, 2, None):  # None is the second episode of seed 2
        env.reset(seed=seed)
        for _ in range(3):
            env.step(env.actions.encode(levels=np.array([1, 0]), duration=0))
            command = last(env).command[0]
            commands.append(command / np.linalg.norm(command))
    correlation = np.array(commands) @ np.array(commands).T - np.eye(9)
    assert np.abs(correlation).max() < 0.6
