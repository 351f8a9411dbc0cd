"""Swap step: replaces identified effects by confusable ones with a better fit.

Forward selection identifies the first effect from a residual that is due to several. Its best proxy
for the mixture may have a better alternative, or need fewer effects beside it, once the others are
in the model. Effects whose 95 % confidence intervals include zero are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, bootstrap, widened
from loose_env.gap.fitting.holdout_score import Judge, Judged, lead_of
from loose_env.gap.fitting.profile_bounds import short_of_limit, short_of_nothing
from loose_env.gap.fitting.refit import fit_without, polished, refined
from loose_env.gap.model.effect import Effect
from loose_env.gap.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import Trying
from loose_env.gap.selection.screening.grouping import akin, joint_of
from loose_env.gap.selection.screening.screening import screen
from loose_env.gap.settings import (
    SWAP_CANDIDATES,
    SWAP_CANDIDATES_THERE,
    SearchSettings,
)

__all__ = ["Exchange", "judged_without", "sure_ones"]


class Exchange:
    """Swaps identified effects for confusable ones where the fit improves.

    Parameters
    ----------
    comparison, short : Comparison
        The training runs, and the windows of them that rank candidates.
    judge : Judge
        Scores fits to all data.
    candidates : sequence of Effect
        The catalogue at every location.
    base : Judged
        The nominal model.
    settings : SearchSettings
        Number of swaps: `SWAP_CANDIDATES` candidates at most are fitted for each effect.
    """

    def __init__(
        self,
        comparison: Comparison,
        short: Comparison,
        judge: Judge,
        candidates: Sequence[Effect],
        base: Judged,
        settings: SearchSettings,
    ) -> None:
        self.comparison, self.short, self.judge = comparison, short, judge
        self.candidates, self.base, self.settings = candidates, base, settings

    def better_than(self, best: Judged, say: Callable[[str], None] = lambda _: None) -> Judged:
        """Return the best hypothesis after swaps; ``best`` itself if none is better.

        A hypothesis replaces another if it would have been ranked above it: its residual is
        smaller, or it fits equally well with fewer parameters.

        Parameters
        ----------
        best : Judged
            The hypothesis to improve.
        say : callable
            Receives progress messages, line by line.
        """
        for effect in best.fitted.effects:
            if not any(effect is each for each in best.fitted.effects):
                continue  # an effect that a swap made insignificant
            if effect.has_stops and not self.settings.swap_stops:
                continue
            better = self._in_place_of(effect, best)
            if better is not None:
                before, after = (
                    ", ".join(map(repr, judged.fitted.effects)) for judged in (best, better)
                )
                say(f"  {after} in the place of {before}")
                best = better
        return best

    def _in_place_of(self, effect: Effect, best: Judged) -> Judged | None:
        """Return the best hypothesis with one effect replaced; None if none is better."""
        named = {(e.kind, e.where) for e in best.fitted.effects}
        kin = [c for c in self.candidates if akin(effect, c) and (c.kind, c.where) not in named]
        if not kin:
            return None
        before = self._without(best, effect)
        trying = Trying(self.comparison, self.short, self.judge, before)
        acceptance = Acceptance(self.comparison, self.judge, self.base, before, self.settings)
        screened = screen(self.short, trying.short_before, kin)
        taken = screened[:SWAP_CANDIDATES]
        # the start says little of a delay; at the same joint a fit is worth its cost
        there = [s for s in screened if joint_of(s.effect) == joint_of(effect) is not None]
        taken += [s for s in there if s not in taken][:SWAP_CANDIDATES_THERE]
        for judged in trying.in_place(taken, best.fitted):
            simpler = self._without_idle(judged, before, best, acceptance)
            if acceptance.ranked([best, simpler])[0] is not simpler:
                continue
            if not acceptance.doubt(judged):
                return self.judge.judge(polished(self.comparison, simpler.fitted))
        return None

    def _without_idle(
        self, judged: Judged, before: Judged, best: Judged, acceptance: Acceptance
    ) -> Judged:
        """Drop the effects of a hypothesis that its new one makes insignificant."""
        for other in before.fitted.effects:
            without = self._without(judged, other)
            needed = acceptance.believed(lead_of(judged, without))
            if not needed and not acceptance.believed(lead_of(best, without)):
                judged = without
        return judged

    def _without(self, judged: Judged, effect: Effect) -> Judged:
        return self.judge.judge(fit_without(self.comparison, judged.fitted, effect))


def sure_ones(
    best: Judged,
    prepared: GapProblem,
    judge: Judge,
    seed: int,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Judged, list[Effect], Intervals]:
    """Drop effects whose 95 % intervals include zero, and refit the others.

    Parameters
    ----------
    best : Judged
        The hypothesis to improve.
    prepared : GapProblem
        The runs.
    judge : Judge
        Scores fits to ``prepared.fit``.
    seed : int
        Of the bootstrap.
    say : callable
        Receives the names of dropped effects.

    Returns
    -------
    (Judged, list of Effect, Intervals)
        The reduced fit, the dropped effects, and the intervals of the reduced fit.
    """
    dropped: list[Effect] = []
    while True:
        rng = np.random.default_rng(seed)
        fitted = best.fitted
        found = bootstrap(prepared.fit, fitted, rng)
        named = [(effect, fitted.structure.slice_of(effect)) for effect in fitted.effects]
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


def judged_without(effect: Effect, judged: Judged, prepared: GapProblem, judge: Judge) -> Judged:
    """Refit to ``prepared.fit`` without one effect, with fresh sensitivities."""
    return judge.judge(refined(fit_without(prepared.fit, judged.fitted, effect), prepared.fit))
