"""Fits candidates: the most promising to windows of the data, the best of those to all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison
from loose_env.gap.families import families
from loose_env.gap.fit import Fit, cost_of, fit, parameters_of, refined
from loose_env.gap.judgement import Judge, Judged
from loose_env.gap.kinship import akin
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.parameter import free_of, values_of
from loose_env.gap.screening import Screened

__all__ = ["Trying"]

Array = NDArray[np.float64]

_WHOLE_FAMILIES = 2
"""Families that are fitted to all data."""
_SHIFTS = (-1.0, 1.0)
"""Samples by which a delay is moved to see whether that is better."""
_NEAR = 1.5
"""Sum of squares over that of a larger hypothesis from which on it is not tried on all data."""


class Trying:
    """Fits candidates on top of what is there.

    Parameters
    ----------
    comparison, short : Comparison
        The runs to fit to, and the windows of them that sort candidates.
    judge : Judge
        Judges what was fitted to all data.
    before : Judged
        What is there.
    settings : NamingSettings
        How many are fitted.
    """

    def __init__(
        self,
        comparison: Comparison,
        short: Comparison,
        judge: Judge,
        before: Judged,
        settings: NamingSettings,
    ) -> None:
        self.comparison, self.short, self.judge = comparison, short, judge
        self.before, self.settings = before.fitted, settings

    @cached_property
    def short_before(self) -> Fit:
        """What is there as it looks on the windows, with sensitivities of its own."""
        residual = self.short.residuals([self.before.hypothesis])[0]
        cost = cost_of(residual, self.before.free, parameters_of(self.before.effects))
        return refined(replace(self.before, residual=residual, cost=cost), self.short)

    def singles(self, screened: Sequence[Screened]) -> list[Judged]:
        """Fit single candidates, and those that the best one may be mistaken for."""
        if not screened:
            return []
        settings, fits = self.settings, []
        least = settings.promise * screened[0].promise
        for each in screened[: settings.candidates]:
            if each.promise < least:
                break
            fits.append(self._to_windows([each]))
        fits.sort(key=lambda f: f.cost)
        found = [self._to_all(each) for each in fits[: settings.finalists]]
        winner = min(found, key=lambda j: j.total).fitted.effects[-1]
        kin = [f for f in fits[settings.finalists :] if akin(winner, f.effects[-1])]
        return found + [self._to_all(each) for each in kin[: settings.kin]]

    def families(self, screened: Sequence[Screened]) -> list[Judged]:
        """Fit one kind of effect at several places at once."""
        fits = [self._to_windows(each) for each in families(screened, self.settings.families)]
        fits.sort(key=lambda f: f.cost)
        return [self._to_all(each) for each in fits[:_WHOLE_FAMILIES]]

    def alone(self, judged: Judged, base: Fit) -> Judged | None:
        """The new effects of a hypothesis without the earlier ones; None if they are needed.

        What is named first may only have stood in for what came later, and several springs that
        stand in for one delay are all missed if they are left out one by one.

        Parameters
        ----------
        judged : Judged
            The hypothesis.
        base : Fit
            The nominal model.
        """
        fitted, nominal = judged.fitted, len(base.free)
        effects = (*base.effects, *fitted.effects[len(self.before.effects) :])
        start = np.concatenate([base.free, fitted.free[len(self.before.free) :]])
        together = self.short.residuals([fitted.hypothesis])[0]
        quick = fit(self.short, effects, start)
        if quick.residual @ quick.residual > _NEAR * float(together @ together):
            return None
        start = np.concatenate([base.free, quick.free[nominal:]])
        return self.judge.judge(fit(self.comparison, effects, start, known=base.jacobian))

    def _to_windows(self, members: Sequence[Screened]) -> Fit:
        """Fit candidates together to the windows."""
        start = self.short_before.free
        for each in members:
            start = np.concatenate([start, free_of(each.effect.parameters, np.array(each.values))])
        effects = (*self.before.effects, *(each.effect for each in members))
        found = fit(self.short, effects, start, known=self.short_before.jacobian)
        if len(members) == 1 and members[0].effect.shifts:
            others = [self._shifted(found, start, share) for share in _SHIFTS]
            found = min((found, *others), key=lambda f: f.cost)
        return found

    def _shifted(self, fitted: Fit, start: Array, share: float) -> Fit:
        """Fit anew with the last effect, a delay, off by so many samples from where a fit ended.

        What held commands do to accelerations repeats itself from sample to sample, so that a fit
        ends a sample off as often as not.
        """
        (parameter,) = fitted.effects[-1].parameters
        value = values_of((parameter,), fitted.free[-1:])[0] + share / self.short.trials[0].rate
        moved = start.copy()
        moved[-1:] = free_of((parameter,), np.array([parameter.clipped(value)]))
        return fit(self.short, fitted.effects, moved, known=self.short_before.jacobian)

    def _to_all(self, each: Fit) -> Judged:
        """Fit to all data what was fitted to the windows."""
        start = np.concatenate([self.before.free, each.free[len(self.before.free) :]])
        known = self.before.jacobian
        return self.judge.judge(fit(self.comparison, each.effects, start, known=known))
