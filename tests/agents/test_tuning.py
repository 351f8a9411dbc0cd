"""Tuning from trails: what it says of a threshold is what playing with it gives."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents import sharded_play
from loose_agents.base import Problem
from loose_agents.belief import BeliefAgent, Sure
from loose_agents.evaluation import evaluate, problem_of
from loose_agents.jobs import BackendSettings
from loose_agents.registry import belief_agent
from loose_agents.tuning import (
    THRESHOLDS,
    Player,
    Trails,
    best_threshold,
    halved,
    names_of,
    play_player,
    trained,
    write_tuned,
)

from loose_env.arms import planar
from loose_env.envs import DiagnosisSettings, Prices
from loose_env.errors import InvalidData, UnknownName

RECORDS = 3
SETTINGS = DiagnosisSettings(
    durations=(0.2,),
    max_records=RECORDS,
    unsure_after=1,
    engine="reduced",
    prices=Prices(miss=-2.0, false_alarm=-0.5, unsure=0.2),  # so that "unsure" comes up
)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), SETTINGS)


def trails_of(agent: BeliefAgent, episodes: int) -> Trails:
    agent.surprising = 0.0
    rows = evaluate(
        agent, "a", agent.problem.arm, SETTINGS, episodes=episodes, seed=9, records=RECORDS
    )
    return Trails.of([asdict(row) for row in rows], SETTINGS.prices, RECORDS)


def test_a_threshold_is_worth_what_playing_with_it_brings(problem: Problem) -> None:
    agent = belief_agent("posterior", "random", problem, seed=1)
    trails = trails_of(agent, 8)
    for threshold in (0.5, 0.95):
        agent.stopping = Sure(probability=threshold)
        rows = evaluate(agent, "a", problem.arm, SETTINGS, episodes=8, seed=9, threads=1)
        assert [row.records for row in rows] == (1 + trails.ends(threshold)).tolist()
        assert [row.success for row in rows] == trails.success(threshold).tolist()
        assert [row.reward for row in rows] == pytest.approx(trails.returns(threshold))
        assert threshold > 0.5 or "unsure" in {row.verdict for row in rows}
    assert len({tuple(trails.ends(t)) for t in THRESHOLDS}) > 1  # there was something to choose


def test_an_episode_that_diverged_ends_there_whatever_the_threshold() -> None:
    row = {"truth": "healthy", "price": 0.3, "trail_verdict": ["healthy"], "trail_price": [0.1]}
    trails = Trails.of([{**row, "trail_confidence": [0.7]}], Prices(), 3)
    assert trails.ends(0.6).tolist() == [0] and trails.returns(0.6) == pytest.approx([0.9])
    assert trails.ends(1.1).tolist() == [1] and trails.returns(1.1) == pytest.approx([-0.3])
    assert trails.success(0.6)[0] and not trails.success(1.1)[0]


def made_trails(count: int, seed: int) -> Trails:
    """A posterior that tells the truth about itself and gains one nat a record."""
    rng = np.random.default_rng(seed)
    truth = rng.random(count) < 0.5
    step = np.where(truth, 1, -1)[:, None] + 1.4142 * rng.standard_normal((count, 12))
    odds = np.cumsum(step, 1)
    right = (odds > 0) == truth[:, None]
    reward = np.where(right, 1.0, -1.0) - 0.05 * np.arange(1, 13)
    return Trails(confidence=1 / (1 + np.exp(-np.abs(odds))), reward=reward, right=right)


def test_the_threshold_is_near_the_best_on_other_episodes() -> None:
    others = made_trails(20_000, 1)
    worth = np.array([others.returns(t).mean() for t in THRESHOLDS])
    found = [best_threshold(made_trails(400, k), np.random.default_rng(0)) for k in range(2, 10)]
    lost = worth.max() - np.array([others.returns(t).mean() for t in found])
    # The mean return of 400 episodes has a standard error of 0.03.
    assert lost.mean() < 0.01 and lost.max() < 0.02
    # Among thresholds of equal worth it takes a surer one than the highest point.
    raw = [
        THRESHOLDS[np.argmax([made_trails(400, k).returns(t).mean() for t in THRESHOLDS])]
        for k in range(2, 10)
    ]
    right = [np.mean([others.success(t).mean() for t in each]) for each in (found, raw)]
    assert right[0] > right[1]


def test_the_best_constant_is_found_by_halving() -> None:
    worth = {(1, 0): 0.2, (2, 0): 0.5, (0, 1): 0.3, (0, 2): 0.9, (0, 3): 0.1}
    asked: list[tuple[tuple[int, ...], int]] = []

    def play(candidate: tuple[int, ...], episodes: int) -> Trails:
        asked.append((candidate, episodes))
        flat = np.full((episodes, 1), worth[candidate])
        return Trails(confidence=flat, reward=flat, right=flat > 0)

    assert halved(list(worth), play, episodes=8, keep=2, least=1)[0][0] == (0, 2)
    assert [n for _, n in asked] == [2] * 5 + [4] * 3 + [8] * 2
    assert asked[-2:] == [((0, 2), 8), ((2, 0), 8)]
    assert halved([(1, 0)], play, episodes=8, keep=2, least=1)[0][0] == (1, 0)


def test_settings_of_others_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "new" / "arm.json"
    write_tuned(path, {"a/x": 0.9}, constant=(0, 3))
    path.write_text(json.dumps({**json.loads(path.read_text()), "further": 1}))
    write_tuned(path, {"b/y": 0.8})
    write_tuned(path, {"a/x": 0.7})
    assert json.loads(path.read_text()) == {
        "stop": {"a/x": 0.7, "b/y": 0.8},
        "constant": [0, 3],
        "further": 1,
    }
    assert os.listdir(path.parent) == ["arm.json"]


def test_shards_go_on_and_grow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = {"n_links": 2, "durations": (0.2,), "max_records": 2, "engine": "reduced"}
    problem = problem_of("loose_env/Planar-v0", arguments)
    player = Player(
        agent="posterior/constant",
        levels=(3, 0),
        env_id="loose_env/Planar-v0",
        arguments=arguments,
        seed=9,
        records=2,
        posterior=trained(problem),
    )
    here = BackendSettings(backend="threading", workers=1)
    prices = problem.settings.prices

    def play(episodes: int, shard: int = 2, by: Player = player) -> Trails:
        return play_player(
            by, prices, episodes=episodes, folder=tmp_path, settings=here, shard=shard
        )

    first = play(2)
    played: list[int] = []
    real = sharded_play.evaluate

    def counted(*given: Any, **settings: Any) -> Any:
        played.append(settings["first"])
        return real(*given, **settings)

    monkeypatch.setattr(sharded_play, "evaluate", counted)
    more = play(4)
    assert played == [2]  # the first shard was there
    np.testing.assert_array_equal(more.confidence[:2], first.confidence)
    np.testing.assert_array_equal(play(4, shard=3).reward, more.reward)
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InvalidData, match="posterior of planar2-default has changed"):
        play(2, by=replace(player, posterior="that of yesterday"))


def test_what_cannot_be_tuned_is_told_so() -> None:
    with pytest.raises(UnknownName, match="amortised/greedy"):
        names_of("thesis")
