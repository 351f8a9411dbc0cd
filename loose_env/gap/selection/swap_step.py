"""Swap step: exchanges effects for confusable ones that fit better, and drops insignificant ones.

Forward selection identifies the first effect from a residual that is due to several. Its best proxy
for the mixture may have a better alternative, or need fewer effects beside it, once the others are
in the model; one of its own forms among them, such as a payload whose centre is off the tool, which
took a shift of the link's centre beside it. Effects whose 95 % confidence intervals include zero
are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, bootstrap, widened
from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer, improvement_of
from loose_env.gap.fitting.profile_bounds import tightened_at_limit, tightened_at_zero
from loose_env.gap.fitting.refit import (
    converged,
    fit_in_form,
    fit_without,
    needed_least,
    with_last,
    with_new_jacobian,
)
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of
from loose_env.gap.residuals.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import CandidateFits
from loose_env.gap.selection.screening.confusable_effects import confusable, joint_of, near
from loose_env.gap.selection.screening.data_driven_starts import proposals
from loose_env.gap.selection.screening.relinearised_sets import alternative_sets
from loose_env.gap.selection.screening.screening import screen
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.gap.settings import (
    ALTERNATIVES,
    EQUAL_LOG_LIKELIHOOD,
    FURTHER,
    LEADING,
    SHARE_IN_SET,
    SearchSettings,
)

_Key = tuple[str, str, str]
_ROUNDS = 3
"""Rounds of swaps at most; what is swapped in may have a better form itself."""
_MIN_GAIN_RATIO = 0.9
"""Predicted gain of one effect over that of two it may replace, from which it is fitted: cost."""


class SwapStep:
    """Swaps identified effects for confusable ones where the fit improves."""

    def __init__(
        self,
        comparison: ResidualModel,
        short: ResidualModel,
        scorer: Scorer,
        candidates: Sequence[Effect],
        base: ScoredFit,
        settings: SearchSettings,
    ) -> None:
        self.comparison, self.short, self.scorer = comparison, short, scorer
        self.candidates, self.base, self.settings = candidates, base, settings
        self._left: set[frozenset[_Key]] = set()
        self._tried: set[tuple[frozenset[_Key], frozenset[_Key]]] = set()

    def improved(
        self,
        best: ScoredFit,
        say: Callable[[str], None] = lambda _: None,
        *,
        white: bool = False,
    ) -> ScoredFit:
        """Return the best hypothesis after swaps; ``best`` itself if none is better.

        A hypothesis replaces another if it would have been ranked above it: its residual is
        smaller, or it fits equally well with fewer parameters. What was replaced does not return:
        of two that fit alike the one that was fitted last is ahead. Beside more than `LEADING`
        effects, and in place of two, only what promises to explain as much is fitted: a matter of
        cost.
        """
        for _ in range(_ROUNDS):
            found = self._round(best, say, white=white)
            if found is best:
                break
            best = found
        for _ in range(_ROUNDS):
            found = self._said(best, self._another_set(best), say)
            if found is best:
                break
            best = found
        return best

    def _round(self, best: ScoredFit, say: Callable[[str], None], *, white: bool) -> ScoredFit:
        """Try every effect of a hypothesis once, then every two at one joint."""
        for effect in () if white else best.fitted.effects:
            if not _among((effect,), best.fitted.effects):
                continue  # an effect that a swap made insignificant
            left_out = effect.has_stops and not self.settings.swap_stops
            if left_out or self._was_tried(best, (effect,)):
                continue
            before = self._before(best, (effect,))
            better = self._in_another_form(effect, best, before)
            if better is None:
                better = self._in_place_of((effect,), best, before)
            best = self._said(best, better, say)
        for two in combinations(best.fitted.effects, 2):
            there = {joint_of(effect) for effect in two}
            at_one_joint = len(there) == 1 and None not in there
            if _among(two, best.fitted.effects) and at_one_joint and not self._was_tried(best, two):
                better = self._in_place_of(two, best, self._before(best, two))
                best = self._said(best, better, say)
        return best

    def _said(
        self, best: ScoredFit, better: ScoredFit | None, say: Callable[[str], None]
    ) -> ScoredFit:
        """Return the better hypothesis, if there is one, and say what was swapped."""
        if better is None:
            return best
        self._left.add(_keys(best.fitted.effects))
        before, after = (", ".join(map(repr, each.fitted.effects)) for each in (best, better))
        say(f"  swapped {before} for {after}")
        return better

    def _was_tried(self, best: ScoredFit, replaced: Sequence[Effect]) -> bool:
        """Return whether swaps for some effects were tried beside the same ones that matter to it.

        Those are at the same joint or confusable: what another joint's effects have changed since
        is not worth all fits once more.
        """
        beside = [e for e in best.fitted.effects if not _among((e,), replaced)]
        there = [e for e in beside if any(near(e, each) for each in replaced)]
        key = _keys(replaced), _keys(there)
        known = key in self._tried
        self._tried.add(key)
        return known

    def _was_left(self, best: ScoredFit, replaced: Sequence[Effect], by: Effect) -> bool:
        """Return whether a hypothesis with some effects replaced by one was left before."""
        kept = [e for e in best.fitted.effects if not _among((e,), replaced)]
        return _keys((*kept, by)) in self._left

    def _before(self, best: ScoredFit, effects: Sequence[Effect]) -> Callable[[], ScoredFit]:
        """Return a function that gives a hypothesis without some effects, fitted once if asked."""

        @cache
        def before() -> ScoredFit:
            scored = best
            for effect in effects:
                scored = self._without(scored, effect)
            return scored

        return before

    def _in_another_form(
        self, effect: Effect, best: ScoredFit, before: Callable[[], ScoredFit]
    ) -> ScoredFit | None:
        """Return the best hypothesis with another form of an effect; None if none is better."""
        place = effect.kind, effect.where
        forms = [
            c
            for c in self.candidates
            if (c.kind, c.where) == place
            and c.key != effect.key
            and not self._was_left(best, (effect,), c)
        ]
        if not forms:
            return None
        acceptance = Acceptance(self.comparison, self.scorer, self.base, before(), self.settings)
        fits = (fit_in_form(self.comparison, best.fitted, effect, form) for form in forms)
        tried = sorted(map(self.scorer.score, fits), key=lambda scored: scored.total)
        return self._better(tried, before(), best, acceptance, min_gain=EQUAL_LOG_LIKELIHOOD)

    def _in_place_of(
        self, effects: Sequence[Effect], best: ScoredFit, without: Callable[[], ScoredFit]
    ) -> ScoredFit | None:
        """Return the best hypothesis with one or two effects replaced by one; None if none is."""
        named = {(e.kind, e.where) for e in best.fitted.effects}
        confusables = [
            c
            for c in self.candidates
            if all(confusable(e, c) for e in effects)
            and (c.kind, c.where) not in named
            and not self._was_left(best, effects, c)
        ]
        if not confusables:
            return None
        before = without()
        candidate_fits = CandidateFits(self.comparison, self.short, self.scorer, before)
        acceptance = Acceptance(self.comparison, self.scorer, self.base, before, self.settings)
        starts = proposals(self.comparison, before.fitted.hypothesis, confusables)
        screened = screen(self.short, candidate_fits.windows.before, confusables, proposed=starts)
        taken = screened[:ALTERNATIVES]
        if len(best.fitted.effects) <= LEADING and len(effects) == 1:
            # the start says little of a delay; at the same joint a fit is worth its cost
            there = [s for s in screened if joint_of(s.effect) == joint_of(effects[0]) is not None]
            taken += [s for s in there if s not in taken][:FURTHER]
        else:
            together = 1.0 - best.fitted.cost / before.fitted.cost
            taken = [s for s in taken if s.predicted > _MIN_GAIN_RATIO * together]
        tried = candidate_fits.replacements(taken, best.fitted)
        return self._better(tried, before, best, acceptance)

    def _another_set(self, best: ScoredFit) -> ScoredFit | None:
        """Return a set that explains more than all effects together; None if none does.

        Each of its effects passes the tests of a step beside the others.
        """
        # torques are compared with motion so quickly that all of them tell
        inverse = bool(self.comparison.rows.inverse.all())
        runs = self.comparison if inverse else self.short
        left = runs.residuals([best.fitted.hypothesis])[0]
        if np.log(np.mean(left**2)) < SHARE_IN_SET:
            return None  # too little above the noise for one more effect
        windows = WindowFits(runs, best.fitted)
        keys = _keys(best.fitted.effects)
        others = [c for c in self.candidates if c.key not in keys]
        starts = proposals(self.comparison, best.fitted.hypothesis, others)
        screened = screen(runs, windows.before, others, proposed=starts)
        nuisances = len(best.fitted.structure.nuisance.parameters)
        for each in alternative_sets(runs, windows.before, screened, FURTHER):
            if _keys(each.effects) in self._left | {keys}:
                continue
            structure = best.fitted.structure.with_effects(each.effects)
            own = [
                free_of(effect.parameters, np.array(values))
                for effect, values in zip(each.effects, each.values, strict=True)
            ]
            start = np.concatenate([best.fitted.free[:nuisances], *own])
            quick = fit(runs, structure, start)
            if quick.cost >= windows.before.cost:
                continue
            start = np.concatenate([best.fitted.free[:nuisances], quick.free[nuisances:]])
            found = self._needed(self.scorer.score(fit(self.comparison, structure, start)))
            acceptance = Acceptance(self.comparison, self.scorer, self.base, best, self.settings)
            another = _keys(found.fitted.effects) != keys
            if another and acceptance.ranked([best, found])[0] is found:
                return self.scorer.score(converged(self.comparison, found.fitted))
        return None

    def _needed(self, scored: ScoredFit) -> ScoredFit:
        """Drop effects that would not be accepted beside the others, the one needed least first."""
        while scored.fitted.effects:
            weak = needed_least(self.comparison, scored.fitted, scored.fitted.effects)[:FURTHER]
            for effect in weak:
                without = self._without(scored, effect)
                beside = Acceptance(self.comparison, self.scorer, self.base, without, self.settings)
                if not beside.accepts(replace(scored, fitted=with_last(scored.fitted, effect))):
                    break
            else:
                break
            scored = without
        return scored

    def _better(
        self,
        tried: Sequence[ScoredFit],
        before: ScoredFit,
        best: ScoredFit,
        acceptance: Acceptance,
        *,
        min_gain: float = -np.inf,
    ) -> ScoredFit | None:
        """Return the first of some replacements that is better than what it replaces.

        One that leaves as many effects is also ahead by ``min_gain`` in twice the log-likelihood.
        """
        for scored in tried:
            close = scored.total - best.total <= EQUAL_LOG_LIKELIHOOD
            if not close and not acceptance.ties(best, scored):
                continue
            simpler = self._without_insignificant(scored, before, best, acceptance)
            fewer = len(simpler.fitted.effects) < len(best.fitted.effects)
            if not fewer and best.total - simpler.total < min_gain:
                continue
            if acceptance.ranked([best, simpler])[0] is not simpler:
                continue
            if not acceptance.objection(scored):
                return self.scorer.score(converged(self.comparison, simpler.fitted))
        return None

    def _without_insignificant(
        self, scored: ScoredFit, before: ScoredFit, best: ScoredFit, acceptance: Acceptance
    ) -> ScoredFit:
        """Drop the effects that the new one makes insignificant, the one needed least first."""
        others = list(before.fitted.effects)
        while others:
            for other in acceptance.weakest(scored, others):
                without = self._without(scored, other)
                needed = acceptance.significant(improvement_of(scored, without))
                if not needed and not acceptance.significant(improvement_of(best, without)):
                    scored, others = without, [each for each in others if each is not other]
                    break
            else:
                break
        return scored

    def _without(self, scored: ScoredFit, effect: Effect) -> ScoredFit:
        return self.scorer.score(fit_without(self.comparison, scored.fitted, effect, roughly=True))


def drop_insignificant(
    best: ScoredFit,
    problem: GapProblem,
    scorer: Scorer,
    seed: int,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[ScoredFit, Intervals]:
    """Drop effects whose 95 % intervals include zero, and refit the others."""
    while True:
        rng = np.random.default_rng(seed)
        fitted = best.fitted
        found = bootstrap(problem.fit, fitted, rng)
        named = [(effect, fitted.structure.slice_of(effect)) for effect in fitted.effects]
        for effect, own in named:
            if found.include_zero(effect, own):
                found = tightened_at_limit(problem.fit, fitted, found, effect)
            if found.include_zero(effect, own):
                found = tightened_at_zero(problem.fit, fitted, found, effect)
        doubtful = [effect for effect, own in named if found.include_zero(effect, own)]
        if not doubtful:
            return best, widened(problem.fit, fitted, found)
        say(f"  dropped {doubtful[-1]!r}: its 95 % confidence interval includes zero")
        best = refit_without(doubtful[-1], best, problem, scorer)


def refit_without(
    effect: Effect, scored: ScoredFit, problem: GapProblem, scorer: Scorer
) -> ScoredFit:
    """Refit to ``problem.fit`` without one effect, with fresh sensitivities."""
    return scorer.score(
        with_new_jacobian(fit_without(problem.fit, scored.fitted, effect), problem.fit)
    )


def _among(some: Sequence[Effect], effects: Sequence[Effect]) -> bool:
    """Return whether all of some effects are still among others, by identity."""
    return all(any(one is each for each in effects) for one in some)


def _keys(effects: Sequence[Effect]) -> frozenset[_Key]:
    """What tells a hypothesis from others, whatever its values."""
    return frozenset(effect.key for effect in effects)
