"""Policies that choose poses only."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import Situation, Tracker
from loose_agents.policies.pose_sets import (
    GreedySeparation,
    MovesOf,
    PoseSetPolicy,
    image_posterior,
)
from loose_agents.registry import make_agent

from loose_env.arms import Arm, planar, six_axis
from loose_env.diagnosis import DirectionSighting, ToolFrames, link_posterior
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from scripts.studies.pose_sets import (
    GREEDY,
    Directions,
    Records,
    Task,
    directions_block,
    link_log_likelihoods,
    records_block,
)

RULES = DiagnosisSettings()


def situation(problem: Problem, pose: np.ndarray, records: int, memory: Any = None) -> Situation:
    shares = np.full(len(problem.hypotheses), 1 / len(problem.hypotheses))
    return Situation(
        observation=np.zeros(1, dtype=np.float32),
        pose=pose,
        records=records,
        probabilities=shares,
        memory=memory,
        rng=np.random.default_rng(0),
    )


def test_a_set_is_played_one_pose_after_the_other() -> None:
    problem = Problem.of(planar(2), RULES)
    sets = np.radians([[0.0, 0.0], [0.0, 90.0], [45.0, 0.0]])
    policy = PoseSetPolicy(problem, sets, excited="first")
    pose = np.zeros(2)
    reached = []
    for t in range(4):
        action = problem.actions.decode(policy.choose(situation(problem, pose, t)))
        assert action.levels.tolist() == [len(problem.arm.levels), 0]
        assert action.duration == 1.2
        assert action.verdict == 0
        pose = pose + problem.actions.moves[action.moves]
        reached.append(np.degrees(pose).round().tolist())
    assert reached == [[0, 0], [0, 90], [45, 0], [0, 0]]


@pytest.mark.parametrize("arm", [planar(3), six_axis()])
def test_the_belief_gives_each_link_its_likeliest_direction(arm: Arm) -> None:
    problem = Problem.of(arm, RULES)
    tracker = Tracker(problem)
    memory = tracker.begin()
    n, axes = arm.n, memory.belief.directions
    node = 7
    loose = memory.belief.loose.copy()
    loose[:, : n * len(axes)] -= 12.0
    loose[:, len(axes) + node] += 12.0  # link 2 along one direction
    memory.belief = type(memory.belief)(
        healthy=memory.belief.healthy, loose=loose, links=n, directions=axes
    )
    found = image_posterior(problem, situation(problem, np.zeros(n), 1, memory))
    assert abs(found.directions[1] @ axes[node]) == pytest.approx(1.0, abs=1e-3)
    assert found.direction_sd[1] < 0.1
    assert found.direction_sd[0] > 0.4  # nothing is known about link 1's


def test_greedy_separation_goes_where_two_links_look_different() -> None:
    arm = planar(2)
    problem = Problem.of(arm, RULES)
    tracker = Tracker(problem)
    memory = tracker.begin()
    axes, loose = memory.belief.directions, memory.belief.loose.copy()
    for link in (0, 1):  # both links, each along its first direction
        loose[:, link * len(axes) + 1 : (link + 1) * len(axes)] -= 12.0
    memory.belief = type(memory.belief)(
        healthy=memory.belief.healthy, loose=loose, links=2, directions=axes
    )
    shares = np.array(["link" in name for name in problem.hypotheses], dtype=float)
    before = situation(problem, np.zeros(2), 1, memory)
    now = Situation(**{**vars(before), "probabilities": shares / shares.sum()})
    action = problem.actions.decode(GreedySeparation(problem).choose(now))
    # Alike at first, the two images stand across each other after a quarter turn of joint 2.
    assert np.degrees(abs(problem.actions.moves[action.moves[1]])).round() == 90
    assert action.moves[0] == RULES.stay


def test_another_agents_moves_are_played_without_its_excitation_and_verdict() -> None:
    arm = planar(3)
    problem = Problem.of(arm, RULES)
    batch = EpisodeBatch(arm, RULES, threads=1)
    batch.start(0, seed=4, number=0)
    policy = MovesOf(problem, make_agent("random", problem), excited="all")
    moved = 0
    for t in range(3):
        seen = batch.observe(0)
        now = situation(problem, problem.layout.pose_of(seen), t)
        action = policy.choose(Situation(**{**vars(now), "observation": seen}))
        decoded = problem.actions.decode(action)
        assert decoded.verdict == 0
        assert (decoded.levels == len(arm.levels)).all()
        moved += int(np.sum(decoded.moves != RULES.stay))
        batch.step([0], [action])
    assert moved > 0


@pytest.mark.parametrize("arm", [planar(3), six_axis()])
def test_likelihoods_of_many_cases_are_those_of_one(arm: Arm) -> None:
    rng, frames, width = np.random.default_rng(0), ToolFrames(arm), 0.2
    poses = np.array([arm.random_pose(rng) for _ in range(3)])
    seen = rng.standard_normal((3, frames.dimension))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    many = link_log_likelihoods(frames.images(poses)[None], seen[None], width)[0]
    for t in range(3):
        sightings = [DirectionSighting.of(poses[i], seen[i], width) for i in range(t + 1)]
        one = link_posterior(frames, sightings).log_likelihoods[: arm.n]
        np.testing.assert_allclose(many[t], one, atol=1e-9)


def test_blocks_of_directions_do_not_depend_on_their_size() -> None:
    settings = Directions(arms=("planar3",), sds=(10.0,), poses=3)
    for strategy in ("random", GREEDY):
        whole = directions_block(Task(arm="planar3", strategy=strategy, first=0, cases=6), settings)
        parts = [
            directions_block(Task(arm="planar3", strategy=strategy, first=k, cases=3), settings)
            for k in (0, 3)
        ]
        added = np.sum([part[0]["right"] for part in parts], axis=0)
        assert whole[0]["right"] == added.tolist()


@pytest.mark.slow
def test_knowing_direction_and_friction_names_the_link_more_often() -> None:
    settings = Records(arms=("planar4",), poses=2)
    row = records_block(Task(arm="planar4", strategy="random", first=0, cases=24), settings)[0]
    assert row["informed"][0] > row["right"][0]
