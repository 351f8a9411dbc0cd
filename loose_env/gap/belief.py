"""Belief: measured motions of one machine in, posterior over sets of effects and outlook out.

With the mean residual ȳ_k of motion k over n_k repetitions, in noise standard deviations, a machine
with effects e is

    ȳ_k = J_k z + Σ_e C_ke θ_e + ε_k,      z ~ N(0, I),   θ_e ~ N(centre, spread²)
    ε_k ~ N(0, 1/n_k + δ_k),    δ_k = (η |ȳ_k|)² / K

z are the nominal parameters, C the columns of the force balance along the motion. δ is the error of
columns along the nominal motion, in proportion to what they have to explain, which a repetition
does not average out. All sets of effects are then small linear problems in one Gram matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from math import comb

import numpy as np

from loose_env.gap.bank import VISIBLE, Along, MotionBank, MotionEvidence, beyond
from loose_env.gap.core.find import silent
from loose_env.gap.core.identifiability import unexplained
from loose_env.gap.core.tolerances import Tolerances
from loose_env.inference import information_bound
from loose_env.typing import Array, IndexArray

_FIRST, _SWAPS = 24, 10
"""Shapes beside which every other one is tried as the second of a pair, and members of good pairs
beside which every other one is tried again."""
_CANDIDATES, _SETS, _ESTIMATED = 3000, 40, 8
"""Hypotheses that are compared, sets of a posterior, and those with estimates."""
_OPEN, _SAMPLES, _LEAST = 16, 32, 1e-3
"""Sets that count as open at most, readings drawn from the prediction of each, and the probability
of an open set over that of the most probable one, at least."""
_PRIOR = (0.2, 0.5, 1.0 - 0.2 - 0.5)
"""Prior probability that none, one and two effects are missing."""
_LINEARISATION = 0.02  # error of the columns over the length of the residual that they explain [1]
_DIRECTIONS = 100  # directions over which the error of the columns spreads
_MISSED = Tolerances().law  # share of its force that the law of an effect misses
_OUT = 2.0  # standard deviations by which an estimate may lie beyond its bounds


@dataclass(frozen=True)
class EffectEstimate:
    """An effect with its parameters."""

    name: str  # Kind and location
    values: tuple[float, ...]  # Posterior means of its parameters
    low: tuple[float, ...]  # Lower ends of the 95 % intervals
    high: tuple[float, ...]  # Upper ends


@dataclass(frozen=True)
class HypothesisSet:
    """A set of missing effects with its probability."""

    names: tuple[str, ...]
    """Kinds and locations, sorted; empty for none."""
    probability: float
    effects: tuple[EffectEstimate, ...]
    """Estimates of its effects; of the most probable sets alone."""
    shapes: tuple[int, ...] = field(default=(), repr=False)
    """Indices of its best shapes in the bank."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior over sets of effects."""

    sets: tuple[HypothesisSet, ...]  # By decreasing probability
    marginal: Array  # Probability that each candidate is among the missing effects (names,)
    log_evidence: Array  # Of the best shape of each candidate alone, against none [nats] (names,)
    size: Array  # Log10 of each candidate's visibility, alone (names,)
    size_sd: Array  # Its standard deviation (names,)
    misfit: float
    """χ² of the best hypothesis over its degrees of freedom, 1 where that is no more than chance;
    variances of the parameters are multiplied by it (Birge ratio)."""

    @property
    def best(self) -> HypothesisSet:
        """The most probable set."""
        return self.sets[0]


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares of some columns: means, covariance, and what is left with the parameters'."""

    at: IndexArray
    values: Array
    covariance: Array
    chi2: float


