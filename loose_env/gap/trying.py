"""Fits candidates: the most promising to windows of the data, the best of those to all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from loose_env.gap.comparison import Comparison
from loose_env.gap.families import families
from loose_env.gap.fit import Fit, cost_of, fit, parameters_of, refined
from loose_env.gap.judgement import Judge, Judged
from loose_env.gap.kinship import akin
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.parameter import free_of
from loose_env.gap.screening import Screened

__all__ = ["Trying"]

_WHOLE_FAMILIES = 2
"""Families that are fitted to all data."""


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

    def _to_windows(self, members: Sequence[Screened]) -> Fit:
        """Fit candidates together to the windows."""
        start = self.short_before.free
        for each in members:
            start = np.concatenate([start, free_of(each.effect.parameters, np.array(each.values))])
        effects = (*self.before.effects, *(each.effect for each in members))
        return fit(self.short, effects, start, known=self.short_before.jacobian)

    def _to_all(self, each: Fit) -> Judged:
        """Fit to all data what was fitted to the windows."""
        start = np.concatenate([self.before.free, each.free[len(self.before.free) :]])
        known = self.before.jacobian
        return self.judge.judge(fit(self.comparison, each.effects, start, known=known))
