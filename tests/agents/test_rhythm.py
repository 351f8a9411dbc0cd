"""Rhythm: the block of observation, and the agent that names the seat that knocked."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.evaluation import evaluate
from loose_agents.policies.rhythm import RhythmAgent
from loose_agents.registry import make_agent

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import LinearArm, planar
from loose_env.diagnosis import KnockRhythm
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidSetting

OWN: dict[str, Any] = {"engine": "reduced", "rhythm": True, "n_links": 3}


def single(**arguments: Any) -> Any:
    return gymnasium.make("loose_env/Planar-v0", **arguments).unwrapped


def batch_of(count: int, **arguments: Any) -> Any:
    return gymnasium.make_vec("loose_env/Planar-v0", num_envs=count, **arguments).unwrapped


def test_the_block_is_off_by_default_and_comes_last() -> None:
    plain, with_it = (single(n_links=3, rhythm=on).layout for on in (False, True))
    own, more = plain.slot_elements, with_it.slot_elements
    assert more[: len(own)] == own
    names = [each.name for each in more[len(own) :]]
    assert names[0] == "loudness.top" and len(names) == 1 + 3 * 12 + 3
    assert names[-1] == "rhythm.joint3"


def test_a_batch_shows_what_a_single_environment_does() -> None:
    env, batch = single(**OWN), batch_of(3, **OWN)
    env.reset(seed=4)
    batch.reset(seed=4)
    action = env.actions.encode(duration=0)
    alone, together = env.step(action)[0], batch.step(np.array([action] * 3))[0]
    np.testing.assert_array_equal(alone, together[0])


def test_what_knocks_is_loud_and_is_named_by_its_rhythm() -> None:
    batch = batch_of(12, difficulty="easy", **OWN)
    problem = Problem.of(batch.arm, batch.settings)
    layout, agent = batch.layout, make_agent("rhythm", problem)
    observation, _ = batch.reset(seed=11)
    actions, _ = agent.predict(observation)
    observation, *_ = batch.step(actions)
    loud = layout.physical(observation, "loudness")[:, 0, 0]
    episodes = [batch.batch.episode(k) for k in range(12)]
    healthy = np.array([each.fault.kind == "healthy" for each in episodes])
    assert loud[healthy].max() < 6e-4 < np.median(loud[~healthy])
    rows = evaluate(agent, "rhythm", problem.arm, problem.settings, episodes=20, seed=11)
    assert np.mean([row.success for row in rows]) > 0.85


def test_what_has_no_rhythm_is_refused() -> None:
    with pytest.raises(InvalidSetting, match="rhythm=True"):
        RhythmAgent(Problem.of(planar(2), DiagnosisSettings()))
    with pytest.raises(InvalidSetting, match="higher rate"):
        KnockRhythm(LinearArm(planar(2)), 400.0)