class Belief:
    """Belief about one machine, updated by measured motions.

    Parameters
    ----------
    bank : MotionBank
        Evidence of the motions.
    """

    def __init__(self, bank: MotionBank) -> None:
        self.bank = bank
        self.sums: dict[int, Array] = {}
        """Motion -> sum of the residuals of its repetitions (R,)."""
        self.counts: dict[int, int] = {}
        """Motion -> repetitions."""
        self.rest: dict[int, float] = {}
        """Motion -> rms of the latest residual beyond all columns [noise sd]."""

    def add(self, motion: int, readings: Array) -> None:
        """Add measured readings (n, C) of a motion of the library, by its index."""
        found = self.bank.evidence[motion]
        with silent():
            measured = Along(self.bank.arm, self.bank.library[motion], readings)
            residual = found.residual(measured)
            before = self.sums.get(motion, np.zeros(len(residual)))
            self.counts[motion] = self.counts.get(motion, 0) + 1
            self._set(motion, before + residual)
            residual = residual - self._bent(found, measured)
        self._set(motion, before + residual)
        self.rest[motion] = found.rest(residual)

    def _set(self, motion: int, total: Array) -> None:
        self.sums[motion] = total
        for name in ("products", "posterior"):
            self.__dict__.pop(name, None)

    def _bent(self, found: MotionEvidence, measured: Along) -> Array:
        """Residual of the best set that its columns lack along the nominal motion (R,)."""
        # The machine moves a little otherwise, and its forces with it.
        own = self.posterior.best.shapes
        fit, free = self.products.fit(own), self.bank.nuisances
        terms = [self.bank.shapes[h].term for h in own]
        moved = measured.tolerances(fit.values[:free])
        for value, column in zip(fit.values[free:], measured.columns(terms), strict=True):
            moved = moved + value * column
        return found.whitened(moved) - found.rows[:, fit.at] @ fit.values

    @cached_property
    def products(self) -> Products:
        """Products of all columns and residuals, motions weighted by their errors."""
        count = self.bank.priors.shape[1] - 1
        gram, right, power, dof = np.zeros((count, count)), np.zeros(count), 0.0, 0
        for motion, total in self.sums.items():
            own, repeated = self.bank.evidence[motion], self.counts[motion]
            mean = total / repeated
            square = float(mean @ mean)
            weight = 1 / (1 / repeated + _LINEARISATION**2 * square / _DIRECTIONS)
            gram += weight * own.gram
            right += weight * (mean @ own.rows)
            power += weight * square
            dof += len(mean)
        return Products(self.bank, gram, right, power, dof)

    @cached_property
    def posterior(self) -> Posterior:
        """Posterior over sets of effects, given all motions so far."""
        return _posterior(self.products)


