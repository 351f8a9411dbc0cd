"""What was tried at every step of a search, with the criterion that weighs fit and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison, Rows
from loose_env.gap.effect import Effect
from loose_env.gap.independent import independent_rows
from loose_env.gap.judgement import Judged, Lead
from loose_env.gap.naming import Named
from loose_env.gap.result import Place, Ranked

__all__ = ["added_to", "bic", "ranking_of"]

Array = NDArray[np.float64]


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
