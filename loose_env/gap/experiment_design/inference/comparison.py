"""Posterior over sets of effects: all screened by signatures, the leading ones fitted exactly.

The bank's signatures alone screen all sets. Those that lead are then fitted exactly, a pair after
its members alone, and beside an exact fit of a single effect every second one is screened again,
now with the small error that its residual leaves. Within the sets compared so, the exact evidence
decides; their probability together is that of the screening.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from loose_env.gap.experiment_design.inference.exact_fit import ExactFit
from loose_env.gap.experiment_design.inference.expansion import (
    Data,
    Solution,
    equations,
    linear_fit,
    nominal,
)
from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.gap.experiment_design.inference.posterior import (
    BeliefSettings,
    EffectEstimate,
    HypothesisSet,
    Posterior,
)
from loose_env.gap.experiment_design.inference.screening import (
    Beside,
    ScreenedSets,
    linear_estimates,
    log_prior,
    screened,
)
from loose_env.gap.experiment_design.inference.simulations import Simulations

_OPEN = 0.02
"""Probability from which a set is fitted exactly."""
_CARRIED, _BEHIND = 4, 20.0
"""Exact fits that are brought up to date with every motion, and log evidence behind the best within
which they are [nats]."""
_SINGLES = 4
"""Single effects that are fitted where the best fit leaves more than the noise."""
_SIGNIFICANT = 4.0
"""Standard deviations of χ² above which it leaves more than the noise."""
_WITHIN, _BEST_WITHIN = 5.0, 2.5
"""Change of the readings from where they were simulated within which a fit is settled, any and the
best one [noise standard deviations]."""
_SLOPES = 0.3
"""Relative error of the derivatives: by it times that change, a fit may turn out better."""
_LOST = 40.0
"""That change after a new motion from which a set is fitted anew, from its best local models."""
_STEPS = 6
"""Steps of a fit after one motion."""
_POLISHED = 2
"""Steps of the best fit after its derivatives were sharpened."""
_KEPT, _ESTIMATED = 40, 8
"""Sets of a posterior, and those with estimates."""

Members = tuple[int, ...]
"""Indices of candidates, increasing."""


@dataclass(eq=False)
class Comparison:
    """Exact fits of one machine, kept from motion to motion."""

    models: LocalModels
    settings: BeliefSettings
    fits: dict[tuple[int, ...], ExactFit] = field(default_factory=dict)
    """Rays -> fit."""
    carried: tuple[tuple[int, ...], ...] = ()
    """Local models of the sets whose fits are brought up to date first."""
    behind: set[tuple[int, ...]] = field(default_factory=set)
    """Rays of single effects whose fits fell behind one that leaves the noise alone."""

    def posterior(self, data: Data) -> Posterior:
        """Posterior over sets of effects."""
        round_ = self._round(data, self.settings.simulations)
        if self.settings.simulations and data:
            round_.run()
        return round_.posterior()

    def log_evidence(self, data: Data, candidate: int) -> float:
        """Log evidence of one effect alone, by its exact fit [nats]; -inf where that diverges."""
        return self._round(data, _STEPS * len(data)).log_evidence(candidate)

    def _round(self, data: Data, simulations: int) -> _Round:
        eta, count = self.settings.linearisation, self.models.bank.nuisances
        about = equations(self.models, data, nominal(self.models, data), eta, count)
        first = screened(self.models, about, self.settings)
        return _Round(self, data, first, Simulations(self.models, simulations))

    def begun(self, data: Data, own: tuple[int, ...]) -> ExactFit:
        """Exact fit of local models, begun at their fit by the bank's signatures.

        A pair begins at the exact fit of its first member, where there is one, and the local model
        of the second one beside it.
        """
        models, eta = self.models, self.settings.linearisation
        alone = self.fits.get((int(models.ray[own[0]]),)) if len(own) == 2 else None
        if alone is None or alone.diverged or set(alone.about) != set(data):
            fit = ExactFit(models, (), self.settings, np.zeros(models.bank.nuisances))
            fit.about = nominal(models, data)
            return fit.with_models(own, linear_fit(models, data, own, fit.about, eta).parameters)
        rest = own[1:]
        return alone.with_models(rest, linear_fit(models, data, rest, alone.about, eta).parameters)


@dataclass(frozen=True, eq=False)
class _Compared:
    """A set compared exactly: by a fit of its own, or beside that of one of its members."""

    score: float
    """Log posterior up to a constant."""
    own: tuple[int, ...]
    """Its best local models."""
    fit: tuple[ExactFit, Solution] | None = None


@dataclass(frozen=True, eq=False)
class _Family:
    """Pairs beside the exact fit of one of their members."""

    pairs: dict[Members, tuple[float, tuple[int, ...]]]
    """Candidates -> log posterior up to a constant, and best local models."""
    grown: float
    """Log evidence that all of them lose by the error of the expansion about that fit."""


class _Round:
    """Comparison after one motion."""

    def __init__(
        self, state: Comparison, data: Data, first: ScreenedSets, simulations: Simulations
    ) -> None:
        self.state, self.data, self.first, self.simulations = state, data, first, simulations
        self.models, self.settings = state.models, state.settings
        self.fitted: dict[Members, _Compared] = {}
        self.families: dict[int, _Family] = {}
        self.misfit, self.excess = first.misfit, 0.0
        self._steps: Counter[tuple[int, ...]] = Counter()
        self._anew: set[Members] = set()
        self._begun: dict[tuple[int, ...], ExactFit] = {}
        candidate = self.models.candidate  # the last one written is the best local model of each
        self._single = {(int(candidate[h]),): (int(h),) for h in np.argsort(first.evidence)}

    def run(self) -> None:
        """Fit sets exactly until the leading ones are, or the simulations are spent."""
        self._simulate_ahead([self.state.fits.get(self._key(own)) for own in self.state.carried])
        for own in self.state.carried:
            self._fit(own, _WITHIN)
        while self.simulations.left > 0:
            following = self._next()
            if following is None:
                break
            self._fit(*following)
        self._sharpen()
        found = sorted(self.fitted.values(), key=lambda c: -c.score)
        near = [c for c in found if (found[0].score - c.score) / self.misfit < _BEHIND]
        self.state.carried = tuple(c.own for c in near[:_CARRIED])
        if self.misfit == 1.0:
            far = [c.own for c in found if c not in near and len(c.own) == 1]
            self.state.behind |= {self._key(own) for own in far}

    def log_evidence(self, candidate: int) -> float:
        """Log evidence of one effect alone, by its exact fit."""
        own, members = self._single[(candidate,)], (candidate,)
        while self._steps[self._key(own)] <= _STEPS:
            self._fit(own, _BEST_WITHIN)
            found = self.fitted.get(members)
            if found is None or found.fit is None:
                return -np.inf
            if found.fit[0].unsettled(self.data) <= _BEST_WITHIN:
                break
        return self.fitted[members].score - log_prior(1, len(self.models.names), self.settings)

    def _key(self, own: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(int(self.models.ray[h]) for h in own)

    def _sharpen(self) -> None:
        """Derivatives of the best fit, which its evidence and its intervals rest on."""
        best = max(self.fitted.values(), key=lambda c: c.score)
        assert best.fit is not None
        if self.misfit > 1 or not best.own or not (blunt := best.fit[0].blunt(self.data)):
            return
        best.fit[0].sharpen(blunt, self.simulations)
        self._score(best.own, best.fit[0])
        for _ in range(_POLISHED):
            if best.fit[0].unsettled(self.data) > _BEST_WITHIN:
                self._fit(best.own, _BEST_WITHIN)

    def _members(self, own: tuple[int, ...]) -> Members:
        return tuple(sorted(int(self.models.candidate[h]) for h in own))

    def _next(self) -> tuple[tuple[int, ...], float] | None:
        """Local models of the set to fit next and how closely; None where all that lead are."""
        best = max((c.score for c in self.fitted.values()), default=0.0)
        for each in sorted(self.fitted.values(), key=lambda c: -c.score):
            assert each.fit is not None
            off = each.fit[0].unsettled(self.data)
            better = each.score + 0.5 * (_SLOPES * off) ** 2 / self.misfit
            within = _BEST_WITHIN if each.score == best else _WITHIN
            near = better > best + self.misfit * np.log(_OPEN)
            members = self._members(each.own)
            if near and off > _LOST and members in self.first.best and members not in self._anew:
                self._anew.add(members)
                own = self.first.best[members]
                self.state.fits.pop(self._key(own), None)
                return own, within
            if near and off > within and self._steps[self._key(each.own)] < _STEPS:
                return each.own, within
        shares, compared = self._shares(self.misfit), self._compared()
        leading = [m for m in sorted(shares, key=lambda m: -shares[m]) if shares[m] >= _OPEN]
        wanted: list[tuple[int, ...]] = []
        for members in leading:
            wanted += self._alone(members)
            if members not in self.fitted:
                known = members in compared
                wanted.append(compared[members].own if known else self.first.best[members])
        if self.misfit > 1:
            evidence = self.first.evidence
            alone = sorted(self._single.values(), key=lambda own: -evidence[own[0]])
            wanted += alone[:_SINGLES]
        wanted = [own for own in dict.fromkeys(wanted) if not self._steps[self._key(own)]]
        if not wanted:
            return None
        self._begin(wanted)
        return wanted[0], _WITHIN

    def _begin(self, wanted: Sequence[tuple[int, ...]]) -> None:
        """Begin the fits of single effects that are wanted, and simulate them together."""
        keys = {self._key(own): own for own in wanted if len(own) == 1}
        for key in keys.keys() - self.state.fits.keys() - self._begun.keys():
            self._begun[key] = self.state.begun(self.data, keys[key])
        if self._key(wanted[0]) in self._begun:
            self._simulate_ahead([self._begun[key] for key in keys if key in self._begun])

    def _simulate_ahead(self, fits: Sequence[ExactFit | None]) -> None:
        """Simulate the motions that some fits lack, together."""
        lacking: dict[tuple[int, ...], list[ExactFit]] = {}
        for fit in fits:
            if fit is not None and not fit.diverged and (new := fit.lacks(self.data)):
                lacking.setdefault(tuple(new), []).append(fit)
        for motions, own in lacking.items():
            self.simulations.ahead(motions, [fit.hypothesis(fit.parameters) for fit in own])

    def _alone(self, members: Members) -> list[tuple[int, ...]]:
        """Members of a pair alone, the better one first, but those that fell behind."""
        if len(members) < 2:
            return []
        alone = [self._single[(m,)] for m in members]
        alone = [own for own in alone if self._key(own) not in self.state.behind]
        return sorted(alone, key=lambda own: -self.first.evidence[own[0]])

    def _fit(self, own: tuple[int, ...], within: float) -> None:
        state, key = self.state, self._key(own)
        fit = state.fits.get(key) or self._begun.pop(key, None) or state.begun(self.data, own)
        state.fits[key] = fit
        self._steps[key] += 1
        if not fit.diverged:
            fit.step(self.data, self.simulations, within)
        if fit.diverged:
            return
        self._score(own, fit)
        if len(own) == 1:
            self._screen_beside(fit, own[0])

    def _score(self, own: tuple[int, ...], fit: ExactFit) -> None:
        found, models = fit.solution(self.data), self.models
        members = self._members(own)
        score = log_prior(len(own), len(models.names), self.settings) - found.chi2 / 2
        score -= found.occam + found.grown
        score += sum(self._ray_prior(h) for h in own)
        before = self.fitted.get(members)
        same = before is not None and before.fit is not None and before.fit[0] is fit
        if before is None or same or before.score < score:
            self.fitted[members] = _Compared(score, own, (fit, found))
        self._update_misfit()

    def _ray_prior(self, h: int) -> float:
        """Log probability of a local model's ray given its candidate."""
        own = self.models.candidate == self.models.candidate[h]
        return -float(np.log(len(np.unique(self.models.ray[own]))))

    def _screen_beside(self, fit: ExactFit, first: int) -> None:
        """Every second effect beside an exact fit of one."""
        models, candidate = self.models, self.models.candidate
        eta = self.settings.linearisation
        about = equations(models, self.data, fit.about, eta, len(fit.parameters))
        chi2, half, _, _ = Beside(models, about).alone
        scores = models.log_prior - chi2 / 2 - half + self._ray_prior(first)
        scores += log_prior(2, len(models.names), self.settings) - about.own.occam - about.own.grown
        pairs: dict[Members, tuple[float, tuple[int, ...]]] = {}
        for other in range(len(models.names)):
            if other == candidate[first]:
                continue
            rows = np.flatnonzero(candidate == other)
            members = tuple(sorted((other, int(candidate[first]))))
            best = int(rows[np.argmax(scores[rows])])
            pairs[members] = float(np.logaddexp.reduce(scores[rows])), (first, best)
        before = self.families.get(int(candidate[first]))
        if before is None or about.own.grown < before.grown:
            self.families[int(candidate[first])] = _Family(pairs, about.own.grown)

    def _update_misfit(self) -> None:
        """χ² of the best exact fit over its degrees of freedom, where that is significant."""
        best = max(self.fitted.values(), key=lambda c: c.score).fit
        assert best is not None
        found = best[1]
        limit = found.dof + _SIGNIFICANT * np.sqrt(2 * found.dof)
        self.misfit = max(found.chi2 / found.dof, 1.0) if found.chi2 > limit else 1.0
        self.excess = max(found.chi2 - limit, 0.0)

    def _compared(self) -> dict[Members, _Compared]:
        """All sets that were compared: those with fits of their own, and pairs beside a member's.

        A pair of a family is compared with those of the family that have fits of their own by what
        all of them have beside the common member: what the fits gained together, at most what the
        error of that expansion cost, is credited to it as well.
        """
        found: dict[Members, _Compared] = {}
        for family in self.families.values():
            both = [m for m in family.pairs if m in self.fitted]
            credit = 0.0
            if both:
                exact = np.logaddexp.reduce([self.fitted[m].score for m in both])
                credit = float(exact - np.logaddexp.reduce([family.pairs[m][0] for m in both]))
                credit = float(np.clip(credit, 0.0, family.grown))
            for members, (score, own) in family.pairs.items():
                if members not in found or found[members].score < score + credit:
                    found[members] = _Compared(score + credit, own)
        return found | self.fitted

    def _probabilities(self) -> dict[Members, float]:
        """Probabilities of all sets, as they are stated.

        Where the best fit leaves χ²/dof = m of more than noise, a share of 1 - 1/m goes to
        probabilities for which no difference of χ² up to that excess counts: either the fit has not
        converged or the set is none of those compared.
        """
        shares = self._shares(self.misfit)
        if self.misfit == 1.0:
            return shares
        doubtful, trust = self._shares(1.0 + self.excess), 1.0 / self.misfit
        return {m: trust * share + (1 - trust) * doubtful[m] for m, share in shares.items()}

    def _shares(self, divisor: float) -> dict[Members, float]:
        """Probabilities of all sets with log evidence divided by a number."""
        sets, compared = list(self.first.score), self._compared()
        scores = np.array([self.first.score[members] for members in sets])
        if compared:  # a misfit that the error term of the screening hides
            scores = scores / max(divisor / self.first.misfit, 1.0)
        shares = dict(zip(sets, np.exp(scores - np.logaddexp.reduce(scores)).tolist(), strict=True))
        if not compared:
            return shares
        together = max(sum(shares.get(members, 0.0) for members in compared), 1e-9)
        exact = np.array([c.score for c in compared.values()]) / divisor
        exact = np.exp(exact - np.logaddexp.reduce(exact)) * together
        shares |= dict(zip(compared, exact.tolist(), strict=True))
        whole = sum(shares.values())
        return {members: share / whole for members, share in shares.items()}

    def posterior(self) -> Posterior:
        """Posterior over sets, from what was compared."""
        models, shares, compared = self.models, self._probabilities(), self._compared()
        names = models.names
        marginal = np.zeros(len(names))
        sets: list[HypothesisSet] = []
        for members in sorted(shares, key=lambda m: -shares[m]):
            marginal[list(members)] += shares[members]
            if len(sets) >= _KEPT:
                continue
            found = compared.get(members)
            own = self.first.best[members] if found is None else found.own
            sets.append(
                HypothesisSet(
                    names=tuple(sorted(names[k] for k in members)),
                    probability=shares[members],
                    effects=self._estimates(own, found) if len(sets) < _ESTIMATED else (),
                    exact=found is not None and found.fit is not None,
                    models=own,
                )
            )
        return Posterior(tuple(sets), names, marginal, *self.first.alone(), self.misfit)

    def _estimates(
        self, own: tuple[int, ...], found: _Compared | None
    ) -> tuple[EffectEstimate, ...]:
        if found is not None and found.fit is not None:
            return found.fit[0].estimates(found.fit[1], self.misfit)
        return linear_estimates(
            self.models, self.data, own, self.settings.linearisation, self.misfit
        )
