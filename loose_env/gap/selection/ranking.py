"""Ranking of all fitted hypotheses by BIC, and rivals that explain held-out runs as well."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np

from loose_env.gap.fitting.holdout_score import Improvement, ScoredFit, improvement_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.output.result import EffectLocation, RankedHypothesis
from loose_env.gap.residuals.autocorrelation import independent_rows
from loose_env.gap.residuals.residual_model import ResidualModel, Rows
from loose_env.gap.selection.forward_selection import Selection
from loose_env.gap.selection.screening.confusable_effects import joint_of
from loose_env.gap.settings import (
    RIVAL_SHARE,
    TIE_Z,
)
from loose_env.typing import Array


def added_to(before: ScoredFit, scored: ScoredFit) -> tuple[Effect, ...]:
    """Return effects that a hypothesis has and the one before it has not."""
    there = {effect.key for effect in before.fitted.effects}
    return tuple(effect for effect in scored.fitted.effects if effect.key not in there)


def ranking_of(
    named: Selection,
    comparison: ResidualModel,
    held_out: ResidualModel,
    *,
    noise_scale: Array | float = 1.0,
    first: int = 1,
) -> tuple[RankedHypothesis, ...]:
    """Rank every hypothesis fitted to whole runs, step by step, best first."""
    found = []
    for k, rivals in enumerate(named.rivals):
        before = named.base if k == 0 else named.steps[k - 1]
        found += _of_step(rivals, before, first + k, (comparison.rows, held_out.rows), noise_scale)
    return tuple(found)


def _of_step(
    rivals: Sequence[tuple[ScoredFit, Improvement]],
    before: ScoredFit,
    step: int,
    rows: tuple[Rows, Rows],
    noise_scale: Array | float,
) -> list[RankedHypothesis]:
    if not rivals:
        return []
    # One noise model for all rivals of a step: size and autocorrelation of the residual of the best
    # of them.
    best = min((scored for scored, _ in rivals), key=lambda scored: scored.total)
    parts = [
        independent_rows(residual, own.block, own.channel)
        for residual, own in zip((best.fitted.residual, best.held_out_residual), rows, strict=True)
    ]
    count = sum(parts)
    every = len(best.fitted.residual) + len(best.held_out_residual)
    level = max(best.total / every, 1.0)
    found = []
    for scored, improvement in rivals:
        first, *others = added_to(before, scored)
        found.append(
            RankedHypothesis(
                kind=first.kind,
                where=first.where,
                together_with=tuple(EffectLocation(kind=e.kind, where=e.where) for e in others),
                held_out=float(np.sqrt(np.mean((scored.held_out_residual * noise_scale) ** 2))),
                bic=bic(
                    (before.total - scored.total) * count / (level * every),
                    parameters=scored.free_count - before.free_count,
                    count=count,
                ),
                step=step,
                improvement_z=improvement.held_out,
            )
        )
    return found


def bic(gained: float, *, parameters: int, count: float) -> float:
    """Return the BIC of a hypothesis less that of the hypothesis it extends.

    Examples
    --------
    >>> round(bic(30.0, parameters=2, count=1000.0), 1)
    -16.2
    """
    return -gained + parameters * log(max(count, 2.0))


def indistinct(named: Selection, effect: Effect) -> tuple[Effect, ...]:
    """Return rivals that explain held-out runs as well as a step with this effect.

    Of a rival with several effects, those at the joint of the identified one are compared with it;
    all of them where none is there.
    """
    found: list[Effect] = []
    before = named.base
    for step, rivals in zip(named.steps, named.rivals, strict=False):
        new = {each.key for each in added_to(before, step)}
        if effect.key in new:
            added = [
                ({e.key for e in added_to(before, scored)}, improvement)
                for scored, improvement in rivals
            ]
            own = next((improvement for keys, improvement in added if keys >= new), None)
            for scored, improvement in rivals:
                if improvement.held_out < TIE_Z or improvement_of(step, scored).held_out >= TIE_Z:
                    continue
                if own is None or improvement.share > own.share - RIVAL_SHARE:
                    found += _against(effect, added_to(before, scored))
        before = step
    if (after := named.swapped) is not None:
        replaced = named.steps[-1]
        swapped_in = effect.key in {each.key for each in added_to(replaced, after)}
        if swapped_in and improvement_of(after, replaced).held_out < TIE_Z:
            found += _against(effect, added_to(after, replaced))
    return tuple({(e.kind, e.where): e for e in found}.values())


def _against(effect: Effect, others: tuple[Effect, ...]) -> list[Effect]:
    """Effects of a rival that compete with one; none where the rival has it, too."""
    if any((other.kind, other.where) == (effect.kind, effect.where) for other in others):
        return []
    joint = joint_of(effect)
    here = [other for other in others if joint_of(other) == joint]
    return here or list(others)
