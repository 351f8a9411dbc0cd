"""Which effects stay: those whose 95 % intervals do not include nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loose_env.gap.effect import Effect
from loose_env.gap.fit import slice_of
from loose_env.gap.intervals import Intervals, bootstrap, widened
from loose_env.gap.judgement import Judge, Judged
from loose_env.gap.preparing import Prepared
from loose_env.gap.refitting import fit_without, refined
from loose_env.gap.refuting import short_of_limit, short_of_nothing

__all__ = ["judged_without", "sure_ones"]


def sure_ones(
    best: Judged,
    prepared: Prepared,
    judge: Judge,
    seed: int,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Judged, list[Effect], Intervals]:
    """Leave out effects whose intervals include nothing, and fit the others again.

    Parameters
    ----------
    best : Judged
        What was found.
    prepared : Prepared
        The runs.
    judge : Judge
        Judges fits to ``prepared.fit``.
    seed : int
        Of the bootstrap.
    say : callable
        Told what is left out.

    Returns
    -------
    (Judged, list of Effect, Intervals)
        What stays, what is left out, and the intervals of what stays.
    """
    dropped: list[Effect] = []
    while True:
        rng = np.random.default_rng(seed)
        fitted = best.fitted
        found = bootstrap(prepared.fit, fitted, rng)
        named = [(effect, slice_of(fitted.effects, effect)) for effect in fitted.named]
        for effect, own in named:
            if found.may_be_nothing(effect, own):
                found = short_of_limit(prepared.fit, fitted, found, effect)
            if found.may_be_nothing(effect, own):
                found = short_of_nothing(prepared.fit, fitted, found, effect)
        doubtful = [effect for effect, own in named if found.may_be_nothing(effect, own)]
        if not doubtful:
            return best, dropped, widened(prepared.fit, fitted, found)
        say(f"  {doubtful[-1]!r} may be nothing at all, by its interval, and is left out")
        dropped.append(doubtful[-1])
        best = judged_without(doubtful[-1], best, prepared, judge)


def judged_without(effect: Effect, judged: Judged, prepared: Prepared, judge: Judge) -> Judged:
    """A fit to ``prepared.fit`` without one of its effects, with fresh sensitivities."""
    return judge.judge(refined(fit_without(prepared.fit, judged.fitted, effect), prepared.fit))
