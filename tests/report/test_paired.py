"""Means over episodes, alone and on the same arms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.evaluation import bootstrap_mean
from loose_env.evaluation.intervals import paired_difference, paired_values


def rows_with(rewards: Any, *, truth: str = "healthy", seed: int = 1) -> list[dict[str, Any]]:
    return [
        {"difficulty": "default", "seed": seed, "episode": k, "truth": truth, "reward": float(r)}
        for k, r in enumerate(rewards)
    ]


def test_the_interval_of_a_mean_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(300):
        found = bootstrap_mean(rng.exponential(size=120), rng=rng, resamples=400)
        held += found.low <= 1.0 <= found.high
    # 95 % of 300 is 285; the standard deviation of the count is 3.8, skewness costs some more.
    assert 268 <= held <= 297


def test_the_paired_interval_holds_the_difference_and_is_narrower_than_the_arms_differ() -> None:
    rng = np.random.default_rng(2)
    held, widths = 0, []
    for _ in range(200):
        arms = rng.normal(scale=3.0, size=150)  # easy and hard arms: the same for both agents
        better = rows_with(arms + 0.3 + rng.normal(size=150))
        found = paired_difference(
            better, rows_with(arms + rng.normal(size=150)), rng=rng, resamples=400
        )
        held += found.low <= 0.3 <= found.high
        widths.append(found.high - found.low)
    assert 180 <= held <= 198
    # Unpaired it would be 2 * 1.96 * sqrt(2 * (9 + 1) / 150) = 1.43 wide.
    assert np.mean(widths) == pytest.approx(2 * 1.96 * np.sqrt(2 / 150), rel=0.1)


def test_rows_are_paired_by_episode_not_by_order() -> None:
    first, second = rows_with([1, 2, 3]), rows_with([0, 0, 3])
    assert paired_values(first, second[::-1], "reward").tolist() == [1, 2, 0]


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (rows_with([0, 0]), "same arms"),
        (rows_with([0, 0, 0], seed=2), "share 0 arms"),
        (rows_with([0, 0, 0], truth="backlash@joint1"), "hides 'healthy'"),
        ([*rows_with([0, 0, 0]), *rows_with([0])], "same arms"),
    ],
)
def test_agents_that_met_other_arms_are_not_paired(other: Any, words: str) -> None:
    with pytest.raises(InvalidData, match=words):
        paired_difference(rows_with([1, 2, 3]), other, rng=np.random.default_rng(0))


def test_a_mean_of_nothing_is_refused() -> None:
    for values in ([], [np.nan], [[1.0]]):
        with pytest.raises(InvalidData):
            bootstrap_mean(values, rng=np.random.default_rng(0))
