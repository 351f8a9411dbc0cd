"""Every registered id: the checkers find nothing, arguments arrive, all forms play alike."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import loose_env
from loose_env.arms import planar
from loose_env.envs import DiagnosisEnv, DiagnosisSettings, DiagnosisVectorEnv, batch_seeds
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.registration import IDS, TIERS

ROOT = Path(__file__).resolve().parents[2]
SHORT: dict[str, Any] = {"durations": (0.1,), "max_records": 3, "threads": 1}
FORMS: list[Any] = [
    *((env_id, {}) for env_id in IDS),
    *(pytest.param(tier, {}, marks=pytest.mark.slow) for tier in TIERS),
    ("loose_env/Vera-v0", {"hold": "servo", "difficulty": "hard"}),
    ("loose_env/Planar-v0", {"n_links": 2, "vertical": True, "difficulty": "easy"}),
    ("loose_env/Planar-v0", {"n_links": 7, "hold": "servo"}),
    ("loose_env/Planar-v0", {"n_links": 2, "hold": "compliant"}),
    ("loose_env/Arm-v1", {"joints": ["base", "elbow"], "tool": "hand"}),
]

FEW = [IDS[0], *(pytest.param(env_id, marks=pytest.mark.slow) for env_id in IDS[1:])]
"""One id in every run, the others before a release."""


@pytest.fixture(autouse=True)
def no_warning_is_let_through() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(("env_id", "arguments"), FORMS)
def test_the_checkers_find_nothing_and_whole_episodes_run(
    env_id: str, arguments: dict[str, Any]
) -> None:
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    # make() puts Gymnasium's passive checker and its order checker around the environment.
    env = gymnasium.make(env_id, **{**SHORT, **arguments})
    check_env(env.unwrapped, skip_render_check=True)
    check_for_sb3(env.unwrapped)
    env.action_space.seed(0)
    env.reset(seed=0)
    ended = 0
    for _ in range(16):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
            ended += 1
    assert ended > 1
    env.close()


@pytest.mark.parametrize("env_id", FEW)
def test_raw_signals_pass_the_checker_and_measurements_compare_by_value(env_id: str) -> None:
    env: Any = gymnasium.make(env_id, raw=True, **SHORT).unwrapped
    check_env(env, skip_render_check=True)
    taken = []
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        action = env.actions.encode(levels=np.ones(env.arm.n, dtype=int))
        taken.append(env.step(action)[-1]["measurement"])
    assert taken[0] == taken[1] != taken[2]
    assert taken[0] is not taken[1]


@pytest.mark.slow
def test_a_fresh_process_makes_every_id_without_importing_the_package() -> None:
    code = (
        "import sys, gymnasium\n"
        "assert 'loose_env' not in sys.modules\n"
        f"for env_id in {IDS}:\n"
        "    for make in (gymnasium.make, gymnasium.make_vec):\n"
        "        env = make('loose_env:' + env_id)\n"
        "        env.reset(seed=0)\n"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_ids_are_registered_once_and_without_a_limit_of_steps() -> None:
    assert set(IDS) | set(TIERS) <= set(gymnasium.registry)
    loose_env.register()  # once more does no harm
    for env_id in (*IDS, *TIERS):
        spec = gymnasium.spec(env_id)
        assert spec.max_episode_steps is None  # else a batch could not tell who asked for it
        assert spec.reward_threshold is None or 0 < spec.reward_threshold < 1


@pytest.mark.parametrize("most", [3, 16])
def test_an_episode_ends_by_itself_after_the_last_record(most: int) -> None:
    made = {"n_links": 2, "durations": (0.1,), "max_records": most}
    env: Any = gymnasium.make("loose_env/Planar-v0", **made)  # type: ignore[arg-type]
    batch: Any = gymnasium.make_vec("loose_env/Planar-v0", 1, max_episode_steps=14, **made)
    env.reset(seed=0)
    batch.reset(seed=0)
    record = env.unwrapped.actions.encode(levels=np.array([0, 1]))
    for step in range(most + 1):
        *_, terminated, truncated, _ = env.step(record)
        assert (terminated, truncated) == (step == most, False)
        if step <= min(most, 13):
            assert batch.step(record[None])[3].tolist() == [step == 13]


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_a_batch_obeys_a_limit_of_steps_as_a_single_environment_does(mode: str) -> None:
    made = {"n_links": 2, "durations": (0.1,), "max_episode_steps": 2}
    single = gymnasium.make("loose_env/Planar-v0", **made)  # type: ignore[arg-type]
    batch: Any = gymnasium.make_vec("loose_env/Planar-v0", 2, autoreset_mode=mode, **made)
    record = batch.actions.encode(levels=[0, 1])
    single.reset(seed=3)
    batch.reset(seed=3)
    for cut in (False, True):
        seen, _, _, truncated, _ = single.step(record)
        found, _, _, every, infos = batch.step(np.stack([record] * 2))
        assert (truncated, every.tolist()) == (cut, [cut] * 2)
    last = infos["final_obs"] if mode == "SameStep" else found
    np.testing.assert_array_equal(last[0], seen)
    assert not batch.step(np.stack([record] * 2))[3].any()
    for wrong in (-1, 0, 1.5, float("nan"), "x"):
        with pytest.raises(InvalidSetting, match="max_episode_steps must be 1 or more"):
            gymnasium.make_vec("loose_env/Planar-v0", max_episode_steps=wrong)


def test_arguments_reach_single_and_vector_environments() -> None:
    arguments = {"n_links": 5, "vertical": True, "hold": "servo", "difficulty": "easy", "raw": True}
    for make in (gymnasium.make, gymnasium.make_vec):
        env: Any = make("loose_env/Planar-v0", max_records=3, **arguments).unwrapped
        assert (env.arm.n, env.arm.name, env.arm.hold) == (5, "planar5v-servo", "servo")
        assert (env.settings.difficulty, env.settings.max_records) == ("easy", 3)
        observation, _ = env.reset(seed=0)
        assert set(observation) == {"statistics", "command", "encoder", "tool"}
        assert observation in env.observation_space
        env = make("loose_env/Planar-v0", durations=[0.2], kinds=["backlash", "healthy"]).unwrapped
        assert (env.settings.durations, env.settings.kinds) == ((0.2,), ("healthy", "backlash"))
        assert env.settings == DiagnosisSettings(
            durations=np.array([0.2]), kinds=env.settings.kinds
        )  # type: ignore[arg-type]
        env = make("loose_env/SearchTier-v0", prices={"record": 0.2}).unwrapped
        assert (env.arm.n, env.settings.max_moved, env.settings.prices.record) == (7, 1, 0.2)
        assert env.settings.difficulty.kinds == {"healthy": 0.125, "structural_looseness": 0.875}
        for wrong, words in (
            ({"prices": {"recor": 1}}, "unknown prices"),
            ({"difficulty": {"gap": 3}}, "gap"),
        ):
            with pytest.raises((UnknownName, InvalidData), match=words):
                make("loose_env/Planar-v0", **wrong)
    arms = (("vera", 2), ("planar4", 4), ("six_axis", 6), ("scara", 4), ("desk_arm", 6))
    for env_id, (name, joints) in zip(IDS, arms, strict=True):
        env = gymnasium.make(env_id).unwrapped
        assert (env.arm.name, env.arm.n, env.arm.hold) == (name, joints, "brake")
    for env_id in (own for own in (*IDS, *TIERS) if own.endswith("-v1")):
        with pytest.raises(gymnasium.error.DeprecatedEnv, match=f"use `{env_id}` instead"):
            gymnasium.spec(env_id.replace("-v1", "-v0"))


# ---- stable-baselines3


def adapted(num: int, env_id: str = "loose_env/Planar-v0", **arguments: Any) -> tuple[Any, Any]:
    from loose_env.envs.sb3 import Sb3VecEnv

    own = {"n_links": 2} if env_id == "loose_env/Planar-v0" else {}
    env = gymnasium.make_vec(env_id, num_envs=num, **{**SHORT, **own, **arguments})
    return env, Sb3VecEnv(env)  # type: ignore[arg-type]


@pytest.mark.parametrize("env_id", ["loose_env/Planar-v0", "loose_env/SixAxis-v1"])
def test_an_ended_episode_hands_over_its_last_observation_and_the_next_first_one(
    env_id: str,
) -> None:
    _, vec = adapted(2, env_id)
    vec.seed(5)
    vec.reset()
    single = vec.env.batch.arm
    single = DiagnosisEnv(single, vec.env.settings)
    single.reset(seed=5)
    shake = single.actions.encode(levels=3 * np.eye(single.arm.n, dtype=int)[-1])
    total = 0.0
    for action in (shake, single.actions.encode(verdict=1)):
        last, reward, _, _, info = single.step(action)
        total += float(reward)
        seen, rewards, dones, infos = vec.step(np.stack([action, shake]))
    assert dones.tolist() == [True, False]
    assert np.array_equal(infos[0]["terminal_observation"], last)
    assert infos[0]["fault"] == info["fault"] and "fault" not in infos[1]
    assert infos[0]["TimeLimit.truncated"] is False
    assert infos[0]["episode"] == {"r": pytest.approx(total), "l": 2}
    assert rewards[0] == pytest.approx(float(reward))
    assert np.array_equal(seen[0], single.reset()[0])


def test_seeds_options_and_masks_reach_each_environment() -> None:
    env, vec = adapted(3)
    assert vec.seed(8) == batch_seeds(8, 3)
    vec.set_options([{"fault": "backlash@joint1"}, {}, {"fault": "healthy"}])
    found = vec.reset()
    hidden = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert (hidden[0], hidden[2]) == ("backlash@joint1", "healthy")
    again, _ = DiagnosisVectorEnv(planar(2), env.settings, num_envs=3).reset(seed=8)
    np.testing.assert_array_equal(found, again)
    assert np.array_equal(np.stack(vec.env_method("action_masks")), env.action_masks())
    assert len(vec.env_method("action_masks", indices=[0, 2])) == 2
    assert vec.has_attr("action_masks") and not vec.has_attr("lid")


def test_neighbouring_seeds_of_make_vec_env_share_no_episode() -> None:
    from stable_baselines3.common.env_util import make_vec_env

    from loose_env.envs.sb3 import KeyedDummyVecEnv

    own = {**SHORT, "n_links": 2}
    found = [
        make_vec_env(
            "loose_env/Planar-v0", 3, seed, env_kwargs=own, vec_env_cls=KeyedDummyVecEnv
        ).reset()
        for seed in (0, 1)
    ]
    assert len(np.unique(np.concatenate(found), axis=0)) == 6
    np.testing.assert_array_equal(found[1], adapted(3)[0].reset(seed=1)[0])
    with pytest.warns(UserWarning, match="0 and 1.*KeyedDummyVecEnv"):
        make_vec_env("loose_env/Planar-v0", 2, 0, env_kwargs=own).reset()


def test_what_cannot_be_adapted_is_refused() -> None:
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    from loose_env.envs.sb3 import Sb3VecEnv

    env, vec = adapted(2)
    other = DiagnosisVectorEnv(planar(2), DiagnosisSettings(), autoreset_mode="NextStep")
    with pytest.raises(InvalidSetting, match="SameStep"):
        Sb3VecEnv(other)
    with pytest.raises(InvalidSetting, match="RecordEpisodeStatistics"):
        Sb3VecEnv(RecordEpisodeStatistics(env))  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="options of reset"):
        vec.set_attr("settings", None, indices=[0])
    with pytest.raises(UnknownName, match="action_masks"):
        vec.env_method("open_the_lid")


@pytest.mark.slow
def test_maskable_ppo_learns_a_few_steps_and_takes_the_masks() -> None:
    from stable_baselines3.common.logger import Logger

    contrib = pytest.importorskip("sb3_contrib")
    env, vec = adapted(4)
    model = contrib.MaskablePPO("MlpPolicy", vec, n_steps=4, batch_size=8, n_epochs=1, seed=0)
    before = model.policy.action_net.weight.detach().clone()
    model.set_logger(Logger(None, []))  # its own would leave an empty folder in /tmp
    model.learn(16)
    assert not np.array_equal(before.numpy(), model.policy.action_net.weight.detach().numpy())
    masks = env.action_masks()
    actions, _ = model.predict(env.reset(seed=1)[0], action_masks=masks)
    parts = np.split(masks[0], np.cumsum(env.actions.nvec)[:-1])
    assert all(part[choice] for part, choice in zip(parts, actions[0], strict=True))
