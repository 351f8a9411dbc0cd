"""Posterior over missing effects from measured motions, in closed form.

With residuals y of all motions in noise standard deviations, projected onto the directions of the
bank, a hypothesis is

    y = V ν + Σ_e (m_e + C_e θ_e) + ε,      ν, θ ~ N(0, I),    ε_k ~ N(0, 1/n_k + δ_k)

with V the derivatives by the nominal parameters, each times its prior standard deviation; m_e the
mean of an effect about a linearisation point, and C_e its slope, curvature and shape columns; n_k
repetitions of motion k in K_k directions; δ_k = (η |y_k|)² / K_k the error of the linearisation, in
proportion to what is seen, which a repetition does not average out.

ν is eliminated once for all hypotheses (Schur complement), so that each costs the determinant of a
matrix of four or eight rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.gap.experiment_design.local_models import SIZE_SD, LocalModels
from loose_env.typing import Array

__all__ = [
    "BeliefSettings",
    "EffectEstimate",
    "HypothesisSet",
    "NormalEquations",
    "Posterior",
    "posterior_of",
]


@dataclass(frozen=True, kw_only=True)
class BeliefSettings:
    """Priors and errors of the belief.

    Examples
    --------
    >>> BeliefSettings(none=0.9, single=0.2)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: none and single are probabilities of at most 1 in all, ...
    """

    none: float = 0.2
    """Prior probability that no effect is missing."""
    single: float = 0.5
    """Prior probability that one is; two otherwise."""
    linearisation: float = 0.04
    """Error of the linearisation over the residual's length [1]."""
    first: int = 24
    """Candidates beside which every other one is tried as the second of a pair."""
    swaps: int = 10
    """Members of good pairs beside which every other one is tried again."""
    kept: int = 3000
    """Hypotheses that are kept of all."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not (self.none > 0 and self.single > 0 and self.none + self.single <= 1):
            raise InvalidSetting(
                "none and single are probabilities of at most 1 in all, above 0 each, got "
                f"{self.none!r} and {self.single!r}"
            )
        if not 0 <= self.linearisation < 1:
            raise InvalidSetting(f"linearisation is a share below 1, got {self.linearisation!r}")


@dataclass(frozen=True)
class EffectEstimate:
    """An effect with the parameter by which its size is stated."""

    name: str
    """Kind and location."""
    parameter: str
    """Name of the parameter."""
    unit: str
    value: float
    """Posterior mean."""
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end."""
    size: float
    """Size over that of the linearisation ray's start."""


