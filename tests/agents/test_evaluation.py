"""The evaluator: paired episodes, the same at any width."""

from __future__ import annotations

import pytest

from agents.base import Problem
from agents.evaluation import evaluate
from agents.link_finding import LinkFindingAgent
from agents.registry import AGENTS, make_agent
from loose_env.arms import planar, vera
from loose_env.diagnosis.link_finding import LinkFindingSettings
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import UnknownName

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=4)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), SETTINGS)


def test_rows_do_not_depend_on_how_many_arms_run_side_by_side(problem: Problem) -> None:
    agent = LinkFindingAgent(problem, LinkFindingSettings(joint=2))

    def rows(width: int, threads: int) -> list[object]:
        return [
            *evaluate(
                agent, "a", problem.arm, SETTINGS, episodes=7, seed=3, width=width, threads=threads
            )
        ]

    assert rows(1, 1) == rows(7, 2) == rows(3, 2)


def test_agents_meet_the_same_hidden_faults(problem: Problem) -> None:
    first = LinkFindingAgent(problem, LinkFindingSettings(joint=1))
    second = LinkFindingAgent(problem, LinkFindingSettings(joint=2, order="bisection"))
    truths = [
        [r.truth for r in evaluate(a, "a", problem.arm, SETTINGS, episodes=8, seed=3)]
        for a in (first, second)
    ]
    assert truths[0] == truths[1]
    assert len(set(truths[0])) > 1


def test_a_row_tells_the_whole_episode(problem: Problem) -> None:
    agent = LinkFindingAgent(problem, LinkFindingSettings(joint=2))
    for row in evaluate(agent, "a", problem.arm, SETTINGS, episodes=8, seed=4):
        assert row.verdict in problem.hypotheses
        assert row.success == (row.verdict == row.truth)
        assert 1 <= row.poses <= row.records <= SETTINGS.max_records
        assert row.seconds == pytest.approx(0.2 * row.records)
        prices = SETTINGS.prices
        spent = row.records * (prices.record + 0.2 * prices.second + 3 * prices.level)
        assert row.reward == pytest.approx((1 if row.success else -1) - spent)


def test_tuned_link_finding_beats_the_best_blind_guess_on_vera() -> None:
    settings = DiagnosisSettings()
    problem = Problem.of(vera(), settings)
    agent = make_agent("thesis", problem)
    rows = evaluate(agent, "thesis", problem.arm, settings, episodes=96, seed=11)
    # Always saying healthy is right on a third of the arms.
    assert sum(r.success for r in rows) / len(rows) > 1 / 3


def test_an_unknown_agent_is_refused_with_the_known_ones(problem: Problem) -> None:
    with pytest.raises(UnknownName, match="thesis"):
        make_agent("oracle", problem)
    assert {"random", "thesis", "bisection", "ppo"} <= set(AGENTS)
