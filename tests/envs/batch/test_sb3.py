"""The adapter to stable-baselines3: infos and masks of each environment, ends as SB3 wants them."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.settings import DiagnosisSettings
from loose_env.envs.vector_env import DiagnosisVectorEnv, batch_seeds
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.registration import IDS

pytest.importorskip("stable_baselines3")

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=2)


def make(num: int) -> tuple[DiagnosisVectorEnv, object]:
    from loose_env.envs.sb3 import Sb3VecEnv

    env = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=num)
    return env, Sb3VecEnv(env)


def test_an_ended_episode_hands_over_its_last_observation_and_the_next_first_one() -> None:
    _, vec = make(2)
    vec.seed(5)  # type: ignore[attr-defined]
    vec.reset()  # type: ignore[attr-defined]
    single = DiagnosisEnv(planar(2), SETTINGS)
    single.reset(seed=5)
    shake = single.actions.encode(levels=np.array([0, 3]))
    verdict = single.actions.encode(verdict=1)
    total = 0.0
    for action in (shake, verdict):
        last, reward, _, _, info = single.step(action)
        total += float(reward)
        seen, rewards, dones, infos = vec.step(np.stack([action, shake]))  # type: ignore[attr-defined]
    assert dones.tolist() == [True, False]
    assert np.array_equal(infos[0]["terminal_observation"], last)
    assert infos[0]["fault"] == info["fault"]
    assert infos[0]["TimeLimit.truncated"] is False
    assert infos[0]["episode"]["r"] == pytest.approx(total)
    assert infos[0]["episode"]["l"] == 2
    first, _ = single.reset()
    assert np.array_equal(seen[0], first)
    assert "fault" not in infos[1]
    assert rewards[0] == pytest.approx(float(reward))


def test_masks_come_through_env_method() -> None:
    env, vec = make(3)
    vec.reset()  # type: ignore[attr-defined]
    masks = np.stack(vec.env_method("action_masks"))  # type: ignore[attr-defined]
    assert np.array_equal(masks, env.action_masks())
    assert len(vec.env_method("action_masks", indices=[0, 2])) == 2  # type: ignore[attr-defined]
    with pytest.raises(UnknownName, match="action_masks"):
        vec.env_method("open_the_lid")  # type: ignore[attr-defined]


def test_what_it_cannot_adapt_is_refused() -> None:
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    from loose_env.envs.sb3 import Sb3VecEnv

    with pytest.raises(InvalidSetting, match="SameStep"):
        Sb3VecEnv(DiagnosisVectorEnv(planar(2), SETTINGS, autoreset_mode="NextStep"))
    env, vec = make(2)
    with pytest.raises(InvalidSetting, match="RecordEpisodeStatistics"):
        Sb3VecEnv(RecordEpisodeStatistics(env))  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="options of reset"):
        vec.set_attr("settings", SETTINGS, indices=[0])  # type: ignore[attr-defined]
    assert vec.has_attr("action_masks") and not vec.has_attr("lid")  # type: ignore[attr-defined]


def test_seeds_and_options_reach_each_environment() -> None:
    env, vec = make(3)
    assert vec.seed(8) == batch_seeds(8, 3)  # type: ignore[attr-defined]
    vec.set_options([{"fault": "backlash@joint1"}, {}, {"fault": "healthy"}])  # type: ignore[attr-defined]
    found = vec.reset()  # type: ignore[attr-defined]
    hidden = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert (hidden[0], hidden[2]) == ("backlash@joint1", "healthy")
    again, _ = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=3).reset(seed=8)
    np.testing.assert_array_equal(found, again)


@pytest.mark.parametrize("env_id", IDS)
def test_every_id_runs_as_stable_baselines3_wants_it(env_id: str) -> None:
    from loose_env.envs.sb3 import Sb3VecEnv

    env = gymnasium.make_vec(env_id, num_envs=2, durations=(0.2,), max_records=1)
    assert isinstance(env, DiagnosisVectorEnv)
    vec = Sb3VecEnv(env)
    first = vec.reset()
    assert first.shape == (2, env.layout.size)
    n = env.arm.n
    shake = env.actions.encode(levels=np.eye(n, dtype=int)[0])
    seen, _, dones, _ = vec.step(np.stack([shake] * 2))
    assert env.layout.physical(seen, "valid")[:, 0].ravel().tolist() == [1.0, 1.0]
    assert not dones.any()
    _, _, dones, infos = vec.step(np.stack([env.actions.encode(verdict=1)] * 2))
    assert dones.all() and all("terminal_observation" in info for info in infos)
    vec.close()


def test_maskable_ppo_learns_a_few_steps() -> None:
    from stable_baselines3.common.logger import Logger

    contrib = pytest.importorskip("sb3_contrib")
    _, vec = make(4)
    model = contrib.MaskablePPO("MlpPolicy", vec, n_steps=4, batch_size=8, n_epochs=1, seed=0)
    before = model.policy.action_net.weight.detach().clone()
    model.set_logger(Logger(None, []))  # its own would leave an empty folder in /tmp
    model.learn(16)
    assert not np.array_equal(before.numpy(), model.policy.action_net.weight.detach().numpy())
