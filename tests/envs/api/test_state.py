"""Copies, pickles and states of environments go on as the original does."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar, scara, six_axis, vera
from loose_env.envs import DiagnosisEnv, DiagnosisSettings, DiagnosisVectorEnv, Prices
from loose_env.errors import InvalidSetting

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=3)


def play(env: Any, steps: int, seed: int = 0) -> list[Any]:
    """Take random actions; end and begin episodes as they come."""
    rng = np.random.default_rng(seed)
    nvec = env.unwrapped.actions.nvec
    num = getattr(env, "num_envs", None)
    found: list[Any] = []
    for _ in range(steps):
        action = rng.integers(0, nvec, nvec.shape if num is None else (num, len(nvec)))
        observation, reward, terminated, truncated, _ = env.step(action)
        found += [observation, reward, terminated, truncated]
        if num is None and (terminated or truncated):
            found.append(env.reset()[0])
    return found


def assert_alike(found: list[Any], expected: list[Any]) -> None:
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_copy_goes_on_as_the_original(duplicate: Any, engine: str) -> None:
    env = gymnasium.make(
        "loose_env/Planar-v0", n_links=2, durations=(0.2,), max_records=3, engine=engine
    )
    env.reset(seed=4, options={"mismatch_scale": 2.0})
    play(env, 3)
    other = duplicate(env)
    other.action_space.seed(0)
    env.action_space.seed(0)
    assert_alike(play(other, 6, seed=1), play(env, 6, seed=1))
    assert other.unwrapped.batch is not env.unwrapped.batch  # type: ignore[attr-defined]
    assert (other.spec.id, other.spec.kwargs) == (env.spec.id, env.spec.kwargs)  # type: ignore[union-attr]


def test_a_copied_batch_goes_on_as_the_original() -> None:
    for mode in ("SameStep", "NextStep"):
        env = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=3, threads=1, autoreset_mode=mode)
        env.reset(seed=4)
        play(env, 4)
        other = pickle.loads(pickle.dumps(env))
        assert_alike(play(other, 5, seed=1), play(env, 5, seed=1))
        assert other.autoreset_mode is env.autoreset_mode


def test_a_copy_before_the_first_reset_can_be_reset() -> None:
    env = pickle.loads(pickle.dumps(DiagnosisEnv(planar(2), SETTINGS)))
    expected = DiagnosisEnv(planar(2), SETTINGS)
    np.testing.assert_array_equal(env.reset(seed=1)[0], expected.reset(seed=1)[0])


def test_a_state_is_taken_up_again_and_again() -> None:
    env = DiagnosisEnv(planar(2), SETTINGS)
    env.reset(seed=4)
    env.step(env.actions.encode(levels=np.array([0, 1])))
    state = env.get_state()
    expected = play(env, 5)
    for other in (env, DiagnosisEnv(planar(2), SETTINGS)):
        other.set_state(pickle.loads(pickle.dumps(state)))
        assert_alike(play(other, 5), expected)
    dearer = replace(SETTINGS, prices=Prices(record=0.5))
    for wrong in (None, DiagnosisEnv(planar(3), SETTINGS), DiagnosisEnv(planar(2), dearer)):
        given = wrong
        if wrong is not None:
            wrong.reset(seed=0)
            given = wrong.get_state()
        with pytest.raises(InvalidSetting, match="state"):
            env.set_state(given)  # type: ignore[arg-type]
    batch = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=2)
    batch.reset(seed=0)
    with pytest.raises(InvalidSetting, match="get_state"):
        DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=3).set_state(batch.get_state())


@pytest.mark.parametrize(
    "arm", [planar(3), vera(), six_axis(), scara(), arm_from_file(DESK_ARM, hold="compliant")]
)
def test_a_pickled_arm_is_the_same_to_the_last_digit(arm: Arm) -> None:
    other = pickle.loads(pickle.dumps(arm))
    for name in dir(arm.model):
        value = None if name.startswith("_") else getattr(arm.model, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, getattr(other.model, name), err_msg=name)
    plain = ("name", "joints", "levels", "brake", "servo", "centring", "gears", "timestep")
    assert all(getattr(other, name) == getattr(arm, name) for name in plain)
    assert copy.deepcopy(arm) is arm
