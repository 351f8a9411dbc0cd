"""Acceptance criteria for hypotheses that add effects; ties; effects at a bound dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import Improvement, ScoredFit, Scorer, improvement_of
from loose_env.gap.fitting.refit import converged, fit_without, needed_least
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.deletion import at_bound, worse_quantity
from loose_env.gap.selection.negligible import negligible
from loose_env.gap.selection.screening.confusable_effects import joint_of
from loose_env.gap.settings import (
    ACCEPTED_SHARE,
    ACCEPTED_SHARE_OF_NOMINAL,
    ACCEPTED_Z,
    CHANNEL_SHARE,
    CHANNEL_SHARE_OF_NOMINAL,
    CHANNEL_Z,
    CONFIRMED_Z,
    EQUAL_LOG_LIKELIHOOD,
    FURTHER,
    OWN_GAIN,
    SEARCH_Z,
    TIE_Z,
    VISIBLE_FALL,
    WORTH_PARAMETERS,
    WORTH_SHARE,
    SearchSettings,
)
from loose_env.typing import Array


def share_above_noise(before: Array, after: Array) -> float:
    """Return the share of a reduction in mean square that lies above the noise.

    Examples
    --------
    >>> ones = np.ones(4)
    >>> round(share_above_noise(3.0 * ones, 1.1 * ones), 2), share_above_noise(ones, 0.9 * ones)
    (1.0, 0.0)
    """
    high, low = float(np.mean(before**2)), float(np.mean(after**2))
    return max(0.0, high - max(low, 1.0)) / (high - low) if high > low else 0.0


class Acceptance:
    """Accepts or rejects hypotheses that add effects to the current model."""

    def __init__(
        self,
        comparison: ResidualModel,
        scorer: Scorer,
        base: ScoredFit,
        before: ScoredFit,
        settings: SearchSettings,
    ) -> None:
        self.comparison, self.scorer = comparison, scorer
        self.base, self.before, self.settings = base, before, settings

    def ranked(self, tried: Sequence[ScoredFit]) -> list[ScoredFit]:
        """Sort hypotheses, preferring fewer parameters where the fit is not better.

        Additional parameters always reduce the residual a little: the best hypothesis has to
        explain some of the residual of the simpler one, and that residual has to exceed the noise.
        Among hypotheses with equal residuals, such as a rotor inertia and a link inertia on a
        vertical axis, the one that changes the model least comes first.
        """
        found = sorted(tried, key=lambda j: j.total)
        same = [j for j in found if j.total - found[0].total < EQUAL_LOG_LIKELIHOOD]
        same = [j for j in same if j.free_count == found[0].free_count]
        least = min(same, key=self._change, default=None)
        found.sort(key=lambda j: j is not least)
        for scored in sorted(found[1:], key=lambda j: j.free_count):
            if scored.free_count >= found[0].free_count:
                break
            if self.ties(found[0], scored):
                return [scored, *(j for j in found if j is not scored)]
        return found

    def ties(self, ahead: ScoredFit, behind: ScoredFit) -> bool:
        """Return whether a hypothesis that fits better does so too little for further parameters.

        What is dropped from the one behind only makes it fit worse: if it does not tie, no
        simplification of it does.
        """
        improvement = improvement_of(ahead, behind)
        chance = improvement.held_out < TIE_Z and improvement.training < TIE_Z
        small = abs(ahead.total - behind.total) < WORTH_PARAMETERS * ahead.total
        least = min(improvement.held_out, improvement.training)
        small = small and least < self.settings.sufficient_z
        whole = behind.autocorrelation_z < SEARCH_Z
        return chance or (small and (whole or improvement.share < WORTH_SHARE))

    def accepts(self, scored: ScoredFit) -> bool:
        """Return whether a hypothesis improves significantly, and by enough."""
        improvement = improvement_of(scored, self.before)
        material = self._visible(scored) and self._material(scored, improvement)
        material = material and not negligible(scored.fitted.hypothesis, self._new(scored))
        return self.significant(improvement) and material

    def within_bounds(self, scored: ScoredFit) -> ScoredFit:
        """Drop those of several new effects that end at a bound, one by one, and refit the others.

        A parameter at its bound is no finding, and does not speak against the effects beside it.
        """
        while self._new(scored) > 1:
            new = scored.fitted.effects[-self._new(scored) :]
            at = at_bound(scored.fitted.structure, scored.fitted.free)
            bounded = [effect for effect, _ in at if any(effect is each for each in new)]
            if not bounded:
                break
            scored = self._without(scored, bounded[-1])
        return scored

    def objection(self, scored: ScoredFit) -> str:
        """Return the objection to a hypothesis that improves by enough; "" if none."""
        new = scored.fitted.effects[-self._new(scored) :]
        for effect, name in at_bound(scored.fitted.structure, scored.fitted.free):
            if any(effect is each for each in new):
                return f"{name} is at its bound"
        if quantity := worse_quantity(self.scorer.held_out, scored, self.base):
            return f"predicts the {quantity.partition(' [')[0]} worse than the nominal model"
        if not self.better_than_limit(scored):
            return "not better than its rigid limit"
        if not self.above_the_noise(scored):
            return "attenuates noise of the measured motion only"
        if not self.needed_beside_stops(scored):
            return "not needed beside the part with stops"
        return ""

    def better_than_limit(self, scored: ScoredFit) -> bool:
        """Return whether an effect beats its own limit case, simulated the same way.

        An effect with additional degrees of freedom is simulated by another method than the rigid
        arm, above all in inverse dynamics. It also has to improve on its own limit in which the
        additional coordinate does not move: as significantly as on the previous model, or by less
        where most of its gain is its own.
        """
        effect, fitted = scored.fitted.effects[-1], scored.fitted
        if not effect.limit or self._new(scored) > 1:
            return True
        own = fitted.structure.slices[-1]
        values = effect.at_limit(values_of(effect.parameters, fitted.free[own]))
        free = np.concatenate([self.before.fitted.free, free_of(effect.parameters, values)])
        residual = self.comparison.residuals([fitted.structure.hypothesis(free)])[0]
        rigid = self.scorer.score(replace(fitted, free=free, residual=residual))
        improvement = improvement_of(scored, rigid, by_rank=effect.has_stops)
        before, after, limit = (
            float(j.training_blocks.sum() + j.held_out_blocks.sum())
            for j in (self.before, scored, rigid)
        )
        mostly = before - limit < (1 - OWN_GAIN) * (before - after)
        return self.significant(improvement) or (
            mostly and min(improvement.held_out, improvement.training) >= CONFIRMED_Z
        )

    def needed_beside_stops(self, scored: ScoredFit) -> bool:
        """Return whether an effect beside stops is needed, not due to a local optimum.

        The fit of a part with stops has many local optima, some slightly better than others. A
        later fit starts from one of them and may end at another; that optimum then fits equally
        well without the later effect.
        """
        if not have_stops(self.before.fitted.effects) or self._new(scored) > 1:
            return True
        return self.significant(
            improvement_of(scored, self._without(scored, scored.fitted.effects[-1]))
        )

    def above_the_noise(self, scored: ScoredFit) -> bool:
        """Return whether the gain of an added motion in inverse runs is above noise.

        The inverse dynamics torque carries the noise of the measured acceleration. Behind a spring
        this noise is attenuated, whether or not the machine has a spring: most of the gain
        therefore has to come from the residual above the noise.
        """
        inverse = [c.rows.inverse for c in (self.comparison, self.scorer.held_out)]
        new = scored.fitted.effects[-self._new(scored) :]
        if not any(effect.adds_motion for effect in new) or not any(i.any() for i in inverse):
            return True
        before, after = (
            np.concatenate(
                [j.fitted.residual[inverse[0]], j.held_out_residual[inverse[1]]],
            )
            for j in (self.before, scored)
        )
        return share_above_noise(before, after) > OWN_GAIN

    def accept(self, scored: ScoredFit) -> tuple[ScoredFit, list[Effect]]:
        """Refit the accepted hypothesis and drop an effect that became insignificant."""
        whole = self._converged(scored)
        best = self._pruned(whole, self._new(scored))
        earlier = best.fitted.effects[: len(self.before.fitted.effects)]
        for effect in self.weakest(best, earlier):
            without = self._without(best, effect)
            if not self.significant(improvement_of(best, without)):
                rather = self.earlier_form(best, effect)
                if rather is not None and rather.total < without.total:
                    return self._converged(rather), []
                return self._converged(without), [effect]
        return (best if best is whole else self._converged(best)), []

    def earlier_form(self, scored: ScoredFit, effect: Effect) -> ScoredFit | None:
        """Return the earlier form of an insignificant effect, without its replacement.

        A joint fit of many effects may assign one joint the wrong one of two: a compliant servo, or
        a friction of the same resistance. A stepwise fit does not recover from that.
        """
        count, fitted = len(self.before.fitted.effects), scored.fitted
        joint = joint_of(effect)
        new = [
            (later, fitted.free[own])
            for later, own in zip(
                fitted.effects[count:], fitted.structure.slices[count:], strict=True
            )
        ]
        kept = [(e, v) for e, v in new if joint is None or joint_of(e) != joint]
        if not kept or len(kept) == len(new):
            return None
        structure = fitted.structure.with_effects((*fitted.effects[:count], *(e for e, _ in kept)))
        start = np.concatenate([self.before.fitted.free, *(values for _, values in kept)])
        return self.scorer.score(fit(self.comparison, structure, start))

    def _pruned(self, scored: ScoredFit, new: int) -> ScoredFit:
        """Drop those of several new effects that are insignificant by themselves."""
        while new > 1:
            weak = self.weakest(scored, scored.fitted.effects[-new:])
            without = [self._without(scored, effect) for effect in weak]
            improvements = [improvement_of(scored, each) for each in without]
            weakest = min(
                range(len(weak)), key=lambda k: improvements[k].training + improvements[k].held_out
            )
            if self.significant(improvements[weakest]):
                break
            scored, new = without[weakest], new - 1
        return scored

    def weakest(self, scored: ScoredFit, effects: Sequence[Effect]) -> list[Effect]:
        """Return the few of some effects that seem to be needed least, the least first."""
        if len(effects) < 2:
            return list(effects)
        return needed_least(self.comparison, scored.fitted, effects)[:FURTHER]

    def _change(self, scored: ScoredFit) -> float:
        """Return the size of the new effects of a hypothesis, in the parameters' scales."""
        structure, far = scored.fitted.structure, 0.0
        effects = structure.effects
        first = len(effects) - max(self._new(scored), 0)
        for effect, own in zip(effects[first:], structure.slices[first:], strict=True):
            if effect.null_values is None:
                return np.inf
            null = free_of(effect.parameters, np.array(effect.null_values))
            far = max(far, float(np.max(np.abs(scored.fitted.free[own] - null))))
        return far

    def _new(self, scored: ScoredFit) -> int:
        """Return the number of effects that a hypothesis adds."""
        return len(scored.fitted.effects) - len(self.before.fitted.effects)

    def _converged(self, scored: ScoredFit) -> ScoredFit:
        return self.scorer.score(converged(self.comparison, scored.fitted))

    def _without(self, scored: ScoredFit, effect: Effect) -> ScoredFit:
        return self.scorer.score(fit_without(self.comparison, scored.fitted, effect, roughly=True))

    def significant(self, improvement: Improvement) -> bool:
        """Return whether an improvement is significant in both data sets, and high in one."""
        one, other = improvement.training, improvement.held_out
        return min(one, other) >= CONFIRMED_Z and max(one, other) >= ACCEPTED_Z

    def _visible(self, scored: ScoredFit) -> bool:
        """Return whether the sum of squares falls by more than its sampling error.

        A sum of N squares of unit noise has a standard deviation of about sqrt(2 N). A smaller
        gain, however significant, is the remainder of an effect that is already in the model.
        """
        held = float(self.before.held_out_blocks.sum() - scored.held_out_blocks.sum())
        fitted = float(self.before.training_blocks.sum() - scored.training_blocks.sum())
        count, others = len(scored.held_out_residual), len(scored.fitted.residual)
        least = VISIBLE_FALL
        alone = held > least * np.sqrt(2 * count)
        return bool(alone or held + fitted > least * np.sqrt(2 * (count + others)))

    def _material(self, scored: ScoredFit, improvement: Improvement) -> bool:
        """Return whether enough is explained: a slightly wrong law admits many effects."""
        settings, base = self.settings, self.base
        gained = self.before.autocorrelated - scored.autocorrelated
        if (
            improvement.share >= ACCEPTED_SHARE
            or gained >= ACCEPTED_SHARE_OF_NOMINAL * base.autocorrelated
        ):
            return True
        if min(improvement.held_out, improvement.training) >= settings.sufficient_z:
            return True
        # An effect may act at every joint: a small share of the total can be a large share of a
        # channel.
        gains = self.before.channel_products[0] - scored.channel_products[0]
        for there, share in (
            (base.channel_products, CHANNEL_SHARE_OF_NOMINAL),
            (self.before.channel_products, CHANNEL_SHARE),
        ):
            whole, count = there
            sure = whole > CHANNEL_Z * np.sqrt(count)
            if np.any(sure & (gains >= share * whole)):
                return True
        return False
