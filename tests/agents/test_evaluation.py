"""The evaluator: paired episodes, the same at any width; lower bounds on records."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loose_agents.base import BENCHMARK_SEED, EVALUATION_SEED, Problem, check_training_seed
from loose_agents.evaluation import EpisodeRow, arguments_of, diagnosis_env, evaluate
from loose_agents.policies.link_finding import LinkFindingAgent
from loose_agents.registry import AGENTS, make_agent
from loose_agents.sharded_play import record_bound
from scipy.special import softmax
from scipy.stats import entropy

from loose_env.arms import planar
from loose_env.diagnosis import LinkFindingSettings, least_records
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
        ({"engine": "fast"}, "engine must be one of"),
        ({"link_accelerometers": "yes"}, "must be true or false"),
    ],
)
def test_arguments_that_the_environment_does_not_take_are_refused_in_words(
    arguments: dict[str, object], says: str
) -> None:
    with pytest.raises(LooseEnvError, match=says) as caught:
        diagnosis_env("loose_env/Planar-v0", arguments)
    assert "\n" not in str(caught.value)


def test_the_exact_posterior_does_not_beat_the_bound_by_success() -> None:
    rng, prior, arms = np.random.default_rng(6), np.array([0.4, 0.3, 0.2, 0.1]), 8000
    show = np.where(np.eye(4) > 0, 0.55, 0.15)  # a record shows the truth, or another hypothesis
    truth = rng.choice(4, size=arms, p=prior)
    seen = (show[truth].cumsum(1) < rng.random((80, arms, 1))).sum(-1).clip(max=3)
    log = np.log(prior) + np.log(show[seen]).cumsum(0)
    right, sure = log.argmax(-1) == truth, softmax(log, axis=-1).max(-1)
    best = np.maximum.accumulate(right[:12].mean(1))
    for threshold in (0.6, 0.8, 0.95):
        end = (sure >= threshold).argmax(0)
        error, records = 1 - right[end, np.arange(arms)].mean(), 1 + end.mean()
        bound = float(least_records(error, prior, success=best))
        assert 0.3 * records < bound < records + 0.05


def row(agent: str, k: int, **told: Any) -> dict[str, Any]:
    plain = {"agent": agent, "seed": 1, "episode": k, "difficulty": "default", "truth": "healthy"}
    rest = {"link_success": True, "poses": 1, "seconds": 1.2, "reward": 0.5, "success": True}
    return {**plain, **rest, "verdict": "healthy", "records": 2, **told}


def test_the_most_telling_record_and_the_best_success_count(problem: Problem) -> None:
    # The prior of a healthy arm is a third.
    rows = [
        row("a", k, trail_truth=[0.5, 0.9], trail_best=["healthy" if k % 2 else "x", "healthy"])
        for k in range(100)
    ]
    rows += [row("b", k, trail_truth=[0.8, 0.9], trail_best=["healthy"] * 2) for k in range(100)]
    bound = record_bound(problem, rows)
    assert bound is not None
    assert (bound.teller, bound.record) == ("b", 1)
    assert bound.information == pytest.approx(np.log(0.8 * 3))
    assert bound.success.min() == bound.success.max() > 0.98
    assert entropy(bound.prior) == pytest.approx(np.log(3) + 2 / 3 * np.log(2))
    assert bound.records(0.0) >= entropy(bound.prior) / np.log(2.4) - 1e-9
    some = record_bound(problem, rows[:100])
    assert some is not None and some.record == 2  # 0.5 to 0.9 says more than a third to 0.5
    assert some.success[0] == pytest.approx(0.596, abs=0.01)  # Wilson's upper end of 50 of 100
    by_success = least_records(0.1, some.prior, success=some.success)
    assert float(by_success) == pytest.approx(1.304, abs=0.01)
