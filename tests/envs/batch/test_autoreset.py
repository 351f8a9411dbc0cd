"""Autoreset modes of the vector form, and Gymnasium's wrappers around them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers
from numpy.typing import NDArray

import loose_env  # noqa: F401
from loose_env.envs import DiagnosisVectorEnv, batch_seeds
from loose_env.errors import InvalidSetting, UnknownName

ID = "loose_env/Planar-v0"
SHORT: dict[str, Any] = {"n_links": 2, "durations": (0.2,), "max_records": 2, "threads": 1}


def make(mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **arguments: Any) -> Any:
    return gymnasium.make_vec(ID, num_envs=3, autoreset_mode=mode, **{**SHORT, **arguments})


def drawn(env: DiagnosisVectorEnv, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(0, env.actions.nvec, (3, len(env.actions.nvec)))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_every_mode_is_what_gymnasium_makes_of_single_environments(mode: AutoresetMode) -> None:
    copies: Any = SyncVectorEnv([lambda: gymnasium.make(ID, **SHORT)] * 3, autoreset_mode=mode)
    native = make(mode)
    seeds = [5, 9, 2]
    first, _ = native.reset(seed=seeds)
    np.testing.assert_array_equal(first, copies.reset(seed=seeds)[0])
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(8):
        actions = drawn(native, rng)
        found, expected = native.step(actions), copies.step(actions)
        for a, b in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(found[4]["action_mask"], expected[4]["action_mask"])
        assert ("final_info" in found[4]) == ("final_info" in expected[4])
        over = found[2] | found[3]
        ended += int(over.sum())
        if mode is AutoresetMode.DISABLED and over.any():
            again = native.reset(options={"reset_mask": over})[0]
            other = copies.reset(options={"reset_mask": over})[0]
            np.testing.assert_array_equal(again, other)
    assert ended > 3


def test_a_step_after_the_end_is_refused_where_autoreset_is_disabled() -> None:
    env = make("Disabled")
    env.reset(seed=0)
    env.step(np.stack([env.actions.encode(levels=np.array([0, 1]))] * 3))
    verdicts = np.stack([env.actions.encode(levels=np.array([0, 1]))] * 3)
    verdicts[1, -1] = 1
    env.step(verdicts)
    with pytest.raises(ResetNeeded, match=r"environments \[1\]"):
        env.step(verdicts)


@pytest.mark.parametrize("wrong", ["Sometimes", None, 3])
def test_another_mode_is_refused(wrong: Any) -> None:
    with pytest.raises(InvalidSetting, match="NextStep"):
        make(wrong)


@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.NormalizeObservation,
        wrappers.NormalizeReward,
        wrappers.DictInfoToList,
        lambda env: wrappers.ClipReward(env, -0.5, 0.5),
        lambda env: wrappers.RescaleObservation(env, np.float32(-1), np.float32(1)),
        lambda env: wrappers.TransformReward(env, lambda reward: 2 * reward),
    ],
)
def test_gymnasium_s_vector_wrappers_go_round_it(wrap: Callable[[Any], Any]) -> None:
    env = wrap(make())
    rng = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(6):
        observation, rewards, *_ = env.step(drawn(env.unwrapped, rng))
        assert observation in env.observation_space
        assert np.isfinite(rewards).all()


def test_statistics_of_episodes_are_theirs_in_every_mode() -> None:
    """Returns and lengths as the wrapper counts them."""
    found = {}
    for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
        env = wrappers.RecordEpisodeStatistics(make(mode))
        env.reset(seed=3)
        measure = np.stack([env.unwrapped.actions.encode(levels=np.array([0, 1]))] * 3)
        verdict = np.stack([env.unwrapped.actions.encode(verdict=1)] * 3)
        for action in (measure, measure, verdict):
            *_, infos = env.step(action)
        stats = infos["episode"] if "episode" in infos else infos["final_info"]["episode"]
        found[mode] = (stats["r"].tolist(), stats["l"].tolist())
    assert found[AutoresetMode.NEXT_STEP] == found[AutoresetMode.SAME_STEP]
    assert found[AutoresetMode.NEXT_STEP][1] == [3, 3, 3]


def test_a_batch_is_drawn_or_refuses_to_be() -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 3 and all(each.ndim == 3 for each in frames)
    assert env.call("render")[0].shape == frames[0].shape
    with pytest.raises(UnknownName, match="rgb_array"):
        make(render_mode="human")
    plain = make()
    plain.reset(seed=0)
    with pytest.raises(UnknownName, match="no render_mode"):
        plain.render()


def test_attributes_and_methods_of_each_environment() -> None:
    env = make()
    env.reset(seed=0)
    assert env.get_attr("hypotheses") == (env.hypotheses,) * 3
    assert env.call("action_space") == (env.single_action_space,) * 3
    np.testing.assert_array_equal(np.stack(env.call("action_masks")), env.action_masks())
    with pytest.raises(UnknownName, match="action_masks"):
        env.call("batch")
    with pytest.raises(InvalidSetting, match="options of reset"):
        env.set_attr("settings", None)


def test_each_environment_takes_options_of_its_own() -> None:
    env = make()
    options = [{"fault": "backlash@joint1"}, None, {"fault": "backlash@joint2"}]
    env.reset(seed=0, options={"fault": "healthy", "env_options": options})
    truths = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert truths == ["backlash@joint1", "healthy", "backlash@joint2"]
    for wrong in ({"fault": "healthy"}, [None], ["healthy"] * 3):
        with pytest.raises(InvalidSetting, match="env_options"):
            env.reset(options={"env_options": wrong})


def test_two_batches_share_no_root_seed() -> None:
    found = [seed for root in range(64) for seed in batch_seeds(root, 64)]
    assert len(set(found)) == len(found)
    assert batch_seeds(3, 4)[:2] == batch_seeds(3, 2)
    hidden = []
    for root in (0, 1):
        env = make()
        env.reset(seed=root)
        hidden += [env.batch.episode(i).pose.tobytes() for i in range(3)]
    assert len(set(hidden)) == 6
