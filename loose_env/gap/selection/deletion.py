"""Deletion test of each effect by refit without it; effects at bounds, quantities made worse.

One test for every route to an answer: forward selection, swaps, joint fits, the impact pass. Each
effect is taken out, the others are refitted, and both models are compared on all runs. The errors
on the held-out runs are also compared in the recording's own units, quantity by quantity, and no
parameter may sit at its bound.
"""

from __future__ import annotations

import numpy as np

from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer, improvement_of
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.fitting.refit import fit_without
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.output.result import DeletionTest
from loose_env.gap.residuals.physical_units import errors_by_quantity
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import (
    ACCEPTED_Z,
    AT_BOUND,
    CHANNEL_Z,
    CONFIRMED_Z,
    EXPLAINED_BY_IMPACTS,
    MATERIAL,
    NOISE_RMS,
    WORSE,
    WORSE_BY_IMPACTS,
)
from loose_env.typing import Array

_SMOOTH = ("joint position", "joint speed", "drive position", "drive speed", "position in space")
"""Quantities that impacts hardly change."""


def significant(test: DeletionTest) -> bool:
    """Whether an effect is needed beside the others: on both data sets, on one clearly."""
    one, other = test.held_out_z, test.training_z
    return min(one, other) >= CONFIRMED_Z and max(one, other) >= ACCEPTED_Z


def material(test: DeletionTest, effect: Effect) -> bool:
    """Whether an effect explains nearly all of the autocorrelated residual somewhere.

    What stands in for an effect that is not in the catalogue is significant, and leaves much
    wherever it explains something. A part with stops mistimes its impacts, and leaves more.
    """
    least = EXPLAINED_BY_IMPACTS if effect.has_stops else MATERIAL
    return max(test.share_without, test.share_in_channel) >= least


def deletion_of(
    comparison: ResidualModel, scorer: Scorer, base: ScoredFit, best: ScoredFit, effect: Effect
) -> DeletionTest:
    """Refit a hypothesis without one of its effects, and compare the two."""
    without = scorer.score(fit_without(comparison, best.fitted, effect, roughly=True))
    improvement = improvement_of(best, without)
    explained, all_of = (
        (without.excess - best.excess, base.excess)
        if base.impact_dominated
        else (without.autocorrelated - best.autocorrelated, base.autocorrelated)
    )
    before, count = without.channel_products
    clear = before > CHANNEL_Z * np.sqrt(np.maximum(count, 1))
    gains = (before - best.channel_products[0])[clear] / before[clear]
    return DeletionTest(
        held_out_z=improvement.held_out,
        training_z=improvement.training,
        share_of_error=explained / all_of if all_of > 0 else 0.0,
        share_without=improvement.share,
        share_in_channel=float(gains.max(initial=0.0)),
    )


def at_bound(structure: ModelStructure, free: Array) -> list[tuple[Effect, str]]:
    """Effects with a parameter at its bound, and that parameter's name.

    A fit that ends at a bound has not found its optimum: another effect is the cause, or the
    effect has no such size. Bounds that are physical do not count: zero, none left of what the
    model has, the limit in which the effect vanishes; nor do nuisance parameters with a prior.
    """
    found = []
    for effect, own in zip(structure.effects, structure.slices, strict=True):
        ends = dict(effect.limit)
        for parameter, value in zip(effect.parameters, free[own], strict=True):
            if parameter.centre is not None:
                continue
            low, high = parameter.bounds
            near = AT_BOUND * (high - low)
            natural = parameter.low == 0.0 or parameter.natural_low
            at_low = value <= low + near and not natural and ends.get(parameter.name) != "low"
            at_high = value >= high - near and ends.get(parameter.name) != "high"
            if at_low or at_high:
                found.append((effect, parameter.name))
                break
    return found


def worse_quantity(held_out: ResidualModel, scored: ScoredFit, before: ScoredFit) -> str:
    """Quantity that a hypothesis predicts worse on held-out runs than another; "" if none.

    What an error grows by within the noise is no worsening: mean squares add up, and a quantity
    that was predicted to the noise is not predicted better. A part with stops mistimes its impacts:
    of an acceleration or a force, the error may grow as that of two independent signals does.
    """
    errors = errors_by_quantity(
        held_out.machine, held_out, before.held_out_residual, scored.held_out_residual
    )
    plain = np.ones_like(scored.held_out_residual)
    noise = errors_by_quantity(held_out.machine, held_out, plain, plain)
    impacts = have_stops(scored.fitted.effects)
    for quantity, (without, with_it) in errors.items():
        smooth = quantity.startswith(_SMOOTH)
        allowed = WORSE_BY_IMPACTS if impacts and not smooth else WORSE
        floor = noise[quantity][0]
        most = max(allowed * without, floor) ** 2 + (NOISE_RMS**2 - 1.0) * floor**2
        if with_it**2 > most:
            return quantity
    return ""
