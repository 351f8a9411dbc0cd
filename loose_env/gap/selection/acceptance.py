"""Whether a hypothesis is believed, explains enough, and which of its effects stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import UNNAMED, fit, hypothesis_of, slices_of, strikes
from loose_env.gap.fitting.holdout_score import Judge, Judged, Lead, lead_of
from loose_env.gap.fitting.refit import fit_without, polished
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.negligible import slight
from loose_env.gap.selection.screening.grouping import joint_of
from loose_env.gap.settings import NamingSettings
from loose_env.typing import Array

__all__ = ["Acceptance", "share_above_noise"]


_MOST = 0.5
"""Share of a gain that counts as most of it."""


def share_above_noise(before: Array, after: Array) -> float:
    """Share of a fall in mean square that lies above the noise.

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
    """Decides on hypotheses that add to what is there.

    Parameters
    ----------
    comparison : Comparison
        The runs fitted to.
    judge : Judge
        Judges by those held out.
    base, before : Judged
        The nominal model, and what is there.
    settings : NamingSettings
        What is asked for.
    """

    def __init__(
        self,
        comparison: Comparison,
        judge: Judge,
        base: Judged,
        before: Judged,
        settings: NamingSettings,
    ) -> None:
        self.comparison, self.judge = comparison, judge
        self.base, self.before, self.settings = base, before, settings

    def ranked(self, tried: Sequence[Judged]) -> list[Judged]:
        """The best first; but one with fewer parameters if the best is not ahead of it.

        More parameters fit a little better everywhere, surely and to no purpose: the best has to
        explain some of what the simpler one leaves, and there has to be something left. Of those
        that leave the same, such as a rotor and a link on a vertical axis, the one comes first that
        changes the machine least.
        """
        found, settings = sorted(tried, key=lambda j: j.total), self.settings
        same = [j for j in found if j.total - found[0].total < settings.same]
        same = [j for j in same if j.free_count == found[0].free_count]
        least = min(same, key=self._change, default=None)
        found.sort(key=lambda j: j is not least)
        for judged in sorted(found[1:], key=lambda j: j.free_count):
            if judged.free_count >= found[0].free_count:
                break
            lead = lead_of(found[0], judged)
            chance = lead.held < settings.tie and lead.fitted < settings.tie
            small = abs(found[0].total - judged.total) < settings.worth * found[0].total
            small = small and min(lead.held, lead.fitted) < settings.everywhere
            whole = judged.structure_sureness < settings.structure
            if chance or (small and (whole or lead.share < settings.more)):
                return [judged, *(j for j in found if j is not judged)]
        return found

    def worth_naming(self, judged: Judged) -> bool:
        """Whether a hypothesis is ahead, and by enough."""
        lead = lead_of(judged, self.before)
        material = self._visible(judged) and self._material(judged, lead)
        material = material and not slight(judged.fitted.hypothesis, self._new(judged))
        return self.believed(lead) and material

    def doubt(self, judged: Judged) -> str:
        """What speaks against a hypothesis that is ahead by enough; "" where nothing does."""
        if not self.ahead_of_its_limit(judged):
            return "no better than if it were rigid"
        if not self.above_the_noise(judged):
            return "shuts out noise of the motion, no more"
        if not self.needed_beside_stops(judged):
            return "the play beside it does as well alone"
        return ""

    def ahead_of_its_limit(self, judged: Judged) -> bool:
        """Whether an effect explains more than the way in which it is simulated.

        One that adds motion is simulated by another route than the rigid arm, above all
        backwards. It has to be ahead of itself at the limit in which nothing moves, too: as surely
        as ahead of what was there, or by less where most of its gain is its own.
        """
        effect, fitted = judged.fitted.effects[-1], judged.fitted
        if not effect.limit or self._new(judged) > 1:
            return True
        own = slices_of(fitted.effects)[-1]
        values = effect.at_limit(values_of(effect.parameters, fitted.free[own]))
        free = np.concatenate([self.before.fitted.free, free_of(effect.parameters, values)])
        residual = self.comparison.residuals([hypothesis_of(fitted.effects, free)])[0]
        rigid = self.judge.judge(replace(fitted, free=free, residual=residual))
        lead = lead_of(judged, rigid, strikes=effect.has_stops)
        before, after, limit = (
            float(j.fitted_blocks.sum() + j.held_blocks.sum()) for j in (self.before, judged, rigid)
        )
        mostly = before - limit < (1 - _MOST) * (before - after)
        return self.believed(lead) or (mostly and min(lead.held, lead.fitted) >= self.settings.held)

    def needed_beside_stops(self, judged: Judged) -> bool:
        """Whether an effect beside a part with stops does more than lead that to another fit.

        Stops have many fits nearby, some a little better than others. What comes later starts from
        one of them and may end at another; then that one does as well without it.
        """
        if not strikes(self.before.fitted.effects) or self._new(judged) > 1:
            return True
        return self.believed(lead_of(judged, self._without(judged, judged.fitted.effects[-1])))

    def above_the_noise(self, judged: Judged) -> bool:
        """Whether what an added motion gains backwards is more than noise that it shuts out.

        The torque that a motion needs carries the noise of the measured acceleration. Behind a
        spring there is less of it, whether or not there is a spring in the machine: so most of the
        gain has to come from what exceeds the noise.
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
        return share_above_noise(before, after) > _MOST

    def accept(self, judged: Judged) -> tuple[Judged, list[Effect]]:
        """Fit on, and leave out what has become idle.

        Returns
        -------
        Judged
            With fresh sensitivities.
        list of Effect
            Earlier effects that are left out, one at most.
        """
        best = self.judge.judge(polished(self.comparison, judged.fitted))
        best = self._pruned(best, self._new(judged))
        for effect in best.fitted.effects[: len(self.before.fitted.effects)]:
            if effect.kind not in UNNAMED:
                without = self._without(best, effect)
                if not self.believed(lead_of(best, without)):
                    rather = self.rather(best, effect)
                    if rather is not None and rather.total < without.total:
                        return rather, []
                    return without, [effect]
        return best, []

    def rather(self, judged: Judged, effect: Effect) -> Judged | None:
        """What an idle effect was before, and without the one at its joint that made it idle.

        A fit of many at once may give one joint the wrong one of two: a servo that is soft, or a
        friction that holds it back as much. From there a step by step fit does not come back.
        """
        count, fitted = len(self.before.fitted.effects), judged.fitted
        joint = joint_of(effect)
        new = [
            (later, fitted.free[own])
            for later, own in zip(
                fitted.effects[count:], slices_of(fitted.effects)[count:], strict=True
            )
        ]
        kept = [(e, v) for e, v in new if joint is None or joint_of(e) != joint]
        if not kept or len(kept) == len(new):
            return None
        effects = (*fitted.effects[:count], *(e for e, _ in kept))
        start = np.concatenate([self.before.fitted.free, *(values for _, values in kept)])
        return self.judge.judge(fit(self.comparison, effects, start))

    def _pruned(self, judged: Judged, new: int) -> Judged:
        """Take out those of several new effects that are not believed by themselves."""
        while new > 1:
            without = [self._without(judged, effect) for effect in judged.fitted.effects[-new:]]
            leads = [lead_of(judged, each) for each in without]
            weakest = min(range(new), key=lambda k: leads[k].fitted + leads[k].held)
            if self.believed(leads[weakest]):
                break
            judged, new = without[weakest], new - 1
        return judged

    def _change(self, judged: Judged) -> float:
        """How far the new effects of a hypothesis are from nothing, in the parameters' scales."""
        effects, far = judged.fitted.effects, 0.0
        first = len(effects) - max(self._new(judged), 0)
        for effect, own in zip(effects[first:], slices_of(effects)[first:], strict=True):
            if effect.nothing is None:
                return np.inf
            nothing = free_of(effect.parameters, np.array(effect.nothing))
            far = max(far, float(np.max(np.abs(judged.fitted.free[own] - nothing))))
        return far

    def _new(self, judged: Judged) -> int:
        """How many effects a hypothesis adds."""
        return len(judged.fitted.effects) - len(self.before.fitted.effects)

    def _without(self, judged: Judged, effect: Effect) -> Judged:
        return self.judge.judge(fit_without(self.comparison, judged.fitted, effect))

    def believed(self, lead: Lead) -> bool:
        """Whether a lead is no chance: seen in both halves of the data, and surely in one."""
        one, other = lead.fitted, lead.held
        return min(one, other) >= self.settings.held and max(one, other) >= self.settings.sureness

    def _visible(self, judged: Judged) -> bool:
        """Whether it lowers the sum of squares by more than that scatters by chance.

        A sum of N squares of unit noise scatters by the root of 2 N. What gains less, however
        surely, is the last trace of an effect that is there already.
        """
        held = float(self.before.held_blocks.sum() - judged.held_blocks.sum())
        fitted = float(self.before.fitted_blocks.sum() - judged.fitted_blocks.sum())
        count, others = len(judged.held_residual), len(judged.fitted.residual)
        least = self.settings.visible
        alone = held > least * np.sqrt(2 * count)
        return bool(alone or held + fitted > least * np.sqrt(2 * (count + others)))

    def _material(self, judged: Judged, lead: Lead) -> bool:
        """Whether it explains enough: a law that is a little wrong leaves room for many effects."""
        settings, base = self.settings, self.base
        gained = self.before.structure - judged.structure
        if lead.share >= settings.share or gained >= settings.base_share * base.structure:
            return True
        if min(lead.held, lead.fitted) >= settings.everywhere:
            return True
        # A machine may lack something at every joint: what is little of all is much of a channel.
        gains = self.before.channel_structure[0] - judged.channel_structure[0]
        for there, share in (
            (base.channel_structure, settings.channel_share),
            (self.before.channel_structure, settings.channel_whole),
        ):
            whole, count = there
            sure = whole > settings.channel_sureness * np.sqrt(count)
            if np.any(sure & (gains >= share * whole)):
                return True
        return False
