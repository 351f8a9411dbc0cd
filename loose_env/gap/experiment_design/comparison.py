"""Posterior over sets of effects: all screened by signatures, the leading ones fitted exactly.

The bank's signatures alone screen all sets. Those that lead are then fitted exactly, a pair after
its members alone, and beside an exact fit of a single effect every second one is screened again,
now with the small error that its residual leaves. Within the sets compared so, the exact evidence
decides; their probability together is that of the screening.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from loose_env.gap.experiment_design.expansion import (
    SIZE_SD,
    Data,
    Expansion,
    LocalModels,
    Solution,
    equations,
    linear_fit,
    nominal,
    parabola,
    solve,
)
from loose_env.gap.experiment_design.screening import (
    BeliefSettings,
    Beside,
    EffectEstimate,
    HypothesisSet,
    Posterior,
    ScreenedSets,
    linear_estimates,
    log_prior,
    screened,
)
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.torque_terms import has_terms
from loose_env.typing import Array

_Key = tuple[object, ...]


class Simulations:
    """Simulated motions of the hypotheses of one comparison.

    Effects whose torques are computed step by step in Python cost by steps, whatever the number of
    simulations: those that will be needed are made together, and count once they are used.
    """

    def __init__(self, models: LocalModels, left: int) -> None:
        self.models, self.left = models, left
        self._made: dict[_Key, Array | None] = {}

    def readings(self, motion: int, hypotheses: Sequence[Hypothesis]) -> list[Array | None]:
        """Projected readings of a motion (K,) under hypotheses; None where one diverged."""
        self.left -= len(hypotheses)
        self._make([motion], hypotheses)
        return [self._made[self._key(motion, each)] for each in hypotheses]

    def ahead(self, motions: Sequence[int], hypotheses: Sequence[Hypothesis]) -> None:
        """Make simulations of some motions that will be needed, where that saves time."""
        slow = [each for each in hypotheses if has_terms(each)]
        if len(slow) * len(motions) > 1:
            self._make(motions, slow)

    def _make(self, motions: Sequence[int], hypotheses: Sequence[Hypothesis]) -> None:
        bank = self.models.bank
        lacking = [
            each
            for each in hypotheses
            if any(self._key(motion, each) not in self._made for motion in motions)
        ]
        if not lacking:
            return
        commands = [bank.library[motion].commands(bank.arm) for motion in motions]
        found = bank.arm.simulate_motions(lacking, commands)
        for motion, rows in zip(motions, found, strict=True):
            for each, readings in zip(lacking, rows, strict=True):
                inside = None
                if np.isfinite(readings).all():
                    inside = bank.signatures[motion].projected(readings, bank.arm.noise)[0]
                self._made[self._key(motion, each)] = inside

    @staticmethod
    def _key(motion: int, hypothesis: Hypothesis) -> _Key:
        pairs = ((id(effect), values.tobytes()) for effect, values in hypothesis.pairs)
        return motion, hypothesis.factors.tobytes(), *pairs


_REACH, _SHRINK = 1.2, 0.4
"""Largest step in the logarithm of a size, and its factor after a step that made the fit worse."""
_SLOW, _DIFFERENCE = 0.5, 0.02
"""A step that leaves more than this share of the way is slow: the derivatives by sizes and shapes
are then found by differences over this many prior standard deviations."""
_RESEMBLES = 1.0
"""Component of the derivative by a nominal parameter along that by a size or shape, from which it
is sharpened too [noise standard deviations]."""
_SMALLER = 0.4
"""Least size to begin with, over that of the local model."""
_NOMINAL_WITHIN, _SHAPES_WITHIN = 1.7, 3.0
"""Bounds of nominal parameters (the tolerance) and of shape parameters [prior sd]."""
_BELOW, _ABOVE = 0.1, 3.0
"""Bounds of a size over the smallest and largest of the bank."""


@dataclass(eq=False)
class ExactFit:
    """Exact fit of a set of effects.

    Its parameters are the nominal ones, then the logarithm of the size and the shape of each
    effect, all over their prior standard deviations.
    """

    models: LocalModels
    rays: tuple[int, ...]
    """Rays of its effects."""
    settings: BeliefSettings
    parameters: Array = field(default_factory=lambda: np.empty(0))
    """Where it is simulated next (D,)."""
    about: dict[int, Expansion] = field(default_factory=dict)
    """Motion -> latest exact expansion."""
    diverged: bool = False
    _reach: float = _REACH
    _slow: bool = False
    _sloped: set[int] = field(default_factory=set)
    _sharp: set[int] = field(default_factory=set)

    def with_models(self, beside: Sequence[int], parameters: Array) -> ExactFit:
        """New fit of these effects and more, from a linear fit of local models beside them."""
        models, parts = self.models, [parameters[: len(self.parameters)]]
        rays = tuple(int(models.ray[h]) for h in beside)
        width, at = models.weights.shape[2] - 1, len(self.parameters)
        for h, ray in zip(beside, rays, strict=True):
            size = float(models.size[h]) * max(1 + SIZE_SD * float(parameters[at]), _SMALLER)
            shapes = len(models.bank.rays[ray].shape_parameters)
            parts += [
                np.array([(np.log(size) - self._middle(ray)) / self.settings.size_sd]),
                parameters[at + 2 : at + 2 + shapes],
            ]
            at += width
        fit = ExactFit(models, (*self.rays, *rays), self.settings)
        fit.parameters = fit._bounded(np.concatenate(parts))
        return fit

    def _middle(self, ray: int) -> float:
        """Prior mean of the logarithm of a size."""
        return float(np.mean(np.log(self.models.bank.sizes[ray])))

    def _parts(self) -> list[tuple[int, int, int]]:
        """Ray, index of the size among the parameters and index after the last shape."""
        at, found = self.models.bank.nuisances, []
        for ray in self.rays:
            end = at + 1 + len(self.models.bank.rays[ray].shape_parameters)
            found.append((ray, at, end))
            at = end
        return found

    def _size(self, ray: int, value: float) -> float:
        return float(np.exp(self._middle(ray) + self.settings.size_sd * value))

    def _bounded(self, parameters: Array) -> Array:
        found, bank = parameters.copy(), self.models.bank
        found[: bank.nuisances] = np.clip(
            found[: bank.nuisances], -_NOMINAL_WITHIN, _NOMINAL_WITHIN
        )
        for ray, at, end in self._parts():
            low = max(bank.rays[ray].smallest, _BELOW * bank.sizes[ray][0])
            high = min(0.98 * bank.rays[ray].largest, _ABOVE * bank.sizes[ray][-1])
            ends = (np.log([low, high]) - self._middle(ray)) / self.settings.size_sd
            found[at] = np.clip(found[at], *ends)
            found[at + 1 : end] = np.clip(found[at + 1 : end], -_SHAPES_WITHIN, _SHAPES_WITHIN)
        return found

    def _bank_jacobian(self, motion: int, at: Array) -> Array:
        """Derivatives by the parabolas of the bank (K, D)."""
        bank = self.models.bank
        vectors = self.models.products(motion)[0]
        found = [vectors[:, : bank.nuisances]]
        for ray, k, _ in self._parts():
            size, sizes = self._size(ray, float(at[k])), bank.sizes[ray]
            first = bank.point(ray, 0)
            slope = vectors[:, first : first + len(sizes)] @ parabola(sizes, size)[0]
            shapes = vectors[:, list(bank.shape_columns[ray])] * size / sizes[len(sizes) // 2]
            found += [(slope * size * self.settings.size_sd)[:, None], shapes]
        return np.concatenate(found, axis=1)

    def hypothesis(self, parameters: Array) -> Hypothesis:
        """The hypothesis at some parameters (D,)."""
        bank = self.models.bank
        nominal = bank.arm.nominal
        sds = np.array([p.spread or 1.0 for p in nominal.parameters]) * bank.arm.tolerance
        return Hypothesis(
            effects=tuple(bank.rays[ray].effect for ray in self.rays),
            values=tuple(
                bank.rays[ray].values(
                    self._size(ray, float(parameters[at])), parameters[at + 1 : e]
                )
                for ray, at, e in self._parts()
            ),
            nominal=nominal,
            factors=1 + sds * parameters[: bank.nuisances],
        )

    def lacks(self, data: Data) -> list[int]:
        """Measured motions that are not simulated yet."""
        return [motion for motion in data if motion not in self.about]

    def solution(self, data: Data) -> Solution:
        """Least squares about the latest simulations."""
        return solve(data, self.about, self.settings.linearisation, len(self.parameters))

    def step(self, data: Data, simulations: Simulations, within: float) -> None:
        """Simulate motions that are new; if there are none, take one step of the fit."""
        new = self.lacks(data)
        here = self.hypothesis(self.parameters)
        simulations.ahead(new, [here])
        for motion in new:
            found = simulations.readings(motion, [here])[0]
            if found is None:
                self.diverged = True
                return
            jacobian = self._bank_jacobian(motion, self.parameters)
            self.about[motion] = Expansion(found, self.parameters, jacobian)
        if new:
            self._reach = _REACH
            return
        target = self._bounded(self.solution(data).parameters)
        far, before = self._far(data, target, within), self.unsettled(data)
        blunt = [k for k in far if k not in self._sloped]
        if self._slow and blunt:
            for motion in blunt:
                self._difference(motion, [], simulations)
            self._slow = False
            return
        way = target - self.parameters
        longest = max(
            (abs(way[at]) * self.settings.size_sd for _, at, _ in self._parts()), default=0.0
        )
        step = min(1.0, self._reach / max(longest, 1e-9))
        tried = self._bounded(self.parameters + step * way)
        if self._moved(data, far, tried, simulations):
            self.parameters = tried
        else:
            self._reach = _SHRINK * min(longest * step, self._reach)
        self._slow = self.unsettled(data) > _SLOW * before

    def sharpen(self, motions: Iterable[int], simulations: Simulations) -> None:
        """Replace the derivatives of motions by differences of simulations.

        Those by sizes and shapes, and by the nominal parameters that resemble one of them: of a
        machine whose gain is a fifth off, the bank's derivative by the nominal gain differs enough
        to tell both apart, which nothing does.
        """
        first = self.models.bank.nuisances
        for motion in motions:
            jacobian = self.about[motion].jacobian
            own = jacobian[:, first:]
            along = jacobian[:, :first].T @ (own / (np.linalg.norm(own, axis=0) + 1e-9))
            alike = np.flatnonzero((np.abs(along) > _RESEMBLES).any(axis=1))
            self._difference(motion, alike.tolist(), simulations)
            self._sharp.add(motion)

    def _difference(self, motion: int, nuisances: Sequence[int], simulations: Simulations) -> None:
        """Derivatives of a motion by some nominal parameters and all sizes and shapes."""
        about = self.about[motion]
        which = [*nuisances, *range(self.models.bank.nuisances, len(self.parameters))]
        steps = np.where(about.at[which] > 0, -_DIFFERENCE, _DIFFERENCE)  # off the bounds
        moved = about.at + np.eye(len(about.at))[which] * steps[:, None]
        jacobian = about.jacobian.copy()
        simulated = simulations.readings(motion, [self.hypothesis(each) for each in moved])
        for k, step, found in zip(which, steps, simulated, strict=True):
            if found is not None:
                jacobian[:, k] = (found - about.readings) / step
        self.about[motion] = replace(about, jacobian=jacobian)
        self._sloped.add(motion)

    def blunt(self, data: Data) -> list[int]:
        """Motions whose derivatives were not sharpened yet."""
        return [motion for motion in data if motion not in self._sharp]

    def unsettled(self, data: Data) -> float:
        """Length of the change of the readings to the fit from where they were simulated.

        By the derivatives [noise standard deviations]; infinite before all motions are simulated.
        """
        if set(self.about) != set(data):
            return float("inf")
        target = self._bounded(self.solution(data).parameters)
        return float(np.sqrt(sum(n * self._way(k, target) ** 2 for k, (_, n) in data.items())))

    def _far(self, data: Data, target: Array, within: float) -> list[int]:
        ways = {k: self._way(k, target) * float(np.sqrt(data[k][1])) for k in data}
        return [k for k, way in ways.items() if way > min(within, 0.99 * max(ways.values()))]

    def _way(self, motion: int, target: Array) -> float:
        about = self.about[motion]
        return float(np.linalg.norm(about.jacobian @ (target - about.at)))

    def _moved(
        self, data: Data, far: Sequence[int], tried: Array, simulations: Simulations
    ) -> bool:
        """Simulate motions at new parameters; whether the fit got better there.

        The derivatives learn from it in any case.
        """
        there = self.hypothesis(tried)
        simulations.ahead(far, [there])
        found = {k: simulations.readings(k, [there])[0] for k in far}
        before, after = float(self.parameters @ self.parameters), float(tried @ tried)
        for motion, readings in found.items():
            if readings is None:
                return False
            about, (mean, repeated) = self.about[motion], data[motion]
            before += repeated * float(np.sum((mean - about.readings) ** 2))
            after += repeated * float(np.sum((mean - readings) ** 2))
        better = after < before + 1.0
        for motion, readings in found.items():
            assert readings is not None
            about = self.about[motion]
            way = tried - about.at
            along = way.copy()
            along[: self.models.bank.nuisances] = 0.0
            jacobian = about.jacobian
            if motion not in self._sharp and along @ along > 1e-12:
                missed = readings - about.readings - jacobian @ way
                jacobian = jacobian + np.outer(missed, along) / (along @ along)
            kept = (readings, tried) if better else (about.readings, about.at)
            self.about[motion] = Expansion(*kept, jacobian)
        return better

    def estimates(self, found: Solution, misfit: float) -> tuple[EffectEstimate, ...]:
        """Estimates of the effects, with 95 % intervals in the logarithm of their sizes."""
        estimates = []
        for ray_index, at, end in self._parts():
            ray = self.models.bank.rays[ray_index]
            spread = 1.96 * float(np.sqrt(found.covariance[at, at] * misfit))
            values = self._bounded(found.parameters)
            sizes = [self._size(ray_index, values[at] + s) for s in (0.0, -spread, spread)]
            estimates.append(EffectEstimate.of(ray, sizes, values[at + 1 : end]))
        return tuple(sorted(estimates, key=lambda e: e.name))


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
        eta, count = self.settings.linearisation, self.models.bank.nuisances
        about = equations(self.models, data, nominal(self.models, data), eta, count)
        first = screened(self.models, about, self.settings)
        simulations = self.settings.simulations
        round_ = _Round(self, data, first, Simulations(self.models, simulations))
        if simulations and data:
            round_.run()
        return round_.posterior()

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
