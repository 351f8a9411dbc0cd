"""Lower bounds on records: no agent beats them where the information is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.comparison import bound_line, record_bound
from scipy.stats import entropy

from loose_env.arms import planar
from loose_env.diagnosis import least_records
from loose_env.diagnosis.experiment_design import needed_information
from loose_env.envs import DiagnosisSettings

PRIOR = np.array([0.4, 0.3, 0.2, 0.1])
FLIP = 0.45
"""Share of records that show another hypothesis than the true one."""


def channel() -> np.ndarray:
    """Probability that a record shows hypothesis j where i is true."""
    count = len(PRIOR)
    return np.where(np.eye(count) > 0, 1 - FLIP, FLIP / (count - 1))


def played(threshold: float, arms: int = 4000) -> tuple[float, float]:
    """Error and mean records of the exact posterior that stops at a probability."""
    rng, show = np.random.default_rng(5), channel()
    truth = rng.choice(len(PRIOR), size=arms, p=PRIOR)
    log = np.tile(np.log(PRIOR), (arms, 1))
    records, going = np.zeros(arms, dtype=int), np.ones(arms, dtype=bool)
    while going.any():
        at = np.flatnonzero(going)
        seen = (show[truth[at]].cumsum(1) < rng.random(len(at))[:, None]).sum(1)
        log[at] += np.log(show[:, np.minimum(seen, len(PRIOR) - 1)]).T
        records[at] += 1
        p = np.exp(log[at] - log[at].max(1, keepdims=True))
        going[at] = (p / p.sum(1, keepdims=True)).max(1) < threshold
    return float((log.argmax(1) != truth).mean()), float(records.mean())


def test_the_exact_posterior_does_not_beat_the_bound_by_success() -> None:
    rng, show = np.random.default_rng(6), channel()
    truth = rng.choice(len(PRIOR), size=20_000, p=PRIOR)
    log = np.tile(np.log(PRIOR), (len(truth), 1))
    success = []
    for _ in range(12):
        seen = (show[truth].cumsum(1) < rng.random(len(truth))[:, None]).sum(1)
        log += np.log(show[:, np.minimum(seen, len(PRIOR) - 1)]).T
        success.append(float((log.argmax(1) == truth).mean()))
    best = np.maximum.accumulate(success)
    for threshold in (0.6, 0.8, 0.95):
        error, records = played(threshold)
        bound = float(least_records(error, PRIOR, success=best))
        assert 0.3 * records < bound < records + 0.05


def test_the_needed_information_by_hand() -> None:
    third = [1 / 3] * 3
    expected = np.log(3) - (-0.1 * np.log(0.1) - 0.9 * np.log(0.9)) - 0.1 * np.log(2)
    assert float(needed_information(third, 0.1)) == pytest.approx(expected)
    assert float(needed_information(third, 0.0)) == pytest.approx(np.log(3))
    errors = np.linspace(0, 1, 50)
    needed = needed_information(third, errors)
    assert (np.diff(needed) <= 1e-12).all() and needed[-1] == pytest.approx(0.0, abs=1e-12)
    assert needed_information([1.0, 0.0], [0.0, 0.3]).tolist() == [0.0, 0.0]
    # Where one is likely, guessing it errs little: nothing is needed.
    assert float(needed_information([0.98, 0.01, 0.01], 0.03)) == 0.0


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), DiagnosisSettings())


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
    rows += [
        row("oracle*", k, trail_truth=[0.8, 0.9], trail_best=["healthy"] * 2) for k in range(100)
    ]
    bound = record_bound(problem, rows)
    assert bound is not None
    assert (bound.teller, bound.record) == ("oracle*", 1)
    assert bound.information == pytest.approx(np.log(0.8 * 3))
    assert bound.success.min() == bound.success.max() > 0.98
    assert entropy(bound.prior) == pytest.approx(np.log(3) + 2 / 3 * np.log(2))
    assert float(bound.by_information(0.0)) == pytest.approx(entropy(bound.prior) / np.log(2.4))
    some = record_bound(problem, rows[:100])
    assert some is not None and some.record == 2  # 0.5 to 0.9 says more than a third to 0.5
    assert some.success[0] == pytest.approx(0.596, abs=0.01)  # Wilson's upper end of 50 of 100
    assert float(some.by_success(0.1)) == pytest.approx(1.304, abs=0.01)


def test_the_line_is_about_the_best_agent_that_is_told_nothing(problem: Problem) -> None:
    rows = [
        row(
            name,
            k,
            reward=reward,
            success=k % 10 > 0,
            trail_truth=[0.6, 0.8],
            trail_best=["healthy"] * 2,
        )
        for name, reward in (("good", 0.5), ("bad", 0.1), ("oracle*", 0.9))
        for k in range(50)
    ]
    line = bound_line(problem, rows)
    assert "at the error of good, 10.0 %, which took 2.00" in line
    assert "bad" not in line and line.count("\n") == 0 and "With the oracle's" in line
    assert "oracle" not in bound_line(problem, rows[:100])
    both = [*rows, *({**r, "difficulty": "hard"} for r in rows)]
    assert bound_line(problem, both).count("Bound on records (") == 2
    silent = [row("thesis", k, trail_truth=(), trail_best=()) for k in range(50)]
    assert "more cannot be said" in bound_line(problem, silent)
