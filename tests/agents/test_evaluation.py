"""The evaluator: paired episodes, the same at any width."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loose_agents.base import BENCHMARK_SEED, EVALUATION_SEED, Problem, check_training_seed
from loose_agents.evaluation import arguments_of, diagnosis_env, evaluate
from loose_agents.policies.link_finding import LinkFindingAgent
from loose_agents.registry import AGENTS, make_agent

from loose_env.arms import planar, vera
from loose_env.diagnosis import LinkFindingSettings
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName
from loose_env.faults import Fault

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


def test_rows_do_not_depend_on_the_range_they_are_played_in(problem: Problem) -> None:
    agent = make_agent("random", problem)
    whole = evaluate(agent, "a", problem.arm, SETTINGS, episodes=6, seed=3)
    parts = [
        row
        for first in (0, 3)
        for row in evaluate(agent, "a", problem.arm, SETTINGS, episodes=3, first=first, seed=3)
    ]
    assert whole == parts


def test_the_trail_tells_what_the_agent_believed_and_spent(problem: Problem) -> None:
    agent = make_agent("random", problem)
    rows = evaluate(agent, "a", problem.arm, SETTINGS, episodes=8, seed=4)
    for row in rows:
        lengths = {len(value) for name, value in vars(row).items() if name.startswith("trail")}
        assert lengths == {row.records}
        assert row.trail_best[-1] == row.verdict
        assert row.trail_confidence[-1] == row.confidence
        assert row.trail_truth[-1] == row.truth_probability
        assert row.trail_price[-1] == row.price
        assert row.trail_seconds[-1] == row.seconds
        assert np.all(np.diff(row.trail_price) > 0)
        for best, top, truth in zip(
            row.trail_best, row.trail_confidence, row.trail_truth, strict=True
        ):
            assert truth == top if best == row.truth else truth <= top
        assert row.excited == row.records  # it shakes one joint at a time
        assert (row.friction_ratio is None) == (row.truth == "healthy")
    ratios = [row.friction_ratio for row in rows if row.friction_ratio is not None]
    # Friction is 0.02 to 1 of the drive.
    assert ratios and 1.0 <= min(ratios) <= max(ratios) <= 50.0


def test_an_agent_can_be_made_to_go_on(problem: Problem) -> None:
    agent = make_agent("random", problem)
    free = evaluate(agent, "a", problem.arm, SETTINGS, episodes=6, seed=4)
    forced = evaluate(agent, "a", problem.arm, SETTINGS, episodes=6, seed=4, records=3)
    assert {row.records for row in forced} == {3}
    assert {len(row.trail_best) for row in forced} == {3}
    assert min(row.records for row in free) < 3
    for own, other in zip(free, forced, strict=True):  # as far as both go they go the same way
        both = min(own.records, 3)
        assert own.trail_truth[:both] == other.trail_truth[:both]


def test_who_cannot_be_made_to_go_on_is_told_so(problem: Problem) -> None:
    thesis = LinkFindingAgent(problem, LinkFindingSettings(joint=2))
    with pytest.raises(InvalidSetting, match="no stopping rule"):
        evaluate(thesis, "a", problem.arm, SETTINGS, episodes=1, seed=4, records=2)
    agent = make_agent("random", problem)
    with pytest.raises(InvalidSetting, match="max_records"):
        evaluate(agent, "a", problem.arm, SETTINGS, episodes=1, seed=4, records=5)
    with pytest.raises(InvalidSetting, match="episodes"):
        evaluate(agent, "a", problem.arm, SETTINGS, episodes=0, seed=4)


class Oracle:
    """Measures once, then names what it was told."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def informed(self, fault: Fault, observation: Any) -> dict[str, Any]:
        return {"truth": fault.hypothesis, "records": 0}

    def predict(
        self, observation: Any, state: Any, episode_start: Any, deterministic: bool = False
    ) -> tuple[Any, Any]:
        assert not np.any(episode_start)
        shake = self.problem.actions.encode(levels=np.ones(self.problem.arm.n, dtype=np.intp))
        actions = [self.problem.verdict(s["truth"]) if s["records"] else shake for s in state]
        return np.array(actions), [{**s, "records": s["records"] + 1} for s in state]


def test_what_is_told_the_fault_can_name_it(problem: Problem) -> None:
    rows = evaluate(Oracle(problem), "oracle", problem.arm, SETTINGS, episodes=8, seed=3, width=3)
    assert all(row.success and row.records == 1 for row in rows)
    assert {row.excited for row in rows} == {problem.arm.n}


def test_training_keeps_away_from_the_evaluation_seeds() -> None:
    assert check_training_seed(7) == 7
    for seed in (EVALUATION_SEED, BENCHMARK_SEED):
        with pytest.raises(InvalidSetting, match="kept for evaluation"):
            check_training_seed(seed)


@pytest.mark.slow
def test_tuned_link_finding_beats_the_best_blind_guess_on_vera() -> None:
    settings = DiagnosisSettings()
    problem = Problem.of(vera(), settings)
    agent = make_agent("classical_literal", problem)
    rows = evaluate(agent, "classical_literal", problem.arm, settings, episodes=96, seed=11)
    # Always saying healthy is right on a third of the arms.
    assert sum(r.success for r in rows) / len(rows) > 1 / 3


def test_an_unknown_agent_is_refused_with_the_known_ones(problem: Problem) -> None:
    with pytest.raises(UnknownName, match="classical"):
        make_agent("fortune_teller", problem)
    assert {"random", "classical", "bisection", "ppo"} <= set(AGENTS)


@pytest.mark.parametrize(
    "text", ["", "n_links", '{"n_links": 3', "[3]", "3", "[" * 100_000, "9" * 5000]
)
def test_arguments_that_are_no_json_object_are_refused(text: str) -> None:
    with pytest.raises(InvalidSetting, match="--arguments must be") as caught:
        arguments_of(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"n_links": "three"}, "n_links='three'"),
        ({"colour": 1}, "unknown arguments"),
        ({"durations": 0.2}, r"durations must be positive seconds, one or more; got 0\.2$"),
        ({"id": 1}, "does not take"),
        ({"engine": "fast"}, "engine is one of"),
        ({"link_accelerometers": "yes"}, "must be true or false"),
    ],
)
def test_arguments_that_the_environment_does_not_take_are_refused_in_words(
    arguments: dict[str, object], says: str
) -> None:
    with pytest.raises(LooseEnvError, match=says) as caught:
        diagnosis_env("loose_env/Planar-v0", arguments)
    assert "\n" not in str(caught.value)
