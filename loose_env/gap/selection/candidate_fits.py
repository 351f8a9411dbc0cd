"""Fits of screened candidates, sets and replacements: many on windows, the best on all data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import (
    Fit,
    cost_of,
    fit,
)
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer
from loose_env.gap.model.effect import have_stops
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.confusable_effects import confusable
from loose_env.gap.selection.screening.screening import ScreenedCandidate
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.gap.settings import (
    FITTED_CANDIDATES,
    FURTHER,
    LEADING,
    LEAST_PREDICTED,
    NEAR_COST,
    NOISE_RMS,
    SINGLE_SHARE,
)

_MAX_COST_RATIO = 1.5
"""Sum of squares over that of a larger hypothesis from which on it is not tried on all data."""


class CandidateFits:
    """Fits candidate effects on top of the current model."""

    def __init__(
        self, comparison: ResidualModel, short: ResidualModel, scorer: Scorer, before: ScoredFit
    ) -> None:
        self.comparison, self.scorer = comparison, scorer
        self.before, self.windows = before.fitted, WindowFits(short, before.fitted)
        self.beside_stops = have_stops(before.fitted.effects)
        """Whether a part with stops is there already, which makes everything take longer."""

    def fit_candidates(
        self,
        screened: Sequence[ScreenedCandidate],
        sets: Callable[[], Sequence[Sequence[ScreenedCandidate]]] = tuple,
        say: Callable[[str], None] = lambda _: None,
        *,
        share: float = 1.0,
    ) -> list[ScoredFit]:
        """Fit single candidates, and sets of them where the best one leaves much unexplained.

        Those confusable with the best single one are fitted, too.
        """
        least = LEAST_PREDICTED * screened[0].predicted if screened else 0.0
        taken = [each for each in screened[:FITTED_CANDIDATES] if each.predicted >= least]
        # a small effect at every joint has a low predicted explained variance beside a slightly
        # wrong law
        most = max((each.z for each in taken), default=0.0)
        by_z = [each for each in screened[len(taken) :] if each.z > most]
        taken += sorted(by_z, key=lambda each: -each.z)[:FURTHER]
        twice = 0 if self.beside_stops else LEADING
        windows = self.windows
        fits, best = windows.staged_fits([[each] for each in taken], twice=twice)
        together: list[Fit] = []
        left = 1.0 if best is None else windows.residual_share(best)
        loud = best is None or best.rms > NOISE_RMS
        if screened and left > SINGLE_SHARE and (loud or share * left > SINGLE_SHARE):
            proposed = sets()
            say(f"  joint fits: {len(proposed)} sets of effects")
            together, best = windows.staged_fits(proposed, best=best)
            fits, best = windows.within_cost_ratio(fits, best)
        highest_z = max(fits[LEADING:], key=windows.z_of, default=None)
        near, near_together = (
            windows.within_cost_ratio(f, best, NEAR_COST)[0] for f in (fits, together)
        )
        finalists = near[:LEADING]
        # a few blocks with a large unexplained residual may hide a small effect at every joint
        most = max(map(windows.z_of, fits[:LEADING]), default=0.0)
        if highest_z is not None and windows.z_of(highest_z) > most:
            finalists.append(highest_z)
        leading = [*finalists, *near_together[:FURTHER]]
        found = self._to_all(leading)
        if not finalists:
            return found
        winner = min(found[: len(finalists)], key=lambda j: j.total).fitted.effects[-1]
        others = [f for f in fits if not any(f is g for g in finalists)]
        confusables = [f for f in others if confusable(winner, f.effects[-1])][:FURTHER]
        # a candidate screened out for a poor start may still be the true one
        relatives = [
            each
            for each in screened
            if not any(each is tried for tried in taken) and confusable(winner, each.effect)
        ][: FURTHER - len(confusables)]
        more, _ = windows.staged_fits([[each] for each in relatives], best=best)
        return found + self._to_all([*confusables, *more], best=min(j.fitted.cost for j in found))

    def without_earlier(self, scored: ScoredFit, base: Fit) -> ScoredFit | None:
        """Return a hypothesis without its earlier effects; None if they are needed.

        The effect identified first may only have been a proxy for a later one, and several springs
        that are proxies for one delay are not removed by dropping them one at a time.
        """
        fitted, nominal = scored.fitted, len(base.free)
        structure = base.structure.with_effects(
            (*base.effects, *fitted.effects[len(self.before.effects) :])
        )
        start = np.concatenate([base.free, fitted.free[len(self.before.free) :]])
        together = self.windows.short.residuals([fitted.hypothesis])[0]
        quick = fit(self.windows.short, structure, start)
        if quick.residual @ quick.residual > _MAX_COST_RATIO * float(together @ together):
            return None
        start = np.concatenate([base.free, quick.free[nominal:]])
        return self.scorer.score(fit(self.comparison, structure, start, known=base.jacobian))

    def replacements(self, screened: Sequence[ScreenedCandidate], rival: Fit) -> list[ScoredFit]:
        """Fit candidates that may replace an effect of the model equally well, best first."""
        windows = self.windows
        together = windows.short.residuals([rival.hypothesis])[0]
        cost = cost_of(together, rival.free, rival.structure.parameters)
        incumbent = replace(rival, residual=together, cost=cost)
        sets = [[each] for each in screened]
        fits, _ = windows.staged_fits(sets, twice=len(screened), best=incumbent)
        most = _MAX_COST_RATIO * float(together @ together)
        near = [each for each in fits if each.residual @ each.residual < most]
        found = self._to_all(near[:FURTHER], best=rival.cost)
        return sorted(found, key=lambda scored: scored.total)

    def _to_all(self, fits: Sequence[Fit], *, best: float = np.inf) -> list[ScoredFit]:
        """Fit hypotheses that were fitted to the windows to all data.

        One that stays far behind the best cost so far is only compared with it: what would not
        bring it near is not simulated.
        """
        found = []
        for each in counted("fits to all runs", fits):
            start = np.concatenate([self.before.free, each.free[len(self.before.free) :]])
            fitted = fit(
                self.comparison,
                each.structure,
                start,
                known=self.before.jacobian,
                reference=best,
            )
            best = min(best, fitted.cost)
            found.append(self.scorer.score(fitted))
        return found
