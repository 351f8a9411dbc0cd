"""Calibration against cases worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.evaluation import calibration_of, claims_of, expected_calibration_error, reliability
from loose_env.evaluation.calibration import log_score


def test_the_error_weighs_each_bin_by_its_claims() -> None:
    # Ten claims of 0.9, all right: off by 0.1. Thirty of 0.6, a third right: off by 0.2667.
    confidence = [0.9] * 10 + [0.6] * 30
    right = [True] * 10 + [True] * 10 + [False] * 20
    expected = (10 * 0.1 + 30 * (0.6 - 1 / 3)) / 40
    assert expected_calibration_error(confidence, right) == pytest.approx(expected)


def test_errors_of_opposite_sign_in_two_bins_do_not_cancel_and_in_one_they_do() -> None:
    right = [True, False]
    assert expected_calibration_error([0.55, 0.95], right) == pytest.approx(0.5 * 0.45 + 0.5 * 0.95)
    assert expected_calibration_error([0.45, 0.55], right, bins=1) == pytest.approx(0.0)


def test_a_calibrated_source_shows_no_more_than_its_sampling_error() -> None:
    rng = np.random.default_rng(3)
    p = rng.uniform(0.2, 1.0, size=20_000)
    right = rng.random(len(p)) < p
    assert expected_calibration_error(p, right) < 0.012  # sqrt(15 / 20000) / 3 is 0.009
    assert expected_calibration_error(np.minimum(1.0, p + 0.1), right) > 0.07


def test_a_confidence_of_one_lies_in_the_last_bin_and_no_claim_is_lost() -> None:
    found = reliability([0.0, 0.5, 1.0, 1.0], [False, True, True, False], bins=2)
    assert found.count.tolist() == [2, 2]
    assert found.right.tolist() == [0.5, 0.5]
    assert found.confidence.tolist() == [0.25, 1.0]


def test_no_claims_have_no_error() -> None:
    assert np.isnan(expected_calibration_error([], []))
    assert np.isnan(log_score([]))


def test_what_is_no_probability_is_refused() -> None:
    with pytest.raises(InvalidData, match="probability"):
        expected_calibration_error([1.2], [True])
    with pytest.raises(InvalidData, match="outcome"):
        expected_calibration_error([0.2, 0.3], [True])


def test_an_impossible_truth_costs_a_finite_score() -> None:
    assert log_score([0.0]) == pytest.approx(np.log(1e-6))


def row(best: list[str], confidence: list[float], ratio: float | None = 3.0) -> dict[str, Any]:
    return {
        "truth": "x",
        "friction_ratio": ratio,
        "trail_best": best,
        "trail_confidence": confidence,
        "trail_truth": [p if b == "x" else 0.1 for b, p in zip(best, confidence, strict=True)],
    }


def test_beliefs_are_judged_by_record_and_by_friction() -> None:
    rows = [
        row(["y", "x"], [0.6, 1.0]),
        row(["x"], [0.6], ratio=0.5),
        row(["x", "x", "x"], [0.6, 0.7, 0.7], ratio=None),
    ]
    claims = claims_of(rows)
    assert claims.record.tolist() == [1, 2, 1, 1, 2, 3]
    assert claims.last.tolist() == [False, True, True, False, False, True]
    found = calibration_of("a", rows, edges=(1.0, 4.0), records=2)
    assert found is not None
    assert found.claims == 6
    assert found.by_record[0] == pytest.approx(abs(0.6 - 2 / 3))
    assert found.by_record[2] == pytest.approx(0.3)
    assert found.by_ratio == pytest.approx((0.4, 0.5 * 0.6 + 0.0, np.nan), nan_ok=True)
    assert found.score == pytest.approx(np.mean(np.log([1.0, 0.6, 0.7])))


def test_an_agent_without_probabilities_is_not_judged() -> None:
    assert calibration_of("a", [{"truth": "x", "trail_best": ()}], edges=(1.0,)) is None
