"""Policies choose records they may take, by what these are expected to say."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import Situation, Tracker, make_estimator, usual_estimator
from loose_agents.policies.choice import (
    POLICIES,
    ConstantPolicy,
    FixedPolicy,
    drawn_sequences,
    information_of,
    make_policy,
)
from loose_agents.registry import make_agent
from loose_agents.stored import tuning_name

from loose_env.arms import planar
from loose_env.envs import DiagnosisSettings, EnvBatch
from loose_env.errors import InvalidData, InvalidSetting, UnknownName


@pytest.fixture(scope="module")
def problem():
    return Problem.of(planar(3), DiagnosisSettings())


@pytest.fixture(scope="module")
def estimator(problem):
    return Tracker(problem)


def at_pose(
    problem: Problem, pose: Any, records: int, memory: Any = None, **more: Any
) -> Situation:
    shares = np.full(len(problem.hypotheses), 1 / len(problem.hypotheses))
    given = {
        "observation": np.zeros(problem.layout.size, dtype=np.float32),
        "rng": np.random.default_rng(0),
        "probabilities": shares,
    }
    return Situation(pose=pose, records=records, memory=memory, **{**given, **more})


def situation(problem: Problem, estimator: Any, seed: int = 0) -> Situation:
    rng = np.random.default_rng(seed)
    memory = estimator.begin()
    pose = problem.arm.random_pose(rng)
    return at_pose(problem, pose, 0, memory, rng=rng, probabilities=memory.belief.probabilities)


@pytest.mark.parametrize("name", sorted(set(POLICIES) - {"fixed", "foresight"}))
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


def test_a_record_says_little_that_drives_no_seat_or_that_is_known_already(problem, estimator):
    information = information_of(problem, estimator)
    now = situation(problem, estimator)
    faults = information.imagine([now.memory.belief], [now.rng])
    assert faults.weight.sum() == pytest.approx(1.0)
    torque = np.array(problem.arm.torque_limits) / 5
    at, long = np.tile(now.pose, (2, 1)), np.full(2, 1.2)
    strong, weak = information.of(faults, at, np.stack([torque, torque / 1e4]), long).information
    assert strong > 0.5
    assert weak < 0.2 * strong
    belief = now.memory.belief
    sure = information.imagine([replace(belief, healthy=belief.healthy + 6.0)], [now.rng])
    known = information.of(sure, at[:1], torque[None], long[:1]).information
    assert known[0] < 0.3 * strong


def test_wrong_settings_are_refused(problem, estimator):
    with pytest.raises(InvalidSetting, match="level for each of 3 joints"):
        ConstantPolicy(problem, (3, 0))
    with pytest.raises(InvalidSetting, match="at least one"):
        ConstantPolicy(problem, (0, 0, 0))
    with pytest.raises(UnknownName, match="policies are"):
        make_policy("best", problem, estimator)


RULES = DiagnosisSettings(engine="reduced", durations=(0.2,), max_excited=1)


def situation_in(problem: Problem, observation: Any, estimator: Any, records: int) -> Situation:
    memory = estimator.begin()
    known = {
        "observation": observation,
        "probabilities": estimator.follow(observation[None], [memory])[0],
    }
    return at_pose(problem, problem.layout.pose_of(observation), records, memory, **known)


def test_a_fixed_sequence_turns_back_at_the_limit_of_a_joint() -> None:
    problem = Problem.of(planar(2), RULES)
    batch = EnvBatch(problem.arm, RULES)
    batch.start(0, seed=1, number=0, options={"pose": [0.0, np.radians(149.0)]})
    action = problem.actions.encode(moves=np.array([3, 4]), levels=np.array([0, 2]))
    policy = FixedPolicy(problem, [action.tolist()])
    estimator = make_estimator("posterior", problem)
    chosen = problem.actions.decode(
        policy.choose(situation_in(problem, batch.observe(0), estimator, 5))
    )
    assert chosen.moves.tolist() == [3, 0]  # joint 2 by -90 instead of 90 degrees
    assert chosen.levels.tolist() == [0, 2]
    with pytest.raises(InvalidSetting, match="one record"):
        FixedPolicy(problem, [])


def test_the_open_loop_is_blind_to_results() -> None:
    problem = Problem.of(planar(2), RULES)
    estimator = make_estimator("posterior", problem)
    policy = make_policy("open_loop", problem, estimator)
    seen = []
    for fault in ("healthy", "backlash@joint1", "structural_looseness@link2"):
        batch = EnvBatch(problem.arm, RULES)
        batch.start(0, seed=1, number=0, options={"pose": [0.3, 0.8], "fault": fault})
        batch.step([0], [problem.actions.encode(levels=np.array([3, 0]), duration=0)])
        seen.append(policy.choose(situation_in(problem, batch.observe(0), estimator, 1)).tolist())
    assert seen[0] == seen[1] == seen[2]


def test_fixed_agents_need_their_sequences_and_take_so_many_records(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from loose_agents.evaluation import evaluate

    arm = planar(2)
    problem = Problem.of(arm, RULES)
    with pytest.raises(InvalidSetting, match="no fixed sequence"):
        make_agent("fixed_2", problem)
    sequence = drawn_sequences(problem, 1, 2, np.random.default_rng(0))[0]
    path = tmp_path / f"{tuning_name(problem)}.json"
    path.write_text(json.dumps({"fixed": {"2": sequence}}))
    monkeypatch.setenv("LOOSE_ENV_WEIGHTS", str(tmp_path))
    rows = evaluate(
        make_agent("fixed_2", problem), "fixed_2", arm, RULES, episodes=3, seed=1, threads=1
    )
    assert [row.records for row in rows] == [2, 2, 2]


@pytest.mark.parametrize(
    "name", ["posterior/greedy", "posterior/look_ahead", "posterior/open_loop"]
)
def test_several_arms_are_played_as_each_is_alone(name: str) -> None:
    rules = DiagnosisSettings(engine="reduced", durations=(0.2,))
    problem, num = Problem.of(planar(2), rules), 3
    agent, batch = make_agent(name, problem), EnvBatch(problem.arm, rules, num=num, threads=1)
    for slot in range(num):
        batch.start(slot, seed=slot, number=0)
    together, alone = None, [None] * num
    for _ in range(3):
        rows = batch.shown(range(num))
        actions, together = agent.predict(rows, together)
        for k in range(num):
            action, alone[k] = agent.predict(rows[k], alone[k])
            assert np.array_equal(action, actions[k])
            assert np.array_equal(alone[k][0].probabilities, together[k].probabilities)
        shake = problem.actions.encode(levels=np.array([0, 2]))
        batch.step(range(num), np.where(actions[:, -1:] > 0, shake, actions))


def test_expected_information_does_not_depend_on_the_candidates_beside(problem, estimator) -> None:
    information, now = information_of(problem, estimator), situation(problem, estimator)
    faults = information.imagine([now.memory.belief], [now.rng])
    rng = np.random.default_rng(2)
    poses = np.array([problem.arm.random_pose(rng) for _ in range(7)])
    torque = rng.random((7, 3)) * (rng.random((7, 3)) < 0.6) + np.eye(3)[rng.integers(3, size=7)]
    durations = rng.choice([0.2, 1.2], 7)
    together = information.of(faults, poses, torque, durations)
    for k in range(7):
        one = slice(k, k + 1)
        alone = information.of(faults, poses[one], torque[one], durations[one])
        assert alone.information[0] == pytest.approx(together.information[k], rel=1e-9)
        assert alone.sure[0] == pytest.approx(together.sure[k], rel=1e-9)


def test_rivals_share_the_learned_posterior_only_where_it_was_trained_for_the_task() -> None:
    rules = DiagnosisSettings(durations=(0.2,))
    trained, weak = (Problem.of(arm, rules) for arm in (planar(4), planar(4).with_levels([1, 2])))
    assert (usual_estimator(trained), usual_estimator(weak)) == ("amortised", "posterior")
    agents = [make_agent(name, weak) for name in ("greedy", "open_loop", "constant", "look_ahead")]
    assert {type(agent.estimator.posterior).__name__ for agent in agents} == {"FaultPosterior"}
    with pytest.raises(InvalidData, match="trained for levels"):
        make_estimator("amortised", weak)
