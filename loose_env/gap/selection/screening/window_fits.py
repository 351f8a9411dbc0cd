"""Fits of candidates to windows of the runs, in stages that drop those far behind.

Such a fit ranks a candidate among others and gives the fit to all data a start; it need not
converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from loose_env.gap.fitting.gauss_newton import STOP_FIT_SETTINGS, Fit, FitSettings, cost_of, fit
from loose_env.gap.fitting.holdout_score import residual_z
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import have_stops
from loose_env.gap.model.effects.mjcf.sensor_columns import is_position_or_speed
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.autocorrelation import LaggedProducts, largest
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.screening import ScreenedCandidate
from loose_env.gap.settings import ACCEPTED_Z, HOPELESS_COST, SEARCH_Z
from loose_env.typing import Array

_ENOUGH = 0.01
"""Share of the cost below which a further step is not worth its simulations."""
_ROUNDS = ((2, HOPELESS_COST**2), (8, HOPELESS_COST))
"""Most steps of each round, and cost over that of the best from which on one is left out."""
_DELAY_STEPS = (
    *(-4.0, -3.0, -2.0, -1.0, -0.75, -0.5, -0.25, -0.1),
    *(0.1, 0.25, 0.5, 0.75, 1.0, 2.0, 3.0, 4.0),
)
"""Samples by which a delay is moved to see whether that is better."""
_START_SHARES = (1.0, 0.5, 0.25)
"""Shares of the way from nothing to where screening says that are tried as starts."""
_IGNORED_CHANNEL_NOISE = 1e6
"""Factor on the noise of what shall not count."""


class WindowFits:
    """Fits candidates on top of the current model, to windows."""

    def __init__(self, short: ResidualModel, before: Fit) -> None:
        self.short, self._all = short, before

    @cached_property
    def before(self) -> Fit:
        """The current model on the windows, with sensitivities of its own."""
        residual = self.short.residuals([self._all.hypothesis])[0]
        cost = cost_of(residual, self._all.free, self._all.structure.parameters)
        return with_new_jacobian(replace(self._all, residual=residual, cost=cost), self.short)

    def staged_fits(
        self,
        sets: Sequence[Sequence[ScreenedCandidate]],
        *,
        twice: int = 0,
        best: Fit | None = None,
    ) -> tuple[list[Fit], Fit | None]:
        """Fit sets of candidates; return those that may be the best on all data, best first."""
        running = [
            fitted
            for k, members in enumerate(sets)
            for fitted in self._starts(members, both=k < twice)
        ]
        for iterations, ratio in _ROUNDS:
            running = [
                self._continued(fitted, iterations) for fitted in counted("quick fits", running)
            ]
            running, best = self.within_cost_ratio(running, best, ratio)
        found: dict[frozenset[tuple[str, str, str]], Fit] = {}
        for fitted in running:  # the best one first
            found.setdefault(frozenset(effect.key for effect in fitted.effects), fitted)
        running, best = self.within_cost_ratio(
            [self._shifted(each) for each in found.values()], best
        )
        return [fitted.bare for fitted in running], best and best.bare

    def within_cost_ratio(
        self, fits: Sequence[Fit], best: Fit | None, ratio: float = HOPELESS_COST
    ) -> tuple[list[Fit], Fit | None]:
        """Select fits that may be the best on all data, best first; and the best one so far."""
        found = sorted(fits, key=lambda f: f.cost)
        if not found:
            return [], best
        if best is None or found[0].cost <= best.cost:
            best = found[0]
        kept = [
            each
            for each in found
            if each.cost < ratio * best.cost
            or residual_z(self.short, each.residual, best.residual) < ACCEPTED_Z
        ]
        return kept, best

    def z_of(self, each: Fit) -> float:
        """Return the improvement (z) of a fit over the current model."""
        return residual_z(self.short, self.before.residual, each.residual)

    def residual_share(self, each: Fit) -> float:
        """Share of the autocorrelated residual that a fit leaves; 0 where it is white."""
        before, after = (
            float(largest(self._products.products(fitted.residual).sum(axis=1)))
            for fitted in (self.before, each)
        )
        white = SEARCH_Z * np.sqrt(len(each.residual)) * float(np.mean(each.residual**2))
        return 0.0 if after <= white or before <= 0 else after / before

    @cached_property
    def _products(self) -> LaggedProducts:
        return LaggedProducts(self.short.rows)

    def _continued(self, fitted: Fit, iterations: int) -> Fit:
        """Continue a fit by some steps."""
        settings = FitSettings(iterations=iterations, cost_tolerance=_ENOUGH)
        if have_stops(fitted.effects):
            settings = replace(STOP_FIT_SETTINGS, iterations=iterations)
        found = fit(
            self.short,
            fitted.structure,
            fitted.free,
            settings=settings,
            known=fitted.jacobian,
            residual=fitted.residual,
        )
        return replace(found, jacobian=found.jacobian.astype(np.float32))

    def _starts(self, members: Sequence[ScreenedCandidate], *, both: bool) -> list[Fit]:
        """Hypotheses with candidates at the values of screening, and at other starts."""
        structure = self.before.structure.plus(*(each.effect for each in members))
        found = [self._nearest(structure, members)]
        (first, *others) = members
        if both and first.second is not None:
            second = free_of(first.effect.parameters, np.array(first.second))
            found.append(self._at(structure, np.append(self.before.free, second)))
        if not others and first.effect.is_time_shift and self._slow is not None:
            # zero-order-hold commands make the accelerations' cost periodic in the delay, with one
            # local optimum per sample; positions and speeds have a single optimum
            slow, weights = self._slow
            known = self.before.jacobian * weights[:, None]
            settled = fit(slow, structure, found[0].free, known=known)
            found.append(self._at(structure, settled.free))
        return found

    def _nearest(self, structure: ModelStructure, members: Sequence[ScreenedCandidate]) -> Fit:
        """Start from the screened values, or smaller ones if better: these are linearised."""
        at = [free_of(each.effect.parameters, np.array(each.values)) for each in members]
        none = [
            values if each.effect.null_values is None
            else free_of(each.effect.parameters, np.array(each.effect.null_values))
            for each, values in zip(members, at, strict=True)
        ]  # fmt: skip
        tried = [
            np.concatenate(
                [self.before.free, *(a + share * (b - a) for a, b in zip(none, at, strict=True))]
            )
            for share in _START_SHARES
        ]
        residuals = self.short.residuals([structure.hypothesis(free) for free in tried])
        fits = [self._at(structure, *each) for each in zip(tried, residuals, strict=True)]
        return min(fits, key=lambda f: f.cost)

    def _at(self, structure: ModelStructure, free: Array, residual: Array | None = None) -> Fit:
        """A hypothesis at some free numbers, with the sensitivities of the current model."""
        if residual is None:
            residual = self.short.residuals([structure.hypothesis(free)])[0]
        return Fit(
            structure=structure,
            free=free,
            residual=residual,
            jacobian=self.before.jacobian,
            cost=cost_of(residual, free, structure.parameters),
        )

    @cached_property
    def _slow(self) -> tuple[ResidualModel, Array] | None:
        """Windows in which positions and speeds alone have weight, and the weight of each row (N,).

        None where there are only such, or none; and for runs that are compared by features, which
        belong to no single channel.
        """
        short = self.short
        kept = np.array([is_position_or_speed(short.machine, c.column) for c in short.channels])
        counted = kept[short.rows.channel]
        if short.chaotic or counted.all() or not counted.any():
            return None
        floors = np.where(kept, short.floors, short.floors * _IGNORED_CHANNEL_NOISE)
        return short.like(floors=floors), np.where(counted, 1.0, 1.0 / _IGNORED_CHANNEL_NOISE)

    def _shifted(self, fitted: Fit) -> Fit:
        """Shift the last effect, if a delay, by samples and fractions; refit where better.

        A delay of whole samples is a kink in the sum of squares at which a fit stalls, and for
        accelerations under zero-order-hold commands every sample is a local minimum.
        """
        one_more = len(fitted.effects) == len(self.before.effects) + 1
        if not one_more or not fitted.effects[-1].is_time_shift or self._slow is None:
            return fitted
        (parameter,) = fitted.effects[-1].parameters
        value, tried = values_of((parameter,), fitted.free[-1:])[0], []
        for shift in _DELAY_STEPS:
            moved = parameter.clipped(value + shift / self.short.trials[0].rate)
            tried.append(np.append(fitted.free[:-1], free_of((parameter,), np.array([moved]))))
        residuals = self.short.residuals([fitted.structure.hypothesis(free) for free in tried])
        best = int(np.argmin(np.sum(residuals**2, axis=1)))
        if np.sum(residuals[best] ** 2) >= fitted.residual @ fitted.residual:
            return fitted
        again = fit(self.short, fitted.structure, tried[best], known=fitted.jacobian)
        return min((fitted, again), key=lambda f: f.cost)
