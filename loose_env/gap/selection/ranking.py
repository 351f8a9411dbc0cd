"""What was tried at every step of a search, with the criterion that weighs fit and parameters.

What held-out data cannot tell from what was named.
"""

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
from loose_env.gap.settings import NamingSettings
from loose_env.typing import Array

__all__ = ["added_to", "bic", "indistinct", "ranking_of"]


def added_to(before: Judged, judged: Judged) -> tuple[Effect, ...]:
    """Effects that a hypothesis has and the one before it has not."""
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
    """Every hypothesis that was fitted to whole runs, step by step, the best first.

    Parameters
    ----------
    named : Named
        The search.
    comparison, held_out : Comparison
        The runs it was fitted to, and those that judged.
    louder : ndarray (M,) or float
        How many times as large as it is noise was taken to be there, by what is held out.
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
    # One measure for all rivals of a step: the noise, and how it hangs together, that the best
    # of them leaves.
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
    """Bayesian information criterion of a hypothesis less that of the one it adds to.

    Parameters
    ----------
    gained : float
        Fall of the sum of squares over independent readings, in units of their variance: twice
        the gain in log-likelihood.
    parameters : int
        How many it has more.
    count : float
        Independent readings.

    Examples
    --------
    >>> round(bic(30.0, parameters=2, count=1000.0), 1)
    -16.2
    """
    return -gained + parameters * log(max(count, 2.0))


TIE = NamingSettings.tie
"""Lead on held-out runs below which two hypotheses cannot be told apart [standard deviations]."""
_AS_MUCH = 0.05
"""What a rival may leave unexplained beyond what the named one does, as a share of the gap."""


def indistinct(named: Named, effect: Effect) -> tuple[Effect, ...]:
    """Effects of rivals that explain the held-out runs as well as a step that named this one.

    Of a rival with several effects, those at the joint of the named one stand against it; all of
    them where none is there.

    Parameters
    ----------
    named : Named
        What was found.
    effect : Effect
        One of the named.
    """
    found: list[Effect] = []
    before = named.base
    for step, rivals in zip(named.steps, named.rivals, strict=False):
        new = {each.key for each in added_to(before, step)}
        if effect.key in new:
            added = [({e.key for e in added_to(before, judged)}, lead) for judged, lead in rivals]
            own = next((lead for keys, lead in added if keys >= new), None)
            for judged, lead in rivals:
                if lead.held < TIE or lead_of(step, judged).held >= TIE:
                    continue
                if own is None or lead.share > own.share - _AS_MUCH:
                    found += _against(effect, added_to(before, judged))
        before = step
    return tuple({(e.kind, e.where): e for e in found}.values())


def _against(effect: Effect, others: tuple[Effect, ...]) -> list[Effect]:
    """Effects of a rival that stand against one; none where the rival has it, too."""
    if any((other.kind, other.where) == (effect.kind, effect.where) for other in others):
        return []
    joint = joint_of(effect)
    here = [other for other in others if joint_of(other) == joint]
    return here or list(others)