@dataclass(frozen=True, eq=False)
class Products:
    """Products of all columns and residuals of the measured motions."""

    bank: MotionBank
    gram: Array  # Of the columns (V, V)
    right: Array  # With the residuals (V,)
    power: float  # Of the residuals
    dof: int  # Numbers in all residuals

    def fit(self, own: Sequence[int] = ()) -> _Fit:
        """Nominal parameters, then the columns of some shapes."""
        bank = self.bank
        at = np.array([*range(bank.nuisances), *(k for h in own for k in bank.shapes[h].at)])
        precision, centre = bank.priors[:2, at]
        covariance = np.asarray(np.linalg.inv(self.gram[np.ix_(at, at)] + np.diag(precision)))
        slope = self.right[at] + precision * centre
        values = covariance @ slope
        chi2 = self.power + float(precision @ centre**2) - float(slope @ values)
        return _Fit(at, values, covariance, max(chi2, 0.0))

    @cached_property
    def nominal(self) -> _Fit:
        """Fit of the nominal parameters alone."""
        return self.fit()

    @cached_property
    def _beyond(self) -> tuple[Array, Array]:
        """Products that nominal parameters cannot explain, padded by a column of nothing."""
        free = self.bank.nuisances
        right = self.right - self.gram[:, :free] @ self.nominal.values
        return np.pad(beyond(self.gram, free), ((0, 1), (0, 1))), np.pad(right, (0, 1))

    @cached_property
    def alone(self) -> tuple[Array, Array, Array, Array]:
        """χ² (H,), half log determinant (H,), coefficients (H, Q) and covariances of one shape."""
        return self._solved(*self._beyond, self.nominal.chi2)

    def beside(self, first: int) -> tuple[Array, Array]:
        """χ² and half log determinant of every shape beside a given one (H,)."""
        (gram, right), (chi2, half, found, covariance) = self._beyond, self.alone
        across = gram[self.bank.padded[first]]
        left = gram - across.T @ covariance[first] @ across
        fits, halves, _, _ = self._solved(left, right - found[first] @ across, float(chi2[first]))
        return fits, halves + half[first]

    def _solved(self, gram: Array, right: Array, total: float) -> tuple[Array, Array, Array, Array]:
        """Every shape in products that others are eliminated from; none beyond its bounds."""
        at = self.bank.padded
        prior, centre, low, high = self.bank.priors[:, at]
        precision = gram[at[:, :, None], at[:, None, :]] + prior[:, :, None] * np.eye(at.shape[1])
        # columns of very different size: determinants of the scaled matrix
        scale = 1 / np.sqrt(np.diagonal(precision, axis1=1, axis2=2))
        unit = precision * scale[:, :, None] * scale[:, None, :]
        covariance = np.linalg.inv(unit) * scale[:, :, None] * scale[:, None, :]
        slope = right[at] + prior * centre
        found = np.einsum("hij,hj->hi", covariance, slope)
        chi2 = total + np.sum(prior * centre**2 - slope * found, axis=1)
        half = 0.5 * np.linalg.slogdet(unit)[1] - np.sum(np.log(scale * np.sqrt(prior)), axis=1)
        sd = _OUT * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        out = np.any((found + sd < low) | (found - sd > high), axis=1)
        return np.where(out, np.inf, chi2), half, found, np.asarray(covariance)

    def estimates(self, own: Sequence[int], misfit: float) -> tuple[EffectEstimate, ...]:
        """Estimates of the effects of some shapes."""
        fit, found = self.fit(own), []
        for shape in (self.bank.shapes[h] for h in own):
            at = np.searchsorted(fit.at, shape.at)
            means, sds = fit.values[at], np.sqrt(np.diag(fit.covariance)[at] * misfit)
            spread, units = 1.96 * np.hypot(sds, _MISSED * means), np.eye(len(means))
            moved = [shape.values(means + spread * unit) for unit in (*-units, *units)]
            values = shape.values(means)
            off = np.sqrt(np.sum((np.array(moved) - values) ** 2, axis=0) / 2)
            ends = (tuple(map(float, each)) for each in (values, values - off, values + off))
            found.append(EffectEstimate(shape.name, *ends))
        return tuple(sorted(found, key=lambda each: each.name))


def _posterior(products: Products) -> Posterior:
    """Posterior over sets of at most two effects about the nominal model."""
    # Singles are all evaluated. Pairs are those of any effect beside one of the best singles, then
    # beside one of the second members of the best pairs.
    bank = products.bank
    candidate, count = bank.candidate, len(bank.names)
    chi2, half, _, _ = products.alone
    alike = -np.log(np.bincount(candidate, minlength=count)[candidate])
    none, one, two = (float(np.log(p / max(comb(count, k), 1))) for k, p in enumerate(_PRIOR))
    # by its shapes: fit of a set, and log prior less half the log determinant
    found = {frozenset[int](): (products.nominal.chi2, none)}
    for h, own in enumerate(zip(chi2.tolist(), (one + alike - half).tolist(), strict=True)):
        found[frozenset([h])] = own

    def pair_up(which: Sequence[int]) -> None:
        for h in which:
            fit, size = products.beside(h)
            other = two + alike + alike[h] - size
            for k in np.flatnonzero(np.isfinite(fit) & (candidate != candidate[h])).tolist():
                found[frozenset([h, k])] = float(fit[k]), float(other[k])

    if count > 1:
        first = _leading(one + alike - half - chi2 / 2, candidate, _FIRST)
        pair_up(first)
        best = sorted(found, key=lambda own: found[own][0] / 2 - found[own][1])[: 40 * _SWAPS]
        pair_up(
            [h for h in dict.fromkeys(h for own in best for h in own) if h not in first][:_SWAPS]
        )
    misfit = max(min(fit for fit, _ in found.values()) / max(products.dof, 1), 1.0)
    scores = {own: other - fit / 2 / misfit for own, (fit, other) in found.items()}
    ranked = sorted((own for own in scores if np.isfinite(scores[own])), key=lambda o: -scores[o])
    members: dict[tuple[int, ...], list[frozenset[int]]] = {}
    for shaped in ranked[:_CANDIDATES]:
        members.setdefault(tuple(sorted(candidate[list(shaped)].tolist())), []).append(shaped)
    totals = {w: float(np.logaddexp.reduce([scores[o] for o in own])) for w, own in members.items()}
    whole, marginal = np.logaddexp.reduce(list(totals.values())), np.zeros(count)
    sets: list[HypothesisSet] = []
    for which in sorted(totals, key=lambda which: -totals[which]):
        share = float(np.exp(totals[which] - whole))
        marginal[list(which)] += share
        if len(sets) < _SETS:
            best_shapes = tuple(sorted(members[which][0]))
            known = products.estimates(best_shapes, misfit) if len(sets) < _ESTIMATED else ()
            names = tuple(sorted(bank.names[m] for m in which))
            sets.append(HypothesisSet(names, share, known, best_shapes))
    return Posterior(tuple(sets), marginal, *_alone(products, misfit), misfit)


