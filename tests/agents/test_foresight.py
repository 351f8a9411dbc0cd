"""The learned choice of records: training, weights, calibration, choices in batches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from loose_agents.base import Problem
from loose_agents.belief import BeliefAgent, Calibrated, Sure, Tracker
from loose_agents.evaluation import evaluate, make_environments
from loose_agents.jobs import Store
from loose_agents.policies.choice import ForesightPolicy
from loose_agents.registry import make_agent
from loose_agents.rl.foresight import FILE, Foresight
from loose_agents.rl.foresight_training import ForesightTraining, fit, play, train

from loose_env.arms import planar
from loose_env.errors import InvalidData

SETTINGS = ForesightTraining(records=2000, rounds=2, episode=4, steps=200)


@pytest.fixture(scope="module")
def envs() -> Any:
    return make_environments("loose_env/SearchTier-v0", 32, {"engine": "reduced", "threads": 1})


@pytest.fixture(scope="module")
def problem(envs: Any) -> Problem:
    return Problem.of(envs.arm, envs.settings)


@pytest.fixture(scope="module")
def trained(problem: Problem, envs: Any, tmp_path_factory: Any) -> tuple[Foresight, Store, Any]:
    torch.set_num_threads(1)
    store, told = Store(tmp_path_factory.mktemp("records"), {"seed": 0}, arrays=True), []
    found, _ = train(problem, envs, SETTINGS, store, told.append)
    assert told[-1] == SETTINGS.records
    return found, store, told


def test_the_shipped_networks_say_more_than_the_posterior(problem: Problem, envs: Any) -> None:
    foresight = Foresight.load(problem)
    fresh = play(problem, envs, None, replace(SETTINGS, seed=9), 0, range(1500), lambda done: None)
    at = problem.linear.geometry(fresh.pose)
    corrected = foresight.corrected(fresh.after, fresh.shown_after, at)
    assert np.allclose(corrected.sum(axis=1), 1.0)
    rows = np.arange(len(fresh.truth))

    def score(p: Any) -> float:
        return float(np.log(np.maximum(p[rows, fresh.truth], 1e-6)).mean())

    assert score(corrected) > score(fresh.after) + 0.01
    found = foresight.entropies(fresh.before, fresh.shown, at)[rows, fresh.joint]
    left = -(corrected * np.log(corrected)).sum(axis=1)
    assert np.corrcoef(found, left)[0, 1] > 0.8


def test_training_goes_on_with_what_is_stored(problem: Problem, envs: Any, trained: Any) -> None:
    foresight, store, _ = trained
    told: list[int] = []
    again, worth = train(problem, envs, SETTINGS, store, told.append)
    assert not told
    assert "calibrated" in worth[1]
    for name, value in again.state_dict().items():
        assert torch.equal(value, foresight.state_dict()[name]), name


def test_an_episode_goes_alone_as_it_goes_among_others(problem: Problem, trained: Any) -> None:
    def played(width: int) -> Any:
        estimator = Calibrated(problem, trained[0])
        agent = BeliefAgent(
            problem, estimator, ForesightPolicy(problem, estimator), Sure(probability=0.8)
        )
        return evaluate(
            agent, "", problem.arm, problem.settings, episodes=6, seed=77, width=width, threads=1
        )

    alone, together = played(1), played(6)
    assert [row.actions for row in alone] == [row.actions for row in together]
    assert all(1 <= row.records <= problem.settings.max_records for row in alone)


def test_probabilities_before_the_first_record_are_the_prior(
    problem: Problem, envs: Any, trained: Any
) -> None:
    observations, _ = envs.reset(seed=3)
    calibrated, plain = Calibrated(problem, trained[0]), Tracker(problem)
    found = calibrated.follow(observations, [calibrated.begin() for _ in observations])
    assert np.array_equal(found, plain.follow(observations, [plain.begin() for _ in observations]))


def test_weights_come_back_and_others_are_refused(
    problem: Problem, trained: Any, tmp_path: Path
) -> None:
    trained[0].save(tmp_path, {"seed": 0})
    back = Foresight.load(problem, tmp_path)
    for name, value in back.state_dict().items():
        assert torch.equal(value, trained[0].state_dict()[name]), name
    other = Problem.of(planar(4), problem.settings)
    with pytest.raises(InvalidData, match=r"no weights of this task: .*train_foresight"):
        Foresight.load(other, tmp_path)
    (tmp_path / FILE).write_bytes(b"nothing")
    with pytest.raises(InvalidData, match="no weights of this task"):
        Foresight.load(problem, tmp_path)
    with pytest.raises(InvalidData, match=r"no learned choice .*train_foresight"):
        make_agent("foresight", other)


def test_a_fit_is_the_same_twice(problem: Problem, envs: Any) -> None:
    few = replace(SETTINGS, records=600, steps=40)
    taken = play(problem, envs, None, few, 0, range(600), lambda done: None)
    one, two = (fit(problem, taken, few)[0].state_dict() for _ in range(2))
    assert all(torch.equal(value, two[name]) for name, value in one.items())
