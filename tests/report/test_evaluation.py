"""Evaluation of agents: success rates, strata, paired intervals, calibration, rows on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData, UnknownName
from loose_env.evaluation import (
    bootstrap_mean,
    configuration_hash,
    expected_calibration_error,
    need_format,
    paired_difference,
    read_rows,
    reliability,
    standings,
    write_rows,
)
from loose_env.inference import log_score
from loose_env.report.outcomes import (
    divisions,
    runs_of,
    who_won,
)

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


def test_the_words_say_who_won_and_whether_it_may_be_sampling_error() -> None:
    a, b, c = (rows_of(name, right=k, episodes=20) for name, k in (("a", 18), ("b", 17), ("c", 2)))
    found = standings([*b, *a])
    assert [s.agent for s in found] == ["a", "b"]
    assert found[0].low < found[0].success == 0.9 < found[0].high
    first, then, lead = who_won([*a, *b, *c])
    assert first.startswith("The best by return was a: right on 18 of 20 arms (90 %)")
    assert then == "Then came b (17 of 20, 2.0 records) and c (2 of 20, 2.0 records)."
    assert "sampling error" in lead and "p = 1.00" in lead
    assert "exceeds sampling error" in who_won([*a, *c])[-1]
    assert len(who_won(a)) == 1


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


def test_every_episode_lies_in_one_group_of_each_division() -> None:
    by_ratio, by_kind, by_level = divisions(ROWS)
    assert by_ratio.groups[:3] == ("below 1", "1 to 2", "2 to 4")
    assert [cell.episodes for cell in by_ratio.cells["thesis"]] == [10, 0, 10, 0, 0]
    assert by_kind.groups == ("healthy", "link slides", "joint play")
    assert [cell.episodes for cell in by_kind.cells["thesis"]] == [10, 10, 10]
    assert by_level.groups == ("hard", "easy")
    assert by_kind.cells["net/greedy"][0].success == 0.9


def test_the_error_weighs_each_bin_by_its_claims() -> None:
    # Ten claims of 0.9, all right: off by 0.1. Thirty of 0.6, a third right: off by 0.2667.
    confidence = [0.9] * 10 + [0.6] * 30
    right = [True] * 10 + [True] * 10 + [False] * 20
    expected = (10 * 0.1 + 30 * (0.6 - 1 / 3)) / 40
    assert expected_calibration_error(confidence, right) == pytest.approx(expected)


def test_a_confidence_of_one_lies_in_the_last_bin_and_no_claim_is_lost() -> None:
    found = reliability([0.0, 0.5, 1.0, 1.0], [False, True, True, False], bins=2)
    assert found.count.tolist() == [2, 2]
    assert found.right.tolist() == [0.5, 0.5]
    assert found.confidence.tolist() == [0.25, 1.0]
    assert np.isnan(expected_calibration_error([], [])) and np.isnan(log_score([]))
    assert log_score([0.0]) == pytest.approx(np.log(1e-6))  # an impossible truth


def row(best: list[str], confidence: list[float], ratio: float | None = 3.0) -> dict[str, Any]:
    return {
        "truth": "x",
        "friction_ratio": ratio,
        "trail_best": best,
        "trail_confidence": confidence,
        "trail_truth": [p if b == "x" else 0.1 for b, p in zip(best, confidence, strict=True)],
    }


def rows_with(rewards: Any, *, truth: str = "healthy", seed: int = 1) -> list[dict[str, Any]]:
    return [
        {"difficulty": "default", "seed": seed, "episode": k, "truth": truth, "reward": float(r)}
        for k, r in enumerate(rewards)
    ]


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


CONFIGURATION = {"env": "loose_env/Vera-v0", "seed": 3, "agents": ["a"], "ranges": [0.02, 1.0]}
SAVED: list[dict[str, Any]] = [
    {
        "agent": "a",
        "episode": k,
        "truth": "healthy",
        "verdict": None if k else "healthy",
        "success": not k,
        "reward": 0.1 + k,
        "friction_ratio": None,
        "direction": (0.6, 0.8, 0.0) if k else None,
        "trail_best": ("healthy", "backlash@joint1") if k else (),
        "trail_truth": (0.1, 1 / 3) if k else (),
    }
    for k in range(3)
]


@pytest.mark.parametrize("form", ["json", "parquet"])
def test_rows_come_back_as_they_were_with_what_made_them(tmp_path: Path, form: Any) -> None:
    if form == "parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
    path = write_rows(tmp_path / "new", "rows", SAVED, CONFIGURATION, form=form)
    assert [p.name for p in path.parent.iterdir()] == [path.name] == [f"rows.{form}"]
    rows, configuration = read_rows(path)
    listed = {k: list(v) if isinstance(v, tuple) else v for k, v in SAVED[1].items()}
    assert configuration == CONFIGURATION and len(rows) == len(SAVED) and rows[1] == listed
    if form == "parquet":
        table, digest = parquet.read_table(path), configuration_hash(CONFIGURATION)
        assert table.schema.metadata[b"loose_env.configuration_hash"].decode() == digest
        assert set(table.column("configuration").to_pylist()) == {digest}
        # The type of a column does not depend on what happens to stand in it.
        assert str(table.schema.field("friction_ratio").type) == "double"
        assert str(table.schema.field("trail_best").type).startswith("list<")
        frame = pytest.importorskip("pandas").read_parquet(path)
        assert frame.reward.tolist() == [0.1, 1.1, 2.1]
        assert list(frame.trail_truth[2]) == [0.1, 1 / 3]
    else:
        path.write_text(path.read_text().replace('"seed": 3', '"seed": 4'))
        with pytest.raises(InvalidData, match="does not match its hash"):
            read_rows(path)
    turned = dict(reversed(CONFIGURATION.items()))
    assert configuration_hash(turned) == configuration_hash(CONFIGURATION)
    for name, text in (("rows.json", "[]"), ("rows.csv", "a,b")):
        (tmp_path / name).write_text(text)
        with pytest.raises(InvalidData):
            read_rows(tmp_path / name)


def trained_twice(*levels: str) -> object:
    rows = [
        {"agent": f"a#{k % 2 + 1}", "difficulty": level, "success": 1, "records": 1, "reward": 1}
        for k, level in enumerate(levels)
    ]
    return runs_of(rows, rng=np.random.default_rng(0))


def paired(other: list[dict[str, Any]]) -> object:
    return paired_difference(rows_with([1, 2, 3]), other, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (lambda: standings([]), InvalidData, "no episodes"),
        (lambda: standings(ROWS, reference="nobody"), UnknownName, "net/greedy"),
        (lambda: expected_calibration_error([1.2], [True]), InvalidData, "probability"),
        (lambda: expected_calibration_error([0.2, 0.3], [True]), InvalidData, "outcome"),
        (lambda: paired(rows_with([0, 0])), InvalidData, "same arms"),
        (lambda: paired([*rows_with([0, 0, 0]), *rows_with([0])]), InvalidData, "same arms"),
        (lambda: paired(rows_with([0, 0, 0], seed=2)), InvalidData, "share 0 arms"),
        (lambda: paired(rows_with([0] * 3, truth="b@j1")), InvalidData, "hides 'healthy'"),
        (
            lambda: bootstrap_mean([], rng=np.random.default_rng(0)),
            InvalidData,
            "one or more finite",
        ),
        (
            lambda: bootstrap_mean([np.nan], rng=np.random.default_rng(0)),
            InvalidData,
            "one or more finite",
        ),
        (lambda: trained_twice("easy", "hard", "easy"), InvalidData, "every difficulty"),
        (lambda: need_format("csv"), UnknownName, "parquet or json"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(given: Any, error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        given()
