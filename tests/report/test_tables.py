"""What stands in the tables: front, divisions, crossing, curves, standings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData, UnknownName
from loose_env.evaluation import (
    crossing,
    divisions,
    pareto_front,
    standings,
    success_after,
    table_of,
)
from loose_env.report.comparison.terminal_tables import WIDTH
from loose_env.report.comparison.text import comparison_text
from loose_env.report.pages.table import crossed_page_table, division_page_table

TRUTHS = ("healthy", "structural_looseness@link1", "backlash@joint2")
RATIOS = (None, 0.5, 3.0)


def rows_of(
    agent: str, *, right: int, episodes: int = 30, records: int = 2
) -> list[dict[str, Any]]:
    """Rows of an agent that is right on its first arms and takes the others for something else."""
    rows = []
    for k in range(episodes):
        truth, hit = TRUTHS[k % 3], k < right
        wrong = "backlash@joint1" if truth == "healthy" else "healthy"
        rows.append(
            {
                "agent": agent,
                "difficulty": "easy" if k % 2 else "hard",
                "seed": 7,
                "episode": k,
                "truth": truth,
                "verdict": truth if hit else wrong,
                "success": hit,
                "link_success": hit,
                "poses": records,
                "records": records,
                "seconds": 1.2 * records,
                "reward": (1.0 if hit else -1.0) - 0.1 * records,
                "truncated": False,
                "friction_ratio": RATIOS[k % 3],
                "trail_best": ["healthy"] * (records - 1) + [truth if hit else wrong],
                "trail_confidence": [0.6] * records,
                "trail_truth": [0.3] * records,
            }
        )
    return rows


ROWS = [
    *rows_of("net/greedy", right=27),
    *rows_of("net/random", right=24, records=4),
    *rows_of("analytic/greedy", right=15, records=3),
    *rows_of("thesis", right=6),
]


@pytest.mark.parametrize(
    ("cost", "value", "front"),
    [
        ([1, 2, 3], [0.1, 0.2, 0.3], [True, True, True]),
        ([1, 1, 2], [0.5, 0.5, 0.5], [True, True, False]),
        ([3, 1, 2], [0.9, 0.9, 0.95], [False, True, True]),
        ([], [], []),
    ],
)
def test_the_front_holds_what_nothing_beats_in_both(
    cost: list[float], value: list[float], front: list[bool]
) -> None:
    assert pareto_front(cost, value).tolist() == front


def test_a_front_of_points_that_are_none_is_refused() -> None:
    with pytest.raises(InvalidData):
        pareto_front([1.0], [np.nan])


def test_false_alarms_are_counted_on_healthy_arms_and_misses_on_faulty_ones() -> None:
    found = standings(rows_of("a", right=15))[0]
    assert found.false_alarms == 5 / 10
    assert found.misses == 10 / 20
    assert found.unsure == 0.0
    unsure = [{**row, "verdict": "unsure"} for row in rows_of("a", right=0)]
    assert (standings(unsure)[0].false_alarms, standings(unsure)[0].misses) == (0.0, 0.0)
    assert standings(unsure)[0].unsure == 1.0


def test_the_lead_over_the_reference_is_the_difference_of_returns() -> None:
    found = {s.agent: s for s in standings(ROWS, reference="thesis", rng=np.random.default_rng(0))}
    best, reference = found["net/greedy"], found["thesis"]
    assert reference.lead is None
    assert best.lead is not None and best.reward_interval is not None
    assert best.lead.estimate == pytest.approx(best.reward - reference.reward)
    assert best.lead.low < best.lead.estimate < best.lead.high
    assert best.reward_interval.low < best.reward < best.reward_interval.high
    assert table_of([reference], reference="thesis")[0]["Return against thesis"] == "reference"
    with pytest.raises(UnknownName, match="net/greedy"):
        standings(ROWS, reference="nobody")


def test_every_episode_lies_in_one_group_of_each_division() -> None:
    by_ratio, by_kind, by_level = divisions(ROWS)
    assert by_ratio.groups[:3] == ("below 1", "1 to 2", "2 to 4")
    assert [cell.episodes for cell in by_ratio.cells["thesis"]] == [10, 0, 10, 0, 0]
    assert by_kind.groups == ("healthy", "link slides", "joint play")
    assert [cell.episodes for cell in by_kind.cells["thesis"]] == [10, 10, 10]
    assert by_level.groups == ("hard", "easy")
    assert by_kind.cells["net/greedy"][0].success == 0.9
    shown = division_page_table(by_ratio).rows
    assert shown[0]["1 to 2 (0 arms)"] == "none"


def test_estimators_stand_across_and_policies_down() -> None:
    found = crossing(standings(ROWS))
    assert found is not None
    assert found.estimators == ("net", "analytic")
    assert found.policies == ("greedy", "random")
    assert found.cells["greedy", "analytic"].right == 15
    assert ("random", "analytic") not in found.cells
    assert crossed_page_table(found).rows[1]["analytic"] == "not played"
    assert crossing(standings(rows_of("thesis", right=3))) is None


def test_the_curve_counts_a_trail_that_was_cut_short_with_its_last_entry() -> None:
    rows = [
        {"agent": "a", "truth": "x", "trail_best": ["y", "x", "x"]},
        {"agent": "a", "truth": "x", "trail_best": ["x"]},
        {"agent": "a", "truth": "x", "trail_best": []},
        {"agent": "b", "truth": "x", "trail_best": []},
    ]
    assert success_after(rows) == {"a": [1 / 3, 2 / 3, 2 / 3]}
    assert success_after([]) == {}


def test_the_text_holds_every_table_and_fits_the_terminal() -> None:
    trained = [{**row, "agent": f"ppo#{k}"} for k in (1, 2) for row in rows_of("", right=20 + k)]
    text = comparison_text(
        [*ROWS, *trained],
        rows_of("net/greedy", right=20, records=12),
        rng=np.random.default_rng(0),
        reference="thesis",
        said=["No agent needs fewer than 1.1 records."],
    )
    for words in (
        "over reference",
        "No agent needs fewer",
        "Policies (lines) and estimators (columns)",
        "By seat drive over friction",
        "By difficulty",
        "after so many records",
        "Calibration",
        "Interquartile mean",
        "Most frequent mistakes of net/greedy",
    ):
        assert words in text
    assert max(map(len, text.splitlines())) <= WIDTH
    again = comparison_text(ROWS, rng=np.random.default_rng(0), reference="thesis")
    assert again == comparison_text(ROWS, rng=np.random.default_rng(0), reference="thesis")


def test_many_long_names_still_fit_the_terminal() -> None:
    name = "amortised-with-a-long-name/two-step-look-ahead"
    rows = [
        {**row, "agent": f"{name}-{k}", "verdict": "unsure"} for k in range(9) for row in ROWS[:30]
    ]
    text = comparison_text(rows, rng=np.random.default_rng(0), reference=f"{name}-0")
    assert max(map(len, text.splitlines())) <= WIDTH
