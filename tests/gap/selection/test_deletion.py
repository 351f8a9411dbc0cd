"""An answer that predicts worse than none, or sits at a bound, is not given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.gap.fitting.holdout_score import ScoredFit
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.parameter import free_of
from loose_env.gap.selection.deletion import at_bound, worse_quantity
from tests.gap.cases.effect_arms import machine_of
from tests.gap.selection.test_acceptance import left
from tests.gap.selection.test_ranking import COMPARED


def bounded(kind: str, where: str, *values: float, variant: str = "") -> list[str]:
    effect = CATALOGUE[kind](machine_of("planar"), where, variant or None)
    clipped = [p.clipped(v) for p, v in zip(effect.parameters, values, strict=True)]
    structure = ModelStructure(effects=(effect,))
    found = at_bound(structure, free_of(effect.parameters, np.array(clipped)))
    assert all(each is effect for each, _ in found)
    return [name for _, name in found]


def test_a_play_as_wide_as_the_search_goes_is_at_its_bound() -> None:
    assert bounded("backlash", "joint2", np.inf, 1e3, 0.3) == ["gap"]
    assert bounded("backlash", "joint2", 0.01, 1e3, 0.3) == []


def test_nuisance_parameters_may_end_anywhere() -> None:
    assert bounded("backlash", "joint2", 0.01, np.inf, 1.0) == []


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("viscous_friction", -np.inf),  # none left of the damping of the model
        ("quadratic_drag", 0.0),
        ("torque_limit", np.inf),  # that of the model
        ("joint_compliance", np.inf),
    ],
)
def test_physical_bounds_do_not_count(kind: str, value: float) -> None:
    where = "servo2" if kind == "torque_limit" else "joint2"
    rest = (0.05,) if kind == "joint_compliance" else ()
    assert bounded(kind, where, value, *rest) == []


def test_a_delay_as_long_as_the_search_goes_is_at_its_bound() -> None:
    assert bounded("command_delay", "all", np.inf) == ["delay"]
    assert bounded("command_delay", "all", 0.01) == []


def scaled(scored: ScoredFit, factor: float) -> ScoredFit:
    return replace(scored, held_out_residual=factor * scored.held_out_residual)


def test_what_predicts_worse_on_held_out_runs_is_told_by_its_quantity() -> None:
    before = left(3.0)
    assert worse_quantity(COMPARED, scaled(before, 0.5), before) == ""
    assert worse_quantity(COMPARED, scaled(before, 1.01), before) == ""
    quantity = worse_quantity(COMPARED, scaled(before, 1.1), before)
    assert "[" in quantity


def test_within_the_noise_nothing_is_worse() -> None:
    before = left(0.5)
    assert worse_quantity(COMPARED, scaled(before, 2.0), before) == ""


def test_growth_within_the_noise_is_no_worsening() -> None:
    before = left(1.24)
    assert worse_quantity(COMPARED, scaled(before, 1.1), before) == ""
    assert worse_quantity(COMPARED, scaled(before, 1.3), before) != ""
