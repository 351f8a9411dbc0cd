"""Several trainings of one agent: interquartile means and their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.evaluation import runs_of, trained_agents
from loose_env.evaluation.intervals import (
    interquartile_mean,
    stratified_interval,
    task_scores,
)


def test_the_interquartile_mean_of_eight_scores_is_that_of_the_middle_four() -> None:
    assert interquartile_mean([[9, 1, 2, 3], [4, 5, -100, 80]]) == (2 + 3 + 4 + 5) / 4


def test_of_five_scores_one_is_cut_at_each_end() -> None:
    assert interquartile_mean([5, 1, 2, 3, 100]) == pytest.approx(10 / 3)


def test_runs_are_drawn_within_their_task() -> None:
    # Each task has the same score in every run: whatever is drawn, nothing changes.
    scores = np.array([[0.0, 1.0, 5.0]] * 4)
    found = stratified_interval(scores, rng=np.random.default_rng(0), resamples=50)
    assert found.estimate == found.low == found.high == interquartile_mean(scores)


def test_the_interval_of_two_runs_is_that_of_the_enumerated_resamples() -> None:
    # Two runs 0 and 1 of one task: resamples are 0, 0.5, 0.5, 1 with equal chance.
    found = stratified_interval([[0.0], [1.0]], rng=np.random.default_rng(0), level=0.3)
    assert (found.low, found.estimate, found.high) == (0.5, 0.5, 0.5)
    wide = stratified_interval([[0.0], [1.0]], rng=np.random.default_rng(0), level=0.9)
    assert (wide.low, wide.high) == (0.0, 1.0)


def test_trainings_are_told_by_their_names_and_scored_in_each_difficulty() -> None:
    rows = [
        {"agent": f"ppo#{run}", "difficulty": level, "success": run > k, "records": 2, "reward": k}
        for run in (1, 2, 3)
        for level in ("easy", "hard")
        for k in range(4)
    ]
    assert trained_agents(row["agent"] for row in rows) == {"ppo": ["ppo#1", "ppo#2", "ppo#3"]}
    scores = task_scores(rows, ["ppo#1", "ppo#2", "ppo#3"], "success")
    assert scores.tolist() == [[0.25, 0.25], [0.5, 0.5], [0.75, 0.75]]
    found = runs_of(rows, rng=np.random.default_rng(0))
    assert found["ppo"]["success"].estimate == 0.5
    with pytest.raises(InvalidData, match="every difficulty"):
        task_scores(rows[:-4], ["ppo#3"], "success")


def test_scores_that_are_no_table_are_refused() -> None:
    with pytest.raises(InvalidData, match="runs, tasks"):
        stratified_interval([1.0, 2.0], rng=np.random.default_rng(0))
