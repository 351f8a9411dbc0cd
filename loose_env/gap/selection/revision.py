"""Tries what looks like a named effect in its place, once the others are there.

A search that adds one effect after the other names the first one by a gap that is that of several.
What stood in best for the mixture may have a better rival, or need fewer effects beside it, when
the others are in the model.

Which effects stay: those whose 95 % intervals do not include nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, bootstrap, widened
from loose_env.gap.fitting.gauss_newton import slice_of
from loose_env.gap.fitting.holdout_score import Judge, Judged, lead_of
from loose_env.gap.fitting.profile_bounds import short_of_limit, short_of_nothing
from loose_env.gap.fitting.refit import fit_without, polished, refined
from loose_env.gap.model.effect import Effect
from loose_env.gap.preparation.prepare import Prepared
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import Trying
from loose_env.gap.selection.screening.grouping import akin, joint_of
from loose_env.gap.selection.screening.screening import screen
from loose_env.gap.settings import NamingSettings

__all__ = ["Exchange", "judged_without", "sure_ones"]


class Exchange:
    """Exchanges named effects for such as they may be mistaken for, where that is better.

    Parameters
    ----------
    comparison, short : Comparison
        The runs to fit to, and the windows of them that sort candidates.
    judge : Judge
        Judges what was fitted to all data.
    candidates : sequence of Effect
        The catalogue at every place.
    base : Judged
        The nominal model.
    settings : NamingSettings
        How many are tried: `NamingSettings.exchanged` at most are looked at for each effect.
    """

    def __init__(
        self,
        comparison: Comparison,
        short: Comparison,
        judge: Judge,
        candidates: Sequence[Effect],
        base: Judged,
        settings: NamingSettings,
    ) -> None:
        self.comparison, self.short, self.judge = comparison, short, judge
        self.candidates, self.base, self.settings = candidates, base, settings

    def better_than(self, best: Judged, say: Callable[[str], None] = lambda _: None) -> Judged:
        """The best hypothesis that exchanges lead to; ``best`` itself where nothing is better.

        A hypothesis takes the place of another if it would have been ranked above it: it leaves
        less, or it does as well with fewer parameters.

        Parameters
        ----------
        best : Judged
            What was found.
        say : callable
            Told what goes on, line by line.
        """
        for effect in best.fitted.named:
            if not any(effect is each for each in best.fitted.effects):
                continue  # one that an exchange made idle
            if effect.has_stops and not self.settings.exchanges_stops:
                continue
            better = self._in_place_of(effect, best)
            if better is not None:
                before, after = (
                    ", ".join(map(repr, judged.fitted.named)) for judged in (best, better)
                )
                say(f"  {after} in the place of {before}")
                best = better
        return best

    def _in_place_of(self, effect: Effect, best: Judged) -> Judged | None:
        """The best hypothesis with another effect in the place of one; None if none is better."""
        named = {(e.kind, e.where) for e in best.fitted.effects}
        kin = [c for c in self.candidates if akin(effect, c) and (c.kind, c.where) not in named]
        if not kin:
            return None
        before = self._without(best, effect)
        trying = Trying(self.comparison, self.short, self.judge, before, self.settings)
        acceptance = Acceptance(self.comparison, self.judge, self.base, before, self.settings)
        screened = screen(self.short, trying.short_before, kin)
        taken = screened[: self.settings.exchanged]
        # where a fit begins says little of a delay; at the same joint it is worth a fit
        there = [s for s in screened if joint_of(s.effect) == joint_of(effect) is not None]
        taken += [s for s in there if s not in taken][: self.settings.exchanged_there]
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
        """A hypothesis without the effects that its new one makes idle."""
        for other in before.fitted.named:
            without = self._without(judged, other)
            needed = acceptance.believed(lead_of(judged, without))
            if not needed and not acceptance.believed(lead_of(best, without)):
                judged = without
        return judged

    def _without(self, judged: Judged, effect: Effect) -> Judged:
        return self.judge.judge(fit_without(self.comparison, judged.fitted, effect))


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
