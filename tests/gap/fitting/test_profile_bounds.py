"""An interval reaches neither a limit nor nothing at all where the runs have refuted that."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.gap.fitting.confidence_intervals import Intervals
from loose_env.gap.fitting.holdout_score import ScoredFit
from loose_env.gap.fitting.profile_bounds import tightened_at_limit, tightened_at_zero
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.effects.friction import ViscousFriction
from loose_env.gap.model.parameter import values_of
from tests.gap.cases.gap_case import DAMPING, GAIN
from tests.gap.selection.test_candidate_fits import Case

SENSORS = ("rate3", GAIN), ("encoder1", 1.0001)
"""One that shows too much, and one that does not."""


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return Case(tmp_path_factory.mktemp("refuting") / "recording")


def to_the_limit(scored: ScoredFit) -> Intervals:
    """Intervals that say nothing of the last effect: each goes from bound to bound."""
    fitted = scored.fitted
    parameters = fitted.structure.parameters
    values = values_of(parameters, fitted.free)
    low, high = values.copy(), values.copy()
    own = fitted.structure.slices[-1]
    low[own], high[own] = np.transpose([(p.low, p.high) for p in parameters[own]])
    return Intervals(low=low, high=high, free=fitted.free, covariance=np.eye(len(low)))


@pytest.mark.parametrize(("joint", "refuted"), [("joint2", True), ("joint1", False)])
def test_an_interval_ends_short_of_a_limit_that_is_refuted(
    case: Case, joint: str, refuted: bool
) -> None:
    """Dry friction stands in for wet at joint2; at joint1 there is none of either."""
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    given = [*CATALOGUE["stribeck_friction"](case.machine, joint).starts[0]]
    if not refuted:
        wet = case.effect("viscous_friction", "joint2", [DAMPING])
        given[0] = 0.02
    named = [gain] if refuted else [gain, wet]
    scored = case.fitted([*named, case.effect("stribeck_friction", joint, given)])
    fitted, effect = scored.fitted, scored.fitted.effects[-1]
    own, wide = fitted.structure.slices[-1], to_the_limit(scored)
    assert wide.include_zero(effect, own)
    found = tightened_at_limit(case.comparison, fitted, wide, effect)
    assert found.include_zero(effect, own) is not refuted
    values = values_of(effect.parameters, fitted.free[own])
    assert np.all(found.low[own] <= values)
    assert np.all(found.high[own] >= values)
    number = [p.name for p in effect.parameters].index("torque")
    if refuted:
        assert 0.1 * values[number] < found.low[own][number] < values[number]
    else:
        assert np.array_equal(found.low, wide.low)


class Rattling(ViscousFriction):
    """Friction that counts as a part with stops."""

    has_stops = True


def test_beside_stops_an_interval_ends_short_of_nothing_where_that_is_refuted(case: Case) -> None:
    wet = Rattling(case.machine, "joint2"), [DAMPING]
    gain, insignificant = (case.effect("sensor_gain", name, [value]) for name, value in SENSORS)
    for named, refuted in (([wet, gain], True), ([wet, gain, insignificant], False)):
        scored = case.fitted(named)
        fitted, effect = scored.fitted, scored.fitted.effects[-1]
        own, wide = fitted.structure.slices[-1], to_the_limit(scored)
        found = tightened_at_zero(case.comparison, fitted, wide, effect)
        assert wide.include_zero(effect, own)
        assert found.include_zero(effect, own) is not refuted
        ends = [found.low[own.start], values_of(effect.parameters, fitted.free[own])[0]]
        if refuted:  # the lead is large, so nearly all of the way is refuted
            assert 1.0 < ends[0] < ends[1] and ends[1] - ends[0] < 0.5 * (ends[1] - 1.0)
    assert found is wide


def test_without_stops_an_interval_is_left_as_it_is(case: Case) -> None:
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    scored = case.fitted([wet, case.effect("sensor_gain", SENSORS[0][0], [GAIN])])
    wide = to_the_limit(scored)
    assert (
        tightened_at_zero(case.comparison, scored.fitted, wide, scored.fitted.effects[-1]) is wide
    )