def _alone(products: Products, misfit: float) -> tuple[Array, Array, Array]:
    """Log evidence, log10 of the visibility and its deviation of each candidate alone (N,)."""
    bank, (chi2, half, coefficients, covariances) = products.bank, products.alone
    score = (products.nominal.chi2 - chi2) / 2 / misfit - half
    best, order = np.empty(len(bank.names), dtype=np.intp), np.argsort(score, kind="stable")
    best[bank.candidate[order]] = order  # the last one written has most
    seen, sds = np.zeros((2, len(best)))
    for k, h in enumerate(best):
        shape, width = bank.shapes[h], len(bank.shapes[h].at)
        seen[k] = max(bank.visibility(shape, coefficients[h, :width]), 1e-3)
        spread = bank.visibility(shape, np.sqrt(np.diag(covariances[h, :width, :width]) * misfit))
        sds[k] = spread / np.hypot(seen[k], spread) / np.log(10)
    return np.where(np.isfinite(score[best]), score[best], -1e6), np.log10(seen), sds


def _leading(score: Array, candidate: IndexArray, most: int) -> list[int]:
    """Shapes by decreasing score, two of a candidate at most."""
    found: list[int] = []
    for h in np.argsort(-score).tolist():
        if np.isfinite(score[h]) and np.sum(candidate[found] == candidate[h]) < 2:
            found.append(h)
    return found[:most]


@dataclass(frozen=True, eq=False)
class Outlook:
    """Expected result of each motion."""

    information: Array
    """Expected information about which set of effects is missing [nats] (M,)."""
    gain: Array
    """Expected gain in the reward of the best verdict (M,)."""


def outlook(belief: Belief, reward: Callable[[tuple[str, ...], tuple[str, ...]], float]) -> Outlook:
    """Expected information of each motion, and what it would add to the reward of a verdict.

    The information is a lower bound of the mutual information between set and readings, from the
    Bhattacharyya distances between the predictions of the sets (Kolchinsky and Tracey, Entropy 19,
    2017, 361):

        I ≥ − Σ_i p_i ln Σ_j p_j exp(−B_ij),    B_ij = (1/8) d²_ij

    d² is what the parameters of one set, as uncertain as they still are, cannot do of the other's
    prediction, in the noise and the error of the columns.

    The gain is the value of information: with readings y drawn from the predictions, and the
    verdict v* that is best now,

        E_y [ max_v Σ_j p(j | y) R(v, j) − Σ_j p(j | y) R(v*, j) ]

    Parameters
    ----------
    belief : Belief
        Belief about the machine.
    reward : callable
        Reward of naming one set while another one is missing.
    """
    weights, names, fits = _predictions(belief)
    rewards = np.array([[reward(named, truth) for truth in names] for named in names])
    means = np.zeros((belief.bank.priors.shape[1] - 1, len(fits)))
    for k, fit in enumerate(fits):
        means[fit.at, k] = fit.values
    precisions = [np.asarray(np.linalg.inv(fit.covariance), float) for fit in fits]
    information, gain = [], []
    centred = np.eye(len(weights)) - weights
    for own in belief.bank.evidence:
        moved = own.gram @ means
        squares = means.T @ moved
        power = np.diag(squares)
        noise = 1.0 + _LINEARISATION**2 * float(weights @ power) / _DIRECTIONS
        apart = power[:, None] - 2 * squares + power  # [i, k] of set i from set k
        found = np.empty_like(apart)
        for k, (fit, precision) in enumerate(zip(fits, precisions, strict=True)):
            cross = moved[fit.at] - moved[fit.at, k][:, None]
            normal = own.gram[np.ix_(fit.at, fit.at)]
            found[:, k] = unexplained(apart[:, k] / noise, cross / noise, normal / noise, precision)
        squared = np.maximum(found + found.T, 0.0) / 2
        np.fill_diagonal(squared, 0.0)
        information.append(information_bound(weights, squared))
        gain.append(value_of_information(weights, -centred @ squared @ centred.T / 2, rewards))
    return Outlook(np.array(information), np.array(gain))


