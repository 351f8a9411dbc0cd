"""Acceptance criteria for effects, and pruning of effects that are insignificant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import Judge, Judged, Lead, lead_of
from loose_env.gap.fitting.refit import fit_without, polished
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.negligible import slight
from loose_env.gap.selection.screening.grouping import joint_of
from loose_env.gap.settings import (
    ACCEPTED_SHARE,
    ACCEPTED_SHARE_OF_NOMINAL,
    ACCEPTED_Z,
    CHANNEL_SHARE,
    CHANNEL_SHARE_OF_NOMINAL,
    CHANNEL_Z,
    CONFIRMED_Z,
    EQUAL_LOG_LIKELIHOOD,
    OWN_GAIN,
    SEARCH_Z,
    TIE_Z,
    VISIBLE_FALL,
    WORTH_PARAMETERS,
    WORTH_SHARE,
    SearchSettings,
)
from loose_env.typing import Array

__all__ = ["Acceptance", "share_above_noise"]


def share_above_noise(before: Array, after: Array) -> float:
    """Return the share of a reduction in mean square that lies above the noise.

    Parameters
    ----------
    before, after : ndarray (N,)
        Residuals in noise standard deviations.

    Examples
    --------
    >>> ones = np.ones(4)
    >>> round(share_above_noise(3.0 * ones, 1.1 * ones), 2), share_above_noise(ones, 0.9 * ones)
    (1.0, 0.0)
    """
    high, low = float(np.mean(before**2)), float(np.mean(after**2))
    return max(0.0, high - max(low, 1.0)) / (high - low) if high > low else 0.0


class Acceptance:
    """Accepts or rejects hypotheses that add effects to the current model.

    Parameters
    ----------
    comparison : Comparison
        The training runs.
    judge : Judge
        Scores fits on the held-out runs.
    base, before : Judged
        The nominal model, and the current model.
    settings : SearchSettings
        Acceptance thresholds.
    """

    def __init__(
        self,
        comparison: Comparison,
        judge: Judge,
        base: Judged,
        before: Judged,
        settings: SearchSettings,
    ) -> None:
        self.comparison, self.judge = comparison, judge
        self.base, self.before, self.settings = base, before, settings

    def ranked(self, tried: Sequence[Judged]) -> list[Judged]:
        """Sort hypotheses, preferring fewer parameters where the fit is not better.

        Additional parameters always reduce the residual a little: the best hypothesis has to
        explain some of the residual of the simpler one, and that residual has to exceed the noise.
        Among hypotheses with equal residuals, such as a rotor inertia and a link inertia on a
        vertical axis, the one that changes the model least comes first.
        """
        found, settings = sorted(tried, key=lambda j: j.total), self.settings
        same = [j for j in found if j.total - found[0].total < EQUAL_LOG_LIKELIHOOD]
        same = [j for j in same if j.free_count == found[0].free_count]
        least = min(same, key=self._change, default=None)
        found.sort(key=lambda j: j is not least)
        for judged in sorted(found[1:], key=lambda j: j.free_count):
            if judged.free_count >= found[0].free_count:
                break
            lead = lead_of(found[0], judged)
            chance = lead.held < TIE_Z and lead.fitted < TIE_Z
            small = abs(found[0].total - judged.total) < WORTH_PARAMETERS * found[0].total
            small = small and min(lead.held, lead.fitted) < settings.sufficient_z
            whole = judged.structure_sureness < SEARCH_Z
            if chance or (small and (whole or lead.share < WORTH_SHARE)):
                return [judged, *(j for j in found if j is not judged)]
        return found

    def worth_naming(self, judged: Judged) -> bool:
        """Return whether a hypothesis improves significantly, and by enough."""
        lead = lead_of(judged, self.before)
        material = self._visible(judged) and self._material(judged, lead)
        material = material and not slight(judged.fitted.hypothesis, self._new(judged))
        return self.believed(lead) and material

    def doubt(self, judged: Judged) -> str:
        """Return the objection to a hypothesis that improves by enough; "" if none."""
        if not self.ahead_of_its_limit(judged):
            return "no better than if it were rigid"
        if not self.above_the_noise(judged):
            return "shuts out noise of the motion, no more"
        if not self.needed_beside_stops(judged):
            return "the play beside it does as well alone"
        return ""

    def ahead_of_its_limit(self, judged: Judged) -> bool:
        """Return whether an effect beats its own limit case, simulated the same way.

        An effect with additional degrees of freedom is simulated by another method than the rigid
        arm, above all in inverse dynamics. It also has to improve on its own limit in which the
        additional coordinate does not move: as significantly as on the previous model, or by less
        where most of its gain is its own.
        """
        effect, fitted = judged.fitted.effects[-1], judged.fitted
        if not effect.limit or self._new(judged) > 1:
            return True
        own = fitted.structure.slices[-1]
        values = effect.at_limit(values_of(effect.parameters, fitted.free[own]))
        free = np.concatenate([self.before.fitted.free, free_of(effect.parameters, values)])
        residual = self.comparison.residuals([fitted.structure.hypothesis(free)])[0]
        rigid = self.judge.judge(replace(fitted, free=free, residual=residual))
        lead = lead_of(judged, rigid, strikes=effect.has_stops)
        before, after, limit = (
            float(j.fitted_blocks.sum() + j.held_blocks.sum()) for j in (self.before, judged, rigid)
        )
        mostly = before - limit < (1 - OWN_GAIN) * (before - after)
        return self.believed(lead) or (mostly and min(lead.held, lead.fitted) >= CONFIRMED_Z)

    def needed_beside_stops(self, judged: Judged) -> bool:
        """Return whether an effect beside stops is needed, not due to a local optimum.

        The fit of a part with stops has many local optima, some slightly better than others. A
        later fit starts from one of them and may end at another; that optimum then fits equally
        well without the later effect.
        """
        if not have_stops(self.before.fitted.effects) or self._new(judged) > 1:
            return True
        return self.believed(lead_of(judged, self._without(judged, judged.fitted.effects[-1])))

    def above_the_noise(self, judged: Judged) -> bool:
        """Return whether the gain of an added motion in inverse runs is above noise.

        The inverse dynamics torque carries the noise of the measured acceleration. Behind a spring
        this noise is attenuated, whether or not the machine has a spring: most of the gain
        therefore has to come from the residual above the noise.
        """
        inverse = [c.rows.inverse for c in (self.comparison, self.judge.held_out)]
        new = judged.fitted.effects[-self._new(judged) :]
        if not any(effect.adds_motion for effect in new) or not any(i.any() for i in inverse):
            return True
        before, after = (
            np.concatenate(
                [j.fitted.residual[inverse[0]], j.held_residual[inverse[1]]],
            )
            for j in (self.before, judged)
        )
        return share_above_noise(before, after) > OWN_GAIN

    def accept(self, judged: Judged) -> tuple[Judged, list[Effect]]:
        """Refit the accepted hypothesis and drop an effect that became insignificant.

        Returns
        -------
        Judged
            With fresh sensitivities.
        list of Effect
            Earlier effects that are dropped, one at most.
        """
        best = self.judge.judge(polished(self.comparison, judged.fitted))
        best = self._pruned(best, self._new(judged))
        for effect in best.fitted.effects[: len(self.before.fitted.effects)]:
            without = self._without(best, effect)
            if not self.believed(lead_of(best, without)):
                rather = self.rather(best, effect)
                if rather is not None and rather.total < without.total:
                    return rather, []
                return without, [effect]
        return best, []

    def rather(self, judged: Judged, effect: Effect) -> Judged | None:
        """Return the earlier form of an insignificant effect, without its replacement.

        A joint fit of many effects may assign one joint the wrong one of two: a compliant servo, or
        a friction of the same resistance. A stepwise fit does not recover from that.
        """
        count, fitted = len(self.before.fitted.effects), judged.fitted
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
        return self.judge.judge(fit(self.comparison, structure, start))

    def _pruned(self, judged: Judged, new: int) -> Judged:
        """Drop those of several new effects that are insignificant by themselves."""
        while new > 1:
            without = [self._without(judged, effect) for effect in judged.fitted.effects[-new:]]
            leads = [lead_of(judged, each) for each in without]
            weakest = min(range(new), key=lambda k: leads[k].fitted + leads[k].held)
            if self.believed(leads[weakest]):
                break
            judged, new = without[weakest], new - 1
        return judged

    def _change(self, judged: Judged) -> float:
        """Return the size of the new effects of a hypothesis, in the parameters' scales."""
        structure, far = judged.fitted.structure, 0.0
        effects = structure.effects
        first = len(effects) - max(self._new(judged), 0)
        for effect, own in zip(effects[first:], structure.slices[first:], strict=True):
            if effect.nothing is None:
                return np.inf
            nothing = free_of(effect.parameters, np.array(effect.nothing))
            far = max(far, float(np.max(np.abs(judged.fitted.free[own] - nothing))))
        return far

    def _new(self, judged: Judged) -> int:
        """Return the number of effects that a hypothesis adds."""
        return len(judged.fitted.effects) - len(self.before.fitted.effects)

    def _without(self, judged: Judged, effect: Effect) -> Judged:
        return self.judge.judge(fit_without(self.comparison, judged.fitted, effect))

    def believed(self, lead: Lead) -> bool:
        """Return whether an improvement is significant in both data sets, and high in one."""
        one, other = lead.fitted, lead.held
        return min(one, other) >= CONFIRMED_Z and max(one, other) >= ACCEPTED_Z

    def _visible(self, judged: Judged) -> bool:
        """Return whether the sum of squares falls by more than its sampling error.

        A sum of N squares of unit noise has a standard deviation of about sqrt(2 N). A smaller
        gain, however significant, is the remainder of an effect that is already in the model.
        """
        held = float(self.before.held_blocks.sum() - judged.held_blocks.sum())
        fitted = float(self.before.fitted_blocks.sum() - judged.fitted_blocks.sum())
        count, others = len(judged.held_residual), len(judged.fitted.residual)
        least = VISIBLE_FALL
        alone = held > least * np.sqrt(2 * count)
        return bool(alone or held + fitted > least * np.sqrt(2 * (count + others)))

    def _material(self, judged: Judged, lead: Lead) -> bool:
        """Return whether enough is explained: a slightly wrong law admits many effects."""
        settings, base = self.settings, self.base
        gained = self.before.structure - judged.structure
        if lead.share >= ACCEPTED_SHARE or gained >= ACCEPTED_SHARE_OF_NOMINAL * base.structure:
            return True
        if min(lead.held, lead.fitted) >= settings.sufficient_z:
            return True
        # An effect may act at every joint: a small share of the total can be a large share of a
        # channel.
        gains = self.before.channel_structure[0] - judged.channel_structure[0]
        for there, share in (
            (base.channel_structure, CHANNEL_SHARE_OF_NOMINAL),
            (self.before.channel_structure, CHANNEL_SHARE),
        ):
            whole, count = there
            sure = whole > CHANNEL_Z * np.sqrt(count)
            if np.any(sure & (gains >= share * whole)):
                return True
        return False
