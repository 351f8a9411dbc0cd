"""What was unexplained is looked at once more, blow by blow.

Sample by sample a part that strikes its stops hard cannot be found. What was found beside it is
fitted again by channels as well as these know it, the part is sought by its powers
(`loose_env.gap.selection.impacts.impact_search`), and what only stood in for it is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, joined
from loose_env.gap.fitting.gauss_newton import Fit, cost_of, fit, parameters_of, slices_of
from loose_env.gap.fitting.holdout_score import Judge, Judged, machine_part
from loose_env.gap.fitting.refit import refined
from loose_env.gap.model.effect import Effect
from loose_env.gap.preparation.prepare import Prepared
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.impacts.impact_power import Blows
from loose_env.gap.selection.impacts.impact_search import Struck, find_striking
from loose_env.gap.selection.revision import judged_without, sure_ones
from loose_env.gap.settings import GapSettings, NamingSettings

__all__ = ["SecondLook", "second_look"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondLook:
    """What it brought."""

    best: Judged
    """What was found before as far as it stays, with the part."""
    intervals: Intervals
    """Of all parameters."""
    struck: Struck
    """The part."""
    dropped: list[Effect]
    """What does not stay."""


def second_look(
    prepared: Prepared,
    judge: Judge,
    best: Judged,
    sought: Sequence[Effect],
    settings: GapSettings,
    naming: NamingSettings,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> SecondLook | None:
    """Look for a part that strikes its stops where something is left unexplained.

    Parameters
    ----------
    prepared : Prepared
        The runs.
    judge : Judge
        Judges fits to ``prepared.fit``.
    best : Judged
        What was found, and does not explain enough.
    sought : sequence of Effect
        The catalogue at every place.
    settings : GapSettings
        How many effects may be named, and the seed.
    naming : NamingSettings
        When an effect is believed.
    say : callable
        Told what goes on, line by line.

    Returns
    -------
    SecondLook or None
        None where there is no such part.
    """
    if not all(map(Blows.worth_while, (prepared.search, prepared.held))):
        return None
    # Blows fill accelerations, in which right figures leave no less than wrong ones; places and
    # speeds hardly know of them.
    left = prepared.fit.left_in_channels(best.fitted.residual)
    weighed = prepared.louder(np.maximum(left, 1.0))
    own = Judge(weighed.fit, weighed.whole_held)
    rigid = _without_slides(best, weighed, own)
    if len(rigid.fitted.named) >= settings.most_effects:
        return None
    known, rng = machine_part(rigid), np.random.default_rng(settings.seed)
    struck = find_striking(prepared, known, sought, rng, settings=naming, say=say)
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


def _without_slides(best: Judged, prepared: Prepared, judge: Judge) -> Judged:
    """What was found, fitted again, but for slides, which are sought once more blow by blow."""
    kept = [k for k, e in enumerate(best.fitted.effects) if e.kind != "structural_looseness"]
    own = slices_of(best.fitted.effects)
    effects = [best.fitted.effects[k] for k in kept]
    start = np.concatenate([best.fitted.free[own[k]] for k in kept])
    return judge.judge(refined(fit(prepared.fit, effects, start), prepared.fit))


def _with_struck(comparison: Comparison, rigid: Fit, struck: Struck) -> Fit:
    """A fit with a part that was fitted by its powers; nothing is fitted again."""
    whole = Fit(
        effects=(*rigid.effects, struck.effect),
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
        cost=cost_of(residual, whole.free, parameters_of(whole.effects)),
    )
