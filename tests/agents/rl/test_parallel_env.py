from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from loose_agents.rl.end_to_end.parallel_env import ParallelVecEnv

from loose_env.envs.sb3 import Sb3VecEnv
from loose_env.errors import InvalidSetting, UnknownName

ENV = "loose_env/Vera-v0"
ARGUMENTS = {"engine": "reduced", "max_records": 3}


def parallel(num_envs: int, workers: int) -> ParallelVecEnv:
    one = gymnasium.make_vec(ENV, num_envs=1, **ARGUMENTS)
    return ParallelVecEnv(one, ENV, ARGUMENTS, num_envs=num_envs, workers=workers)


@pytest.fixture(scope="module")
def three() -> Iterator[ParallelVecEnv]:
    env = parallel(3, 2)
    yield env
    env.close()


def test_episodes_are_those_of_one_process(three: ParallelVecEnv) -> None:
    here = Sb3VecEnv(gymnasium.make_vec(ENV, num_envs=3, **ARGUMENTS))
    rng = np.random.default_rng(0)
    assert three.seed(4) == here.seed(4)
    np.testing.assert_array_equal(three.reset(), here.reset())
    ended = 0
    for _ in range(8):
        masks = np.array(here.env_method("action_masks"))
        np.testing.assert_array_equal(three.env_method("action_masks"), masks)
        actions = rng.integers(0, here.action_space.nvec, size=(3, 6))
        (found, *others, infos), (wanted, *same, known) = three.step(actions), here.step(actions)
        np.testing.assert_array_equal(found, wanted)
        for mine, theirs in zip(others, same, strict=True):
            np.testing.assert_array_equal(mine, theirs)
            assert mine.dtype == theirs.dtype
        for i in np.flatnonzero(others[-1]):
            ended += 1
            for key in ("fault", "verdict", "is_success", "records", "episode"):
                assert infos[i][key] == known[i][key]
            assert infos[i]["TimeLimit.truncated"] == known[i]["TimeLimit.truncated"]
            np.testing.assert_array_equal(
                infos[i]["terminal_observation"], known[i]["terminal_observation"]
            )
        assert all(infos[i] == {} for i in np.flatnonzero(~others[-1]))
    assert ended > 3


def test_observations_outlive_the_next_step(three: ParallelVecEnv) -> None:
    three.seed(1)
    before = three.reset()
    kept = before.copy()
    three.step(np.zeros((3, 6), dtype=int))
    np.testing.assert_array_equal(before, kept)


def test_attributes_are_those_of_the_environments(three: ParallelVecEnv) -> None:
    assert [each.max_records for each in three.get_attr("settings")] == [3, 3, 3]
    assert three.has_attr("action_masks")
    assert not three.has_attr("nothing")
    assert three.env_is_wrapped(object, [0, 1]) == [False, False]
    with pytest.raises(UnknownName, match="action_masks"):
        three.env_method("nothing")
    with pytest.raises(InvalidSetting, match="cannot be set"):
        three.set_attr("settings", None)


def test_what_a_worker_refuses_is_raised_and_more_workers_than_arms_are_refused(
    three: ParallelVecEnv,
) -> None:
    three.set_options([{}, {}, {"fault": "nonsense"}])
    with pytest.raises(UnknownName, match="nonsense"):
        three.reset()
    with pytest.raises(InvalidSetting, match="3 workers for 2 environments"):
        parallel(2, 3)


def test_a_worker_that_dies_is_named_and_none_is_left() -> None:
    env = parallel(2, 2)
    env.seed(0)
    env.reset()
    processes = [process for process, _ in env._workers]
    os.kill(processes[1].pid, signal.SIGKILL)
    with pytest.raises(ChildProcessError, match=r"worker 2 of 2 .* died by SIGKILL"):
        for _ in range(3):
            env.step(np.zeros((2, 6), dtype=int))
    env.close()
    assert not any(process.is_alive() for process in processes)
