"""Calibration of an answer: which way probabilities go, and what intervals are widened by."""

from __future__ import annotations

from dataclasses import replace

import pytest

from loose_env.gap import DeletionTest, EffectLocation, Gap, NamedEffect
from loose_env.gap.output.calibration import (
    GapCalibration,
    interval_score,
    widened_interval,
    with_probability,
)

TEST = DeletionTest(
    held_out_z=5.0, training_z=7.0, share_of_error=0.6, share_without=0.9, share_in_channel=0.85
)
EFFECT = NamedEffect(kind="payload", where="tool", parameters={"mass": 1.0}, deletion=TEST)
GAP = Gap(before=6.0, after=1.5)
RIVALS = tuple(EffectLocation(kind="link_mass", where=f"link{k}") for k in range(3))
MAP = GapCalibration(
    offset=1.0,
    weights=(1.0, 0.5, 0.5, -1.0),
    mean=(1.5, 2.0, 2.0, 0.3),
    deviation=(0.3, 1.0, 1.0, 0.5),
    effects=100,
    right=80,
    size_factor=1.5,
    shape_factor=2.5,
    sizes=100,
    shapes=50,
)


def _probability(effect: NamedEffect, gap: Gap = GAP) -> float:
    found = with_probability(effect, gap, MAP).probability
    assert found is not None
    return found


def test_better_evidence_makes_an_effect_more_probable() -> None:
    own = _probability(EFFECT)
    for better in (
        replace(TEST, held_out_z=6.5),
        replace(TEST, share_without=0.99),
        replace(TEST, share_in_channel=0.99),
    ):
        assert _probability(replace(EFFECT, deletion=better)) > own
    assert _probability(EFFECT, Gap(before=6.0, after=1.0)) > own


def test_effects_that_cannot_be_told_apart_share_the_probability() -> None:
    alone = _probability(EFFECT)
    among = with_probability(replace(EFFECT, ambiguous_with=RIVALS), GAP, MAP)
    assert among.probability is not None and among.rival_probability is not None
    assert among.probability < alone and among.rival_probability > 0
    assert among.probability + 3 * among.rival_probability == pytest.approx(alone)


def test_a_part_found_by_its_impacts_has_a_probability_too() -> None:
    weak, strong = (
        _probability(replace(EFFECT, deletion=None, impact_power_explained=share))
        for share in (0.3, 0.95)
    )
    assert 0.01 <= weak < strong <= 0.99


@pytest.mark.parametrize(
    ("value", "interval", "truth"),
    [(1.0, (0.8, 1.3), 1.9), (-2.0, (-2.5, -1.9), -1.2), (0.1, (-0.2, 0.3), -0.9)],
)
def test_the_score_is_the_factor_with_which_an_interval_just_holds_the_truth(
    value: float, interval: tuple[float, float], truth: float
) -> None:
    score = interval_score(value, interval, truth)
    for factor, holds in ((score * 1.01, True), (score * 0.99, False)):
        low, high = widened_interval(value, interval, factor)
        assert (low <= truth <= high) is holds
