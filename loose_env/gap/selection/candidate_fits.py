"""Candidate fits: the most promising on windows of data, the best on all data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from loose_env.gap.fitting.gauss_newton import (
    BESIDE_STOPS,
    Fit,
    FitSettings,
    cost_of,
    fit,
)
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer, z_score
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.fitting.refit import refined
from loose_env.gap.model.effect import have_stops
from loose_env.gap.model.effects.mjcf.sensor_columns import of_place_or_speed
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.autocorrelation import Structure, largest
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.grouping import confusable
from loose_env.gap.selection.screening.screening import Screened
from loose_env.gap.settings import (
    ACCEPTED_Z,
    CONFUSABLE_FITS,
    FINAL_SETS,
    FINALISTS,
    FITTED_BY_Z,
    FITTED_CANDIDATES,
    FITTED_TWICE,
    HOPELESS_COST,
    LEAST_PREDICTED,
    SEARCH_Z,
    SINGLE_SHARE,
)
from loose_env.typing import Array

__all__ = ["CandidateFits"]


_SHIFTS = (
    *(-4.0, -3.0, -2.0, -1.0, -0.75, -0.5, -0.25, -0.1),
    *(0.1, 0.25, 0.5, 0.75, 1.0, 2.0, 3.0, 4.0),
)
"""Samples by which a delay is moved to see whether that is better."""
_NEARER = (1.0, 0.5, 0.25)
"""Shares of the way from nothing to where screening says that are tried as starts."""
_DEAF = 1e6
"""Factor on the noise of what shall not count."""
_RANKING = FitSettings(iterations=8, enough=0.01)
"""Settings of fits to the windows: they rank candidates, and give the better ones a start."""
_NEAR = 1.5
"""Sum of squares over that of a larger hypothesis from which on it is not tried on all data."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Slow:
    """Comparison in which only positions and speeds have weight."""

    comparison: ResidualModel
    """The same rows; the noise of all others is so large that they carry no weight."""
    weights: Array
    """Weight of each row under that noise (N,)."""

    @classmethod
    def of(cls, comparison: ResidualModel) -> Slow | None:
        """Remove the weight of accelerations and forces; None if all or none are such.

        None for runs that are compared by features, too: features belong to no single channel.
        """
        machine, channels = comparison.machine, comparison.channels
        kept = np.array([of_place_or_speed(machine, channel.column) for channel in channels])
        counted = kept[comparison.rows.channel]
        if comparison.chaotic or counted.all() or not counted.any():
            return None
        return cls(
            comparison=comparison.like(
                floors=np.where(kept, comparison.floors, comparison.floors * _DEAF)
            ),
            weights=np.where(counted, 1.0, 1.0 / _DEAF),
        )


