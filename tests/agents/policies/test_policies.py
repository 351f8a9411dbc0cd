"""Policies choose records they may take, by what these are expected to say."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import Situation, Tracker
from loose_agents.policies.choice import (
    POLICIES,
    ConstantPolicy,
    candidate_at,
    excitations,
    information_of,
    make_policy,
    poses,
)

from loose_env.arms import planar
from loose_env.envs import DiagnosisSettings
from loose_env.envs.settings import Prices
from loose_env.errors import InvalidSetting, UnknownName


@pytest.fixture(scope="module")
def problem():
    return Problem.of(planar(3), DiagnosisSettings())


@pytest.fixture(scope="module")
def estimator(problem):
    return Tracker(problem)


def situation(problem, estimator, seed=0):
    rng = np.random.default_rng(seed)
    memory = estimator.begin()
    return Situation(
        observation=np.zeros(problem.layout.size, dtype=np.float32),
        pose=problem.arm.random_pose(rng),
        records=0,
        probabilities=memory.belief.probabilities,
        memory=memory,
        rng=rng,
    )


@pytest.mark.parametrize("name", sorted(set(POLICIES) - {"fixed"}))
def test_every_policy_measures_and_stays_in_range(problem, estimator, name):
    policy = make_policy(name, problem, estimator)
    for seed in range(2):
        now = situation(problem, estimator, seed)
        action = problem.actions.decode(policy.choose(now))
        assert action.verdict == 0
        assert action.levels.any()
        allowed = problem.actions.allowed_moves(now.pose)
        assert allowed[np.arange(3), action.moves].all()
        again = situation(problem, estimator, seed)
        assert np.array_equal(problem.actions.decode(policy.choose(again)).moves, action.moves)


def test_candidates_cost_what_the_environment_charges(problem):
    rng = np.random.default_rng(0)
    pose = problem.arm.random_pose(rng)
    levels, duration = np.array([3, 0, 2]), 1
    one = candidate_at(problem, np.full(3, 2), pose, levels, duration)
    prices = Prices()
    seconds = problem.settings.durations[1]
    assert one.price == pytest.approx(prices.record + prices.second * seconds + prices.level * 5)
    assert (one.torque > 0).tolist() == [True, False, True]
    assert (one.torque <= problem.arm.torque_limits).all()


def test_poses_are_distinct_and_within_range(problem, estimator):
    now = situation(problem, estimator)
    moves, where = poses(problem, now, 20)
    assert len(np.unique(moves, axis=0)) == len(moves) == 20
    assert all(problem.arm.within_ranges(p).all() for p in where)
    assert any((levels > 0).all() for levels, _ in excitations(problem)[0])


def test_a_record_that_drives_no_seat_says_nothing(problem, estimator):
    information = information_of(problem, estimator)
    now = situation(problem, estimator)
    faults = information.imagine(now.memory.belief, now.rng)
    assert faults.weight.sum() == pytest.approx(1.0)
    torque = np.array(problem.arm.torque_limits) / 5
    strong = information.of(faults, now.pose, torque, 1.2)
    weak = information.of(faults, now.pose, torque / 1e4, 1.2)
    assert strong.information > 0.5
    assert weak.information < 0.2 * strong.information
    assert 0 < strong.sure <= 1


def test_information_falls_as_the_belief_grows_sure(problem, estimator):
    information = information_of(problem, estimator)
    now = situation(problem, estimator)
    belief = now.memory.belief
    sure = type(belief)(
        healthy=belief.healthy + 6.0,
        loose=belief.loose,
        links=belief.links,
        directions=belief.directions,
    )
    torque = np.array(problem.arm.torque_limits) / 5
    values = [
        information.of(information.imagine(b, np.random.default_rng(0)), now.pose, torque, 1.2)
        for b in (belief, sure)
    ]
    assert values[1].information < 0.3 * values[0].information


def test_wrong_settings_are_refused(problem, estimator):
    with pytest.raises(InvalidSetting, match="level for each of 3 joints"):
        ConstantPolicy(problem, (3, 0))
    with pytest.raises(InvalidSetting, match="at least one"):
        ConstantPolicy(problem, (0, 0, 0))
    with pytest.raises(UnknownName, match="policies are"):
        make_policy("best", problem, estimator)