def value_of_information(weights: Array, products: Array, rewards: Array) -> float:
    """Expected gain in reward by a motion.

    Examples
    --------
    >>> equal = np.full(2, 0.5)  # two sets 4 standard deviations apart: 2 Φ(2) - 1 = 0.954
    >>> round(value_of_information(equal, np.diag([16.0, 0.0]), 2 * np.eye(2) - 1), 1)
    1.0
    """
    values, vectors = np.linalg.eigh(products)
    noise = _normal(len(weights)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    scores = np.log(weights) - np.diag(products) / 2 + products[:, None] + noise
    scores -= scores.max(axis=2, keepdims=True)
    posterior = np.exp(scores)
    posterior /= posterior.sum(axis=2, keepdims=True)
    verdicts = posterior @ rewards.T
    now = int(np.argmax(rewards @ weights))
    return float(weights @ np.mean(verdicts.max(axis=2) - verdicts[:, :, now], axis=1))


@cache
def _normal(count: int) -> Array:
    """Standard normal numbers in pairs of either sign (_SAMPLES, count)."""
    half = np.random.default_rng(0).normal(size=(_SAMPLES // 2, count))
    return np.concatenate([half, -half])


def _predictions(belief: Belief) -> tuple[Array, list[tuple[str, ...]], list[_Fit]]:
    """Probabilities of the open sets, their effects and their fitted parameters."""
    if not belief.counts:
        return _prior_predictions(belief)
    best = belief.posterior.best.probability
    sets = [s for s in belief.posterior.sets[:_OPEN] if s.probability > _LEAST * best]
    weights = np.array([each.probability for each in sets])
    fits = [belief.products.fit(each.shapes) for each in sets]
    return weights / weights.sum(), [each.names for each in sets], fits


def _prior_predictions(belief: Belief) -> tuple[Array, list[tuple[str, ...]], list[_Fit]]:
    """Before any motion: no effect, and each candidate at a middle visibility."""
    bank, free = belief.bank, belief.bank.nuisances
    middle = float(np.sqrt(VISIBLE[0] * VISIBLE[1]))
    fits = [_Fit(np.arange(free), np.zeros(free), np.eye(free), 0.0)]
    for number in range(len(bank.names)):
        own = [bank.shapes[h] for h in np.flatnonzero(bank.candidate == number)]
        seen = [bank.visibility(s, s.centre) if s.term.law else middle for s in own]
        shape = own[int(np.argmin(np.abs(np.log(seen) - np.log(middle))))]
        sized = middle * bank.unit(shape, 0) * np.eye(len(shape.at))[0]
        mean = shape.centre if shape.term.law else sized
        sds = np.append(np.ones(free), np.full(len(mean), 0.45 * np.abs(mean).max()))
        at = np.array([*range(free), *shape.at])
        fits.append(_Fit(at, np.append(np.zeros(free), mean), np.diag(sds**2), 0.0))
    weights = np.full(len(fits), _PRIOR[1] / max(len(fits) - 1, 1))
    weights[0] = _PRIOR[0]
    return weights / weights.sum(), [(), *((name,) for name in bank.names)], fits
