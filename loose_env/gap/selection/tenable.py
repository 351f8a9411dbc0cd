"""Deletion test: an answer predicts better than none, and no parameter sits at its bound.

One test for every route to an answer: forward selection, swaps, joint fits, the impact pass. The
errors on the held-out runs are compared in the recording's own units, quantity by quantity.
"""

from __future__ import annotations

import numpy as np

from loose_env.gap.fitting.holdout_score import ScoredFit
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.residuals.physical_units import errors_by_quantity
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import AT_BOUND, NOISE_RMS, WORSE, WORSE_BY_IMPACTS
from loose_env.typing import Array

__all__ = ["at_bound", "worse_quantity"]


_SMOOTH = ("joint position", "joint speed", "drive position", "drive speed", "position in space")
"""Quantities that impacts hardly change."""


def at_bound(structure: ModelStructure, free: Array) -> list[tuple[Effect, str]]:
    """Effects with a parameter at its bound, and that parameter's name.

    A fit that ends at a bound has not found its optimum: another effect is the cause, or the
    effect has no such size. Bounds that are physical do not count: zero, none left of what the
    model has, the limit in which the effect vanishes; nor do nuisance parameters with a prior.

    Parameters
    ----------
    structure : ModelStructure
        Effects of a fit.
    free : ndarray (P,)
        Its free numbers.
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

    An error within the noise is no worse, whatever it was. A part with stops mistimes its impacts:
    of an acceleration or a force, the error may grow as that of two independent signals does.

    Parameters
    ----------
    held_out : ResidualModel
        The held-out runs.
    scored, before : ScoredFit
        The hypothesis, and the one without its effects.
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
        if with_it > max(allowed * without, NOISE_RMS * noise[quantity][0]):
            return quantity
    return ""
