"""Impact pass: search for a part with stops in the unexplained residual.

The impacts of a part against its stops cannot be identified sample by sample. The effects found so
far are refitted with each channel weighted by its residual, the part is identified by its impact
power (`loose_env.gap.selection.impacts.impact_search`), and effects that were only proxies for it
are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, joined
from loose_env.gap.fitting.gauss_newton import Fit, cost_of, fit
from loose_env.gap.fitting.holdout_score import Judge, Judged
from loose_env.gap.fitting.refit import refined
from loose_env.gap.model.effect import Effect
from loose_env.gap.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.impacts.impact_power import Blows
from loose_env.gap.selection.impacts.impact_search import Struck, find_striking
from loose_env.gap.selection.revision import judged_without, sure_ones
from loose_env.gap.settings import GapSettings

__all__ = ["SecondLook", "second_look"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondLook:
    """Result of the impact pass."""

    best: Judged
    """The remaining earlier effects, with the part."""
    intervals: Intervals
    """Confidence intervals of all parameters."""
    struck: Struck
    """The part with stops."""
    dropped: list[Effect]
    """The effects that are dropped."""


def second_look(
    prepared: GapProblem,
    judge: Judge,
    best: Judged,
    sought: Sequence[Effect],
    settings: GapSettings,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> SecondLook | None:
    """Search for a part that hits its stops where a residual is unexplained.

    Parameters
    ----------
    prepared : GapProblem
        The runs.
    judge : Judge
        Scores fits to ``prepared.fit``.
    best : Judged
        The best hypothesis, which does not explain enough.
    sought : sequence of Effect
        The catalogue at every location.
    settings : GapSettings
        Maximum number of effects, and the seed.
    say : callable
        Receives progress messages, line by line.

    Returns
    -------
    SecondLook or None
        None where there is no such part.
    """
    if not all(map(Blows.worth_while, (prepared.search, prepared.held))):
        return None
    # Impacts dominate the accelerations, whose residual is no smaller for correct parameters than
    # for wrong ones; positions and speeds are hardly affected.
    left = prepared.fit.left_in_channels(best.fitted.residual)
    weighed = prepared.louder(np.maximum(left, 1.0))
    own = Judge(weighed.fit, weighed.whole_held)
    rigid = _without_slides(best, weighed, own)
    if len(rigid.fitted.effects) >= settings.most_effects:
        return None
    known, rng = rigid.fitted.hypothesis.of_model, np.random.default_rng(settings.seed)
    struck = find_striking(prepared, known, sought, rng, say=say)
    if struck is None:
        return None
    for effect in struck.idle:
        say(f"  {effect!r} only stood in for it and is left out")
        rigid = judged_without(effect, rigid, weighed, own)
    rigid, dropped, intervals = sure_ones(rigid, weighed, own, settings.seed, say=say)
    return SecondLook(
        best=judge.judge(_with_struck(prepared.fit, rigid.fitted, struck)),
        intervals=joined(intervals, struck.intervals),
        struck=struck,
        dropped=[*struck.idle, *dropped],
    )


def _without_slides(best: Judged, prepared: GapProblem, judge: Judge) -> Judged:
    """Refit the hypothesis without slides, which the impact pass searches again."""
    structure, free = best.fitted.structure, best.fitted.free
    pairs = zip(structure.effects, best.fitted.own_free, strict=True)
    kept = [(e, own) for e, own in pairs if e.kind != "structural_looseness"]
    start = np.concatenate([free[: len(structure.nuisance.parameters)], *(own for _, own in kept)])
    rigid = structure.with_effects([e for e, _ in kept])
    return judge.judge(refined(fit(prepared.fit, rigid, start), prepared.fit))


def _with_struck(comparison: Comparison, rigid: Fit, struck: Struck) -> Fit:
    """Add a part fitted by its impact power to a fit, without refitting."""
    whole = Fit(
        structure=rigid.structure.plus(struck.effect),
        free=np.concatenate([rigid.free, struck.fitted.free]),
        residual=np.zeros(0),
        jacobian=np.zeros((len(comparison), 0)),
        cost=0.0,
    )
    residual = comparison.residuals([whole.hypothesis])[0]
    none = np.zeros((len(comparison), len(struck.fitted.free)))
    return replace(
        whole,
        residual=residual,
        jacobian=np.concatenate([rigid.jacobian, none], axis=1),
        cost=cost_of(residual, whole.free, whole.structure.parameters),
    )