@dataclass(frozen=True)
class HypothesisSet:
    """A set of missing effects with its probability."""

    names: tuple[str, ...]
    """Kinds and locations, sorted; empty for none."""
    probability: float
    log_evidence: float
    """Log evidence of its best local models against that of no effect [nats]."""
    effects: tuple[EffectEstimate, ...]
    models: tuple[int, ...] = field(default=(), repr=False)
    """Indices of its best local models."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior over sets of effects."""

    sets: tuple[HypothesisSet, ...]
    """By decreasing probability."""
    names: tuple[str, ...]
    """All candidates."""
    marginal: Array
    """Probability that each candidate is among the missing effects (names,)."""
    log_evidence: Array
    """Log evidence of each candidate alone against none, its best local model [nats] (names,)."""
    size: Array
    """Posterior mean of the log10 of each candidate's visibility, alone (names,)."""
    size_sd: Array
    """Its standard deviation (names,)."""
    misfit: float
    """χ² of the best hypothesis over its degrees of freedom, at least 1: evidence is divided by
    it (Birge ratio)."""

    @property
    def best(self) -> HypothesisSet:
        """The most probable set."""
        return self.sets[0]

    @property
    def entropy(self) -> float:
        """Entropy of the sets [nats]."""
        p = np.array([s.probability for s in self.sets])
        return float(-np.sum(p * np.log(np.maximum(p, 1e-300))))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of base vectors and residuals, and their Schur complements."""

    gram: Array
    """(V, V)."""
    right: Array
    """(V,)."""
    total: float
    """Weighted square of the residuals."""
    dof: int
    """Numbers in all residuals."""
    models: LocalModels

    @cached_property
    def reduced(self) -> tuple[Array, Array, float]:
        """Gram matrix (T, T), right side (T,) and square without the nominal parameters."""
        p = self.models.bank.nuisances
        own = self.gram[:p, :p] + np.eye(p)
        solved = np.linalg.solve(own, np.column_stack([self.gram[:p, p:], self.right[:p]]))
        gram = self.gram[p:, p:] - self.gram[p:, :p] @ solved[:, :-1]
        right = self.right[p:] - self.gram[p:, :p] @ solved[:, -1]
        total = self.total - float(self.right[:p] @ solved[:, -1])
        weights = self.models.combinations
        half = np.asarray((weights.T @ gram).T)  # (S, T): gram is symmetric
        return np.asarray(weights.T @ half), np.asarray(weights.T @ right), total


def _alone(
    gram: Array, right: Array, total: float, models: LocalModels
) -> tuple[Array, Array, Array, Array]:
    """Chi-square (H,), half log-determinant (H,), coefficients (H, Q), covariances (H, Q, Q)."""
    c, m = models.columns, models.means
    curvature = gram[c[:, :, None], c[:, None, :]] + np.eye(c.shape[1])
    slope = right[c] - gram[c, m[:, None]]
    square = total - 2 * right[m] + gram[m, m]
    return _solved(curvature, slope, square)


def _solved(curvature: Array, slope: Array, square: Array) -> tuple[Array, Array, Array, Array]:
    root = np.linalg.cholesky(curvature)
    covariance = np.linalg.inv(curvature)
    coefficients = np.einsum("hij,hj->hi", covariance, slope)
    chi2 = square - np.sum(slope * coefficients, axis=1)
    half = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return chi2, half, coefficients, np.asarray(covariance)


def _beside(
    first: int, gram: Array, right: Array, total: float, models: LocalModels
) -> tuple[Array, Array]:
    """Chi-square and half log-determinant of every local model beside a given one (H,)."""
    c, m = models.columns, models.means
    own, mean = c[first], m[first]
    curvature = gram[np.ix_(own, own)] + np.eye(len(own))
    inverse = np.linalg.inv(curvature)
    slope = right[own] - gram[own, mean]
    total = total - 2 * right[mean] + gram[mean, mean] - float(slope @ inverse @ slope)
    rows = gram[own]  # (Q, T)
    right = right - gram[mean] - slope @ inverse @ rows
    solved = inverse @ rows
    at, by = rows[:, c], solved[:, c]  # (Q, H, Q)
    blocks = gram[c[:, :, None], c[:, None, :]] - np.einsum("qhi,qhj->hij", at, by)
    across = gram[c, m[:, None]] - np.einsum("qhi,qh->hi", at, solved[:, m])
    diagonal = gram[m, m] - np.sum(rows[:, m] * solved[:, m], axis=0)
    found = _solved(blocks + np.eye(c.shape[1]), right[c] - across, total - 2 * right[m] + diagonal)
    half = float(np.linalg.slogdet(curvature)[1]) / 2
    return found[0], found[1] + half


def posterior_of(
    equations: NormalEquations, models: LocalModels, settings: BeliefSettings
) -> Posterior:
    """Posterior over sets of at most two effects.

    Singles are all evaluated. Pairs are those of any effect beside one of the best singles, then
    beside one of the second members of the best pairs.
    """
    gram, right, total = equations.reduced
    count = len(models.names)
    chi2, half, coefficients, covariances = _alone(gram, right, total, models)
    candidate = models.candidate
    pairs = count * (count - 1) / 2
    double = max(1.0 - settings.none - settings.single, 1e-12)
    first = [np.full(1, -1), np.arange(models.count)]
    second = [np.full(1, -1), np.full(models.count, -1)]
    fits = [np.array([total]), chi2]
    others = [
        np.array([np.log(settings.none)]),
        np.log(settings.single / count) + models.log_prior - half,
    ]

    def pair_up(which: Sequence[int]) -> None:
        for h in which:
            fit, size = _beside(h, gram, right, total, models)
            fit = np.where(candidate == candidate[h], np.inf, fit)
            first.append(np.full(models.count, h))
            second.append(np.arange(models.count))
            fits.append(fit)
            others.append(
                np.log(double / max(pairs, 1)) + models.log_prior + models.log_prior[h] - size
            )

    if count > 1:
        tried = _leading(others[1] - chi2 / 2, candidate, settings.first)
        pair_up(tried)
        begun = 2
        score = np.concatenate(others[begun:]) - np.concatenate(fits[begun:]) / 2
        seconds = np.concatenate(second[begun:])
        best = [int(h) for h in seconds[np.argsort(-score)[: 40 * settings.swaps]]]
        again = [h for h in dict.fromkeys(best) if h not in set(tried)][: settings.swaps]
        pair_up(again)
    a, b = np.concatenate(first), np.concatenate(second)
    fit, rest = np.concatenate(fits), np.concatenate(others)
    misfit = max(float(np.min(fit)) / max(equations.dof, 1), 1.0)
    # the same pair may have been reached from either side
    low, high = np.minimum(a, b), np.maximum(a, b)
    _, unique = np.unique(high * (models.count + 1) + low, return_index=True)
    score = (rest - fit / 2 / misfit)[unique]
    order = np.argsort(-score)[: settings.kept]
    which, score = unique[order], score[order]
    weights = np.exp(score - score[0])
    weights /= weights.sum()
    return _summary(
        models, a[which], b[which], weights, score, misfit, total,
        (chi2, half, coefficients, covariances), (gram, right),
    )  # fmt: skip


def _leading(score: Array, candidate: NDArray[np.intp], most: int) -> list[int]:
    """Local models by decreasing score, two of a candidate at most."""
    found: list[int] = []
    seen: dict[int, int] = {}
    for h in np.argsort(-score):
        own = int(candidate[h])
        if seen.get(own, 0) < 2:
            seen[own] = seen.get(own, 0) + 1
            found.append(int(h))
        if len(found) == most:
            break
    return found


def _summary(
    models: LocalModels,
    first: NDArray[np.intp],
    second: NDArray[np.intp],
    weights: Array,
    score: Array,
    misfit: float,
    total: float,
    alone: tuple[Array, Array, Array, Array],
    reduced: tuple[Array, Array],
) -> Posterior:
    names, candidate = models.names, models.candidate
    grouped: dict[tuple[int, ...], list[int]] = {}
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        members = tuple(sorted(int(candidate[h]) for h in (a, b) if h >= 0))
        grouped.setdefault(members, []).append(k)
    marginal = np.zeros(len(names))
    sets: list[HypothesisSet] = []
    shares = {members: float(weights[rows].sum()) for members, rows in grouped.items()}
    for members in sorted(shares, key=lambda m: -shares[m]):
        rows = grouped[members]
        marginal[list(members)] += shares[members]
        if len(sets) >= 40:
            continue
        best = rows[0]
        own = tuple(int(h) for h in (first[best], second[best]) if h >= 0)
        sets.append(
            HypothesisSet(
                names=tuple(sorted(names[k] for k in members)),
                probability=shares[members],
                log_evidence=float(score[best] + total / 2 / misfit),
                effects=_estimates(models, own, reduced, misfit),
                models=own,
            )
        )
    chi2, half, coefficients, covariances = alone
    evidence = (total - chi2) / 2 / misfit - half
    best_of = np.full(len(names), -np.inf)
    np.maximum.at(best_of, candidate, evidence)
    size, size_sd = np.zeros(len(names)), np.zeros(len(names))
    seen = np.concatenate(models.bank.visibilities)
    for k in range(len(names)):
        rows_of = np.flatnonzero(candidate == k)
        h = rows_of[np.argmax(evidence[rows_of])]
        factor = max(1 + SIZE_SD * float(coefficients[h, 0]), 0.05)
        size[k] = np.log10(max(seen[h] * factor, 1e-3))
        size_sd[k] = SIZE_SD * float(np.sqrt(covariances[h, 0, 0] * misfit)) / factor / np.log(10)
    return Posterior(tuple(sets), names, marginal, best_of, size, size_sd, misfit)


def _estimates(
    models: LocalModels, own: tuple[int, ...], reduced: tuple[Array, Array], misfit: float
) -> tuple[EffectEstimate, ...]:
    """Estimates of the effects of some local models, fitted together."""
    if not own:
        return ()
    gram, right = reduced
    columns = np.concatenate([models.columns[h] for h in own])
    means = [int(models.means[h]) for h in own]
    curvature = gram[np.ix_(columns, columns)] + np.eye(len(columns))
    slope = right[columns] - gram[columns][:, means].sum(axis=1)
    covariance = np.linalg.inv(curvature)
    found, width = covariance @ slope, models.columns.shape[1]
    estimates = []
    for number, h in enumerate(own):
        ray = models.bank.rays[models.ray[h]]
        size, at = float(models.size[h]), number * width
        spread = 1.96 * SIZE_SD * size * float(np.sqrt(covariance[at, at] * misfit))
        fitted = max(size * (1 + SIZE_SD * float(found[at])), 0.02 * size)
        shape = found[at + 2 : at + 2 + len(ray.shape_parameters)]
        main = ray.main
        ends = [
            float(ray.values(max(s, 1e-6), shape)[main])
            for s in (fitted, fitted - spread, fitted + spread)
        ]
        parameter = ray.effect.parameters[main]
        estimates.append(
            EffectEstimate(
                ray.name, parameter.name, parameter.unit, ends[0], min(ends), max(ends), fitted
            )
        )
    return tuple(sorted(estimates, key=lambda e: e.name))
