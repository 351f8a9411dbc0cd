"""Ranking of all fitted hypotheses by BIC, and effects confusable with the result."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np

from loose_env.gap.fitting.holdout_score import Judged, Lead, lead_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.output.result import Place, Ranked
from loose_env.gap.residuals.autocorrelation import independent_rows
from loose_env.gap.residuals.residual_model import Comparison, Rows
from loose_env.gap.selection.forward_selection import Named
from loose_env.gap.selection.screening.grouping import joint_of
from loose_env.gap.settings import (
    RIVAL_SHARE,
    TIE_Z,
)
from loose_env.typing import Array

__all__ = ["added_to", "bic", "indistinct", "ranking_of"]


def added_to(before: Judged, judged: Judged) -> tuple[Effect, ...]:
    """Return effects that a hypothesis has and the one before it has not."""
    there = {effect.key for effect in before.fitted.effects}
    return tuple(effect for effect in judged.fitted.effects if effect.key not in there)


def ranking_of(
    named: Named,
    comparison: Comparison,
    held_out: Comparison,
    *,
    louder: Array | float = 1.0,
    first: int = 1,
) -> tuple[Ranked, ...]:
    """Rank every hypothesis fitted to whole runs, step by step, best first.

    Parameters
    ----------
    named : Named
        The search.
    comparison, held_out : Comparison
        The training runs and the held-out runs.
    louder : ndarray (M,) or float
        Factor by which the noise of the held-out residuals was increased in the search.
    first : int
        Number of its first step.
    """
    found = []
    for k, rivals in enumerate(named.rivals):
        before = named.base if k == 0 else named.steps[k - 1]
        found += _of_step(rivals, before, first + k, (comparison.rows, held_out.rows), louder)
    return tuple(found)


def _of_step(
    rivals: Sequence[tuple[Judged, Lead]],
    before: Judged,
    step: int,
    rows: tuple[Rows, Rows],
    louder: Array | float,
) -> list[Ranked]:
    if not rivals:
        return []
    # One noise model for all rivals of a step: size and autocorrelation of the residual of the best
    # of them.
    best = min((judged for judged, _ in rivals), key=lambda judged: judged.total)
    parts = [
        independent_rows(residual, own.block, own.channel)
        for residual, own in zip((best.fitted.residual, best.held_residual), rows, strict=True)
    ]
    count = sum(parts)
    every = len(best.fitted.residual) + len(best.held_residual)
    level = max(best.total / every, 1.0)
    found = []
    for judged, lead in rivals:
        first, *others = added_to(before, judged)
        found.append(
            Ranked(
                kind=first.kind,
                where=first.where,
                together_with=tuple(Place(kind=e.kind, where=e.where) for e in others),
                held_out=float(np.sqrt(np.mean((judged.held_residual * louder) ** 2))),
                bic=bic(
                    (before.total - judged.total) * count / (level * every),
                    parameters=judged.free_count - before.free_count,
                    count=count,
                ),
                step=step,
                lead=lead.held,
            )
        )
    return found


def bic(gained: float, *, parameters: int, count: float) -> float:
    """Return the BIC of a hypothesis less that of the hypothesis it extends.

    Parameters
    ----------
    gained : float
        Reduction of the sum of squares over independent readings, in units of their variance: twice
        the gain in log-likelihood.
    parameters : int
        Number of additional parameters.
    count : float
        Independent readings.

    Examples
    --------
    >>> round(bic(30.0, parameters=2, count=1000.0), 1)
    -16.2
    """
    return -gained + parameters * log(max(count, 2.0))


def indistinct(named: Named, effect: Effect) -> tuple[Effect, ...]:
    """Return rivals that explain held-out runs as well as a step with this effect.

    Of a rival with several effects, those at the joint of the identified one are compared with it;
    all of them where none is there.

    Parameters
    ----------
    named : Named
        The search.
    effect : Effect
        One of the identified effects.
    """
    found: list[Effect] = []
    before = named.base
    for step, rivals in zip(named.steps, named.rivals, strict=False):
        new = {each.key for each in added_to(before, step)}
        if effect.key in new:
            added = [({e.key for e in added_to(before, judged)}, lead) for judged, lead in rivals]
            own = next((lead for keys, lead in added if keys >= new), None)
            for judged, lead in rivals:
                if lead.held < TIE_Z or lead_of(step, judged).held >= TIE_Z:
                    continue
                if own is None or lead.share > own.share - RIVAL_SHARE:
                    found += _against(effect, added_to(before, judged))
        before = step
    return tuple({(e.kind, e.where): e for e in found}.values())


def _against(effect: Effect, others: tuple[Effect, ...]) -> list[Effect]:
    """Effects of a rival that compete with one; none where the rival has it, too."""
    if any((other.kind, other.where) == (effect.kind, effect.where) for other in others):
        return []
    joint = joint_of(effect)
    here = [other for other in others if joint_of(other) == joint]
    return here or list(others)