class CandidateFits:
    """Fits candidate effects on top of the current model.

    Parameters
    ----------
    comparison, short : ResidualModel
        The training runs, and the windows of them that rank candidates.
    judge : Scorer
        Scores fits to all data.
    before : ScoredFit
        The current model.
    """

    def __init__(
        self, comparison: ResidualModel, short: ResidualModel, scorer: Scorer, before: ScoredFit
    ) -> None:
        self.comparison, self.short, self.scorer = comparison, short, scorer
        self.before = before.fitted
        self.beside_stops = have_stops(before.fitted.effects)
        """Whether a part with stops is there already, which makes everything take longer."""

    @cached_property
    def short_before(self) -> Fit:
        """The current model on the windows, with sensitivities of its own."""
        residual = self.short.residuals([self.before.hypothesis])[0]
        cost = cost_of(residual, self.before.free, self.before.structure.parameters)
        return refined(replace(self.before, residual=residual, cost=cost), self.short)

    @cached_property
    def slow(self) -> Slow | None:
        """The windows without accelerations; None where there are only such, or none."""
        return Slow.of(self.short)

    def fit_candidates(
        self,
        screened: Sequence[Screened],
        sets: Callable[[], Sequence[Sequence[Screened]]] = tuple,
        say: Callable[[str], None] = lambda _: None,
    ) -> list[ScoredFit]:
        """Fit single candidates, and sets of them where the best one leaves much unexplained.

        Those confusable with the best single one are fitted, too.

        Parameters
        ----------
        screened : sequence of Screened
            Candidates, the most promising first.
        sets : callable
            Proposes sets that explain together.
        say : callable
            Receives progress messages.
        """
        least = LEAST_PREDICTED * screened[0].predicted if screened else 0.0
        taken = [each for each in screened[:FITTED_CANDIDATES] if each.predicted >= least]
        # a small effect at every joint has a low predicted explained variance beside a slightly
        # wrong law
        most = max((each.z for each in taken), default=0.0)
        by_z = [each for each in screened[len(taken) :] if each.z > most]
        taken += sorted(by_z, key=lambda each: -each.z)[:FITTED_BY_Z]
        twice = 0 if self.beside_stops else FITTED_TWICE
        fits, best = self._with_hope(
            [self._to_windows([each], both=k < twice) for k, each in enumerate(taken)], None
        )
        together: list[Fit] = []
        if best is None or self._left(best) > SINGLE_SHARE:
            proposed = sets()
            say(f"  joint fits: {len(proposed)} sets of effects")
            together = [self._to_windows(each) for each in proposed]
            together, best = self._with_hope(together, best)
            fits, best = self._with_hope(fits, best)
        highest_z = max(fits[FINALISTS:], key=self._z, default=None)
        finalists = fits[:FINALISTS]
        # a few blocks with a large unexplained residual may hide a small effect at every joint
        if highest_z is not None and self._z(highest_z) > max(map(self._z, finalists)):
            finalists.append(highest_z)
        found = [self._to_all(each) for each in (*finalists, *together[:FINAL_SETS])]
        if not finalists:
            return found
        winner = min(found[: len(finalists)], key=lambda j: j.total).fitted.effects[-1]
        others = [f for f in fits if not any(f is g for g in finalists)]
        confusables = [f for f in others if confusable(winner, f.effects[-1])][:CONFUSABLE_FITS]
        # a candidate screened out for a poor start may still be the true one
        relatives = [
            each
            for each in screened
            if not any(each is tried for tried in taken) and confusable(winner, each.effect)
        ][: CONFUSABLE_FITS - len(confusables)]
        more, best = self._with_hope([self._to_windows([each]) for each in relatives], best)
        return found + [self._to_all(each) for each in (*confusables, *more)]

    def _left(self, each: Fit) -> float:
        """Share of the autocorrelated residual on the windows that a fit leaves."""
        before, after = (
            float(largest(self._products.products(fitted.residual).sum(axis=1)))
            for fitted in (self.short_before, each)
        )
        white = SEARCH_Z * np.sqrt(len(each.residual)) * float(np.mean(each.residual**2))
        return 0.0 if after <= white or before <= 0 else after / before

    @cached_property
    def _products(self) -> Structure:
        return Structure(self.short.rows)

    def _with_hope(self, fits: Sequence[Fit], best: Fit | None) -> tuple[list[Fit], Fit | None]:
        """Select fits to the windows that may be the best on all data, best first.

        They are compared with the best one so far, which is returned, too.
        """
        found = sorted(fits, key=lambda f: f.cost)
        if not found:
            return [], best
        if best is None or found[0].cost <= best.cost:
            best = found[0]
        blocks = self.short.by_block(best.residual**2)
        kept = [
            each
            for each in found
            if each.cost < HOPELESS_COST * best.cost
            or z_score(self.short.by_block(each.residual**2), blocks) < ACCEPTED_Z
        ]
        return kept, best

    def _z(self, each: Fit) -> float:
        """Return the improvement (z) of a fit to the windows over the current model."""
        before, after = (
            self.short.by_block(fitted.residual**2) for fitted in (self.short_before, each)
        )
        return z_score(before, after)

    def without_earlier(self, scored: ScoredFit, base: Fit) -> ScoredFit | None:
        """Return a hypothesis without its earlier effects; None if they are needed.

        The effect identified first may only have been a proxy for a later one, and several springs
        that are proxies for one delay are not removed by dropping them one at a time.

        Parameters
        ----------
        judged : ScoredFit
            The hypothesis.
        base : Fit
            The nominal model.
        """
        fitted, nominal = scored.fitted, len(base.free)
        structure = base.structure.with_effects(
            (*base.effects, *fitted.effects[len(self.before.effects) :])
        )
        start = np.concatenate([base.free, fitted.free[len(self.before.free) :]])
        together = self.short.residuals([fitted.hypothesis])[0]
        quick = fit(self.short, structure, start)
        if quick.residual @ quick.residual > _NEAR * float(together @ together):
            return None
        start = np.concatenate([base.free, quick.free[nominal:]])
        return self.scorer.score(fit(self.comparison, structure, start, known=base.jacobian))

    def replacements(self, screened: Sequence[Screened], rival: Fit) -> list[ScoredFit]:
        """Fit candidates that may replace an effect of the model equally well, best first.

        Parameters
        ----------
        screened : sequence of Screened
            Candidates.
        rival : Fit
            The current model, with the effect that they would replace.
        """
        together = self.short.residuals([rival.hypothesis])[0]
        fits = [self._to_windows([each], both=True) for each in screened]
        fits.sort(key=lambda f: f.cost)
        near = [f for f in fits if f.residual @ f.residual < _NEAR * float(together @ together)]
        found = [self._to_all(each) for each in near[:CONFUSABLE_FITS]]
        return sorted(found, key=lambda scored: scored.total)

    def _to_windows(self, members: Sequence[Screened], *, both: bool = False) -> Fit:
        """Fit candidates jointly to the windows; a single candidate from both its starts."""
        structure = self.before.structure.plus(*(each.effect for each in members))
        start, residual = self._start(structure, members)
        known = self.short_before.jacobian
        found = _ranked(self.short, structure, start, known=known, residual=residual)
        if both and members[0].second is not None:
            other = free_of(members[0].effect.parameters, np.array(members[0].second))
            other = np.concatenate([self.short_before.free, other])
            again = _ranked(self.short, structure, other, known=self.short_before.jacobian)
            found = min((found, again), key=lambda f: f.cost)
        if len(members) == 1 and members[0].effect.shifts and self.slow is not None:
            # zero-order-hold commands make the accelerations' cost periodic in the delay, with one
            # local optimum per sample; positions and speeds have a single optimum
            known = self.short_before.jacobian * self.slow.weights[:, None]
            first = _ranked(self.slow.comparison, structure, start, known=known)
            again = _ranked(self.short, structure, first.free, known=self.short_before.jacobian)
            found = self._shifted(min((found, again), key=lambda f: f.cost))
        return found

    def _start(self, structure: ModelStructure, members: Sequence[Screened]) -> tuple[Array, Array]:
        """Start from the screened values, or smaller ones if better: these are linearised."""
        at = [free_of(each.effect.parameters, np.array(each.values)) for each in members]
        none = [
            values if each.effect.nothing is None
            else free_of(each.effect.parameters, np.array(each.effect.nothing))
            for each, values in zip(members, at, strict=True)
        ]  # fmt: skip
        tried = [
            np.concatenate(
                [
                    self.short_before.free,
                    *(a + share * (b - a) for a, b in zip(none, at, strict=True)),
                ]
            )
            for share in _NEARER
        ]
        residuals = self.short.residuals([structure.hypothesis(free) for free in tried])
        costs = [cost_of(r, f, structure.parameters) for r, f in zip(residuals, tried, strict=True)]
        best = int(np.nanargmin(np.nan_to_num(costs, nan=np.inf)))
        return tried[best], residuals[best]

    def _shifted(self, fitted: Fit) -> Fit:
        """Shift the last effect, a delay, by samples and fractions; refit where better.

        A delay of whole samples is a kink in the sum of squares at which a fit stalls, and for
        accelerations under zero-order-hold commands every sample is a local minimum.
        """
        (parameter,) = fitted.effects[-1].parameters
        value, tried = values_of((parameter,), fitted.free[-1:])[0], []
        for shift in _SHIFTS:
            moved = parameter.clipped(value + shift / self.short.trials[0].rate)
            tried.append(np.append(fitted.free[:-1], free_of((parameter,), np.array([moved]))))
        residuals = self.short.residuals([fitted.structure.hypothesis(free) for free in tried])
        best = int(np.argmin(np.sum(residuals**2, axis=1)))
        if np.sum(residuals[best] ** 2) >= fitted.residual @ fitted.residual:
            return fitted
        again = fit(self.short, fitted.structure, tried[best], known=fitted.jacobian)
        return min((fitted, again), key=lambda f: f.cost)

    def _to_all(self, each: Fit) -> ScoredFit:
        """Fit the hypotheses that were fitted to the windows to all data."""
        start = np.concatenate([self.before.free, each.free[len(self.before.free) :]])
        known = self.before.jacobian
        return self.scorer.score(fit(self.comparison, each.structure, start, known=known))


def _ranked(
    comparison: ResidualModel, structure: ModelStructure, start: Array, **known: Array | None
) -> Fit:
    """Fit as far as a rank among candidates needs."""
    settings = BESIDE_STOPS if have_stops(structure.effects) else _RANKING
    return fit(comparison, structure, start, settings=settings, **known)
