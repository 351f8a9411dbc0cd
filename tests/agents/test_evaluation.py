"""The evaluator: paired episodes, the same at any width."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.base import BENCHMARK_SEED, EVALUATION_SEED, Problem, check_training_seed
from loose_agents.evaluation import EpisodeRow, arguments_of, diagnosis_env, evaluate
from loose_agents.policies.link_finding import LinkFindingAgent
from loose_agents.registry import AGENTS, make_agent

from loose_env.arms import planar
from loose_env.diagnosis import LinkFindingSettings
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=4)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), SETTINGS)


def test_rows_do_not_depend_on_width_threads_or_range(problem: Problem) -> None:
    agent = make_agent("random", problem)

    def rows(width: int, threads: int, first: int = 0, episodes: int = 6) -> list[EpisodeRow]:
        return evaluate(
            agent, "a", problem.arm, SETTINGS, episodes=episodes, first=first, seed=3,
            width=width, threads=threads,
        )  # fmt: skip

    assert rows(1, 1) == rows(6, 2) == [*rows(2, 2, episodes=3), *rows(3, 1, 3, 3)]


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


def test_the_trail_tells_what_the_agent_believed_and_spent(problem: Problem) -> None:
    agent = make_agent("random", problem)
    rows = evaluate(agent, "a", problem.arm, SETTINGS, episodes=8, seed=4)
    for row in rows:
        lengths = {len(value) for name, value in vars(row).items() if name.startswith("trail")}
        assert lengths == {row.records}
        assert row.trail_best[-1] == row.trail_verdict[-1] == row.verdict
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


def test_training_keeps_away_from_the_evaluation_seeds() -> None:
    assert check_training_seed(7) == 7
    for seed in (EVALUATION_SEED, BENCHMARK_SEED):
        with pytest.raises(InvalidSetting, match="kept for evaluation"):
            check_training_seed(seed)


def test_an_unknown_agent_is_refused_with_the_known_ones(problem: Problem) -> None:
    with pytest.raises(UnknownName, match="classical"):
        make_agent("fortune_teller", problem)
    assert {"random", "classical", "bisection", "ppo"} <= set(AGENTS)


@pytest.mark.parametrize("text", ["", "n_links", "[3]", "[" * 100_000, "9" * 5000])
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
