"""The vector form: many arms stepped together, episodes that start anew by themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.registration import IDS

MakeEnv = Callable[..., DiagnosisEnv]
MakeVector = Callable[..., DiagnosisVectorEnv]


def going_on(env: DiagnosisVectorEnv) -> NDArray[np.int64]:
    """A short record in every environment."""
    levels = np.ones(env.arm.n, dtype=int)
    return np.stack([env.actions.encode(levels=levels, duration=0)] * env.num_envs)


def deciding(env: DiagnosisVectorEnv, which: list[int]) -> NDArray[np.int64]:
    """A verdict in some environments, a short record in the others."""
    actions = going_on(env)
    actions[which, -1] = 1
    return actions


@pytest.mark.parametrize("env_id", IDS)
def test_make_vec_gives_the_native_form(env_id: str) -> None:
    env = gymnasium.make_vec(f"loose_env:{env_id}", num_envs=3, threads=1)
    assert isinstance(env, DiagnosisVectorEnv)
    assert env.num_envs == 3
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.action_space.sample() in env.action_space
    assert env.single_action_space == env.actions.space
    env.close()


def test_arguments_reach_the_vector_form() -> None:
    env = gymnasium.make_vec(
        "loose_env:loose_env/Planar-v0",
        num_envs=2,
        n_links=5,
        vertical=True,
        hold="servo",
        difficulty="easy",
        max_records=3,
        raw=True,
        threads=1,
    )
    assert isinstance(env, DiagnosisVectorEnv)
    assert (env.arm.n, env.arm.name, env.arm.hold) == (5, "planar5v-servo", "servo")
    assert (env.settings.difficulty, env.settings.max_records) == ("easy", 3)
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"statistics", "command", "encoder", "tool"}
    assert observation in env.observation_space
    assert env.step(going_on(env))[0] in env.observation_space
    env.close()


def test_an_ended_episode_starts_anew_in_the_same_step(make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=3)
    env.reset(seed=0)
    before = env.step(going_on(env))[0]
    observation, rewards, terminated, truncated, infos = env.step(deciding(env, [1]))
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert abs(rewards[1]) == 1.0

    # The observation is the new episode's first one; that of the ended one is kept.
    assert not env.layout.slots_of(observation)[1].any()
    assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [False, True, False]
    assert [o is None for o in infos["final_obs"]] == [True, False, True]
    np.testing.assert_array_equal(infos["final_obs"][1], before[1])
    assert infos["final_info"]["records"][1] == 1
    assert infos["final_info"]["is_success"][1] == (rewards[1] == 1.0)

    # The others have gone on.
    valid = env.layout.physical(observation, "valid")[:, :2, 0]
    assert valid.tolist() == [[1, 1], [0, 0], [1, 1]]
    # And the new episode runs.
    observation, _, terminated, _, infos = env.step(going_on(env))
    assert not terminated.any() and "final_obs" not in infos
    valid = env.layout.physical(observation, "valid")[:, :3, 0]
    assert valid.tolist() == [[1, 1, 1], [1, 0, 0], [1, 1, 1]]


def test_masks_are_those_of_the_episodes_that_run_now(make_vector: MakeVector) -> None:
    env = make_vector(n_links=3, num_envs=3)
    _, infos = env.reset(seed=0)
    for actions in (going_on(env), deciding(env, [0, 2]), going_on(env)):
        np.testing.assert_array_equal(env.action_masks(), infos["action_mask"])
        assert infos["_action_mask"].all()
        infos = env.step(actions)[-1]
    assert env.action_masks().shape == (3, env.single_action_space.nvec.sum())
    unsure, named = slice(-1, None), slice(-2 * 3 - 1, -1)
    infos = env.step(deciding(env, [1]))[-1]
    assert infos["action_mask"][:, named].all(axis=1).tolist() == [True, False, True]
    # "unsure" waits for the third record, of which the first and third arm have taken two or three
    records = [episode.records for episode in map(env.batch.episode, range(3))]
    assert infos["action_mask"][:, unsure].all(axis=1).tolist() == [r >= 3 for r in records]


def test_infos_of_a_step_are_those_of_the_single_form(
    make_env: MakeEnv, make_vector: MakeVector
) -> None:
    batch, single = make_vector(n_links=2, num_envs=2), make_env(n_links=2)
    batch.reset(seed=[3, 4])
    single.reset(seed=4)
    for actions in (going_on(batch), deciding(batch, [1])):
        *_, infos = batch.step(actions)
        info = single.step(actions[1])[-1]
        found = infos.get("final_info", infos)
        for key, value in info.items():
            np.testing.assert_array_equal(found[key][1], value, err_msg=key)
            assert found[f"_{key}"][1]


@pytest.mark.parametrize("raw", [False, True])
def test_records_of_different_length_can_be_taken_together(
    make_vector: MakeVector, raw: bool
) -> None:
    env = make_vector(n_links=2, num_envs=3, raw=raw)
    env.reset(seed=0)
    actions = going_on(env)
    actions[:, -2] = [0, 2, 1]
    actions[2, 2:4] = 0  # which excites the last joint
    observation = env.step(actions)[0]
    assert observation in env.observation_space
    flat = observation["statistics"] if raw else observation
    seen = env.layout.physical(flat, "duration")[:, 0, 0]
    np.testing.assert_allclose(seen, [0.2, 1.2, 0.4], rtol=1e-6)


def test_arms_that_measure_do_so_together(
    make_vector: MakeVector, spy_on: Callable[..., Any]
) -> None:
    env = make_vector(n_links=2, num_envs=4)
    spy = spy_on(env)
    env.reset(seed=0)
    env.step(going_on(env))
    assert (spy.calls, len(spy.jobs)) == (1, 4)
    env.step(deciding(env, [0, 1]))
    assert (spy.calls, [job.slot for job in spy.jobs[4:]]) == (2, [2, 3])


# ---- reset


def test_a_reset_mask_begins_the_chosen_episodes_only(make_vector: MakeVector) -> None:
    env, untouched = (make_vector(n_links=2, num_envs=3) for _ in range(2))
    for e in (env, untouched):
        e.reset(seed=0)
        before = e.step(going_on(e))[0]
    mask = np.array([True, False, True])
    observation, infos = env.reset(options={"reset_mask": mask})
    assert not env.layout.slots_of(observation)[mask].any()
    np.testing.assert_array_equal(observation[1], before[1])
    np.testing.assert_array_equal(infos["_action_mask"], mask)
    # The episode that was left alone goes on as if nothing had happened.
    after, expected = env.step(going_on(env))[0], untouched.step(going_on(untouched))[0]
    np.testing.assert_array_equal(after[1], expected[1])


def test_a_reset_mask_takes_seeds_and_options(make_env: MakeEnv, make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=3)
    env.reset(seed=0)
    options = {"reset_mask": np.array([False, True, False]), "fault": "backlash@joint2"}
    observation, _ = env.reset(seed=[50, 60, 70], options=options)
    single = make_env(n_links=2)
    np.testing.assert_array_equal(observation[1], single.reset(seed=60)[0])
    faults = [env.batch.episode(i).fault.hypothesis for i in range(3)]  # type: ignore[union-attr]
    assert faults[1] == "backlash@joint2"
    np.testing.assert_array_equal(observation[0], single.reset(seed=0)[0])


def test_options_reach_every_environment_and_hold_for_one_episode(make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=8)
    env.reset(seed=0, options={"fault": "structural_looseness@link1", "pose": [0.5, 1.0]})
    observation = env.step(going_on(env))[0]
    np.testing.assert_allclose(
        env.layout.physical(observation, "now.sin_pose"), [np.sin([0.5, 1.0])] * 8, atol=1e-6
    )
    infos = env.step(deciding(env, list(range(8))))[-1]
    assert set(infos["final_info"]["fault"]) == {"structural_looseness@link1"}
    env.step(going_on(env))
    infos = env.step(deciding(env, list(range(8))))[-1]
    assert len(set(infos["final_info"]["fault"])) > 1


def test_seeds_are_one_for_each_environment(make_env: MakeEnv, make_vector: MakeVector) -> None:
    env, single = make_vector(n_links=2, num_envs=3), make_env(n_links=2)
    for seeds in ([5, 3, 5], (5, 3, 5), np.array([5, 3, 5])):
        observation, _ = env.reset(seed=seeds)
        for row, seed in zip(observation, [5, 3, 5], strict=True):
            np.testing.assert_array_equal(row, single.reset(seed=seed)[0])


def test_a_seed_left_out_lets_the_environment_go_on(
    make_env: MakeEnv, make_vector: MakeVector
) -> None:
    env, single = make_vector(n_links=2, num_envs=2), make_env(n_links=2)
    env.reset(seed=[5, 6])
    observation, _ = env.reset(seed=[9, None])
    single.reset(seed=6)
    np.testing.assert_array_equal(observation[1], single.reset()[0])


def test_observations_are_not_written_over(make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=2)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second = env.step(going_on(env))[0]
    kept_second = second.copy()
    env.step(deciding(env, [0, 1]))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(second, kept_second)
