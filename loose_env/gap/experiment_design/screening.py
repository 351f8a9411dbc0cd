"""Screening of single effects and pairs by closed-form log posterior, with linear estimates.

The own parameters of the hypothesis are eliminated once (Schur complement); each effect beside it
then costs the determinant of a matrix of four rows, each pair that of eight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.gap.experiment_design.candidates import Ray
from loose_env.gap.experiment_design.local_models import SIZE_SD, LocalModels, Products
from loose_env.typing import Array

_FIRST = 24
"""Local models beside which every other one is tried as the second of a pair."""
_SWAPS = 10
"""Members of good pairs beside which every other one is tried again."""
_KEPT = 3000
"""Hypotheses that are kept of all."""


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
    """Error of a linearisation over the length of the residual about its centre [1]."""

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

    @classmethod
    def of(cls, ray: Ray, sizes: Sequence[float], shape: Array) -> EffectEstimate:
        """Estimate of an effect with the ends of its interval, by its sizes."""
        value, *ends = (float(ray.values(size, shape)[ray.main]) for size in sizes)
        parameter = ray.effect.parameters[ray.main]
        return cls(ray.name, parameter.name, parameter.unit, value, min(ends), max(ends))


@dataclass(frozen=True)
class HypothesisSet:
    """A set of missing effects with its probability."""

    names: tuple[str, ...]
    """Kinds and locations, sorted; empty for none."""
    probability: float
    effects: tuple[EffectEstimate, ...]
    """Estimates of its effects; of the most probable sets alone."""
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
    """χ² of the best hypothesis over its degrees of freedom, 1 where that is no more than chance;
    variances of the parameters are multiplied by it (Birge ratio)."""

    @property
    def best(self) -> HypothesisSet:
        """The most probable set."""
        return self.sets[0]


def log_prior(count: int, candidates: int, settings: BeliefSettings) -> float:
    """Log prior probability of one set of some number of effects."""
    if count == 0:
        return float(np.log(settings.none))
    if count == 1:
        return float(np.log(settings.single / candidates))
    double = max(1.0 - settings.none - settings.single, 1e-12)
    return float(np.log(double / max(candidates * (candidates - 1) / 2, 1)))


@dataclass(frozen=True, eq=False)
class Beside:
    """Every local model beside a hypothesis."""

    products: Products

    @property
    def models(self) -> LocalModels:
        """The local models."""
        return self.products.models

    @cached_property
    def _gram(self) -> Array:
        """Products of the base vectors, with the one that is none (S + 1, S + 1)."""
        return np.pad(self.products.beyond[0], ((0, 1), (0, 1)))

    @cached_property
    def _blocks(self) -> tuple[Array, Array]:
        """Products of mean and columns of each local model (H, 1 + Q, 1 + Q), and right sides."""
        models = self.models
        gram = self._gram
        right = np.pad(self.products.beyond[1], (0, 1))
        at, weights = models.support, models.weights
        inner = np.swapaxes(weights, 1, 2) @ gram[at[:, :, None], at[:, None, :]] @ weights
        return inner, np.einsum("hbq,hb->hq", weights, right[at])

    @cached_property
    def alone(self) -> tuple[Array, Array, Array, Array]:
        """χ² (H,), half log-determinant (H,), coefficients (H, Q) and covariances (H, Q, Q)."""
        inner, right = self._blocks
        return _solved(inner, right, self.products.nominal.chi2)

    def with_first(self, first: int) -> tuple[Array, Array]:
        """χ² and half log-determinant of every local model beside a given one (H,)."""
        models, (inner, right), gram = self.models, self._blocks, self._gram
        rows = np.zeros((inner.shape[1], models.base + 1))
        for weight, b in zip(models.weights[first], models.support[first], strict=True):
            if b < models.base:
                rows += weight[:, None] * gram[b]
        # products of the first one's mean and columns with those of every other one
        across = np.einsum("qhb,hbr->hqr", rows[:, models.support], models.weights)
        own, slope = inner[first], right[first, 1:] - inner[first, 1:, 0]
        precision = own[1:, 1:] + np.eye(len(own) - 1)
        covariance = np.linalg.inv(precision)
        found = covariance @ slope
        chi2 = self.products.nominal.chi2 - 2 * right[first, 0] + own[0, 0] - float(slope @ found)
        rest = inner - np.swapaxes(across[:, 1:], 1, 2) @ covariance @ across[:, 1:]
        target = right - across[:, 0] - np.einsum("q,hqr->hr", found, across[:, 1:])
        fit, half, _, _ = _solved(rest, target, chi2)
        return fit, half + float(np.linalg.slogdet(precision)[1]) / 2


def _solved(inner: Array, right: Array, total: float) -> tuple[Array, Array, Array, Array]:
    precision = inner[:, 1:, 1:] + np.eye(inner.shape[1] - 1)
    slope = right[:, 1:] - inner[:, 1:, 0]
    root = np.linalg.cholesky(precision)
    covariance = np.linalg.inv(precision)
    found = np.einsum("hij,hj->hi", covariance, slope)
    square = total - 2 * right[:, 0] + inner[:, 0, 0]
    half = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return square - np.sum(slope * found, axis=1), half, found, np.asarray(covariance)


@dataclass(frozen=True, eq=False)
class ScreenedSets:
    """Sets by their log posterior, up to a constant, from the signatures of the bank alone."""

    beside: Beside
    """Every local model beside the nominal model."""
    score: dict[tuple[int, ...], float]
    """Candidates of a set -> log posterior, all its local models together."""
    best: dict[tuple[int, ...], tuple[int, ...]]
    """Candidates of a set -> its best local models."""
    evidence: Array
    """Log evidence of each local model alone against none (H,)."""
    misfit: float
    """χ² of the best hypothesis over its degrees of freedom, at least 1."""

    def alone(self) -> tuple[Array, Array, Array]:
        """Each candidate alone (N,): log evidence, log10 of its visibility, and the latter's sd."""
        models = self.beside.models
        _, _, coefficients, covariances = self.beside.alone
        best = np.empty(len(models.names), dtype=np.intp)
        order = np.argsort(self.evidence, kind="stable")
        best[models.candidate[order]] = order  # the last one written has most evidence
        factor = np.maximum(1 + SIZE_SD * coefficients[best, 0], 0.05)
        seen = np.concatenate(models.bank.visibilities)[best]
        sd = SIZE_SD * np.sqrt(covariances[best, 0, 0] * self.misfit) / factor / np.log(10)
        return self.evidence[best], np.log10(np.maximum(seen * factor, 1e-3)), sd


def screened(products: Products, settings: BeliefSettings) -> ScreenedSets:
    """Screen sets of at most two effects about the nominal model.

    Singles are all evaluated. Pairs are those of any effect beside one of the best singles, then
    beside one of the second members of the best pairs.
    """
    models = products.models
    beside, candidate = Beside(products), models.candidate
    chi2, half, _, _ = beside.alone
    count, none = len(models.names), np.full(1, -1)
    every = np.arange(models.count)
    first, second = [none, every], [none, np.full(models.count, -1)]
    fits = [np.array([products.nominal.chi2]), chi2]
    others = [
        np.array([log_prior(0, count, settings)]),
        log_prior(1, count, settings) + models.log_prior - half,
    ]

    def pair_up(which: Sequence[int]) -> None:
        for h in which:
            fit, size = beside.with_first(h)
            first.append(np.full(models.count, h))
            second.append(every)
            fits.append(np.where(candidate == candidate[h], np.inf, fit))
            prior = log_prior(2, count, settings) + models.log_prior + models.log_prior[h]
            others.append(prior - size)

    if count > 1:
        tried = _leading(others[1] - chi2 / 2, candidate, _FIRST)
        pair_up(tried)
        score = np.concatenate(others[2:]) - np.concatenate(fits[2:]) / 2
        seconds = np.concatenate(second[2:])
        best = [int(h) for h in seconds[np.argsort(-score)[: 40 * _SWAPS]]]
        again = [h for h in dict.fromkeys(best) if h not in set(tried)][:_SWAPS]
        pair_up(again)
    a, b = np.concatenate(first), np.concatenate(second)
    fit = np.concatenate(fits)
    misfit = max(float(np.min(fit)) / max(products.dof, 1), 1.0)
    # the same pair may have been reached from either side
    low, high = np.minimum(a, b), np.maximum(a, b)
    _, unique = np.unique(high * (models.count + 1) + low, return_index=True)
    score = (np.concatenate(others) - fit / 2 / misfit)[unique]
    order = np.argsort(-score, kind="stable")[:_KEPT]
    sets: dict[tuple[int, ...], list[int]] = {}
    for k, (one, other) in enumerate(zip(a[unique[order]], b[unique[order]], strict=True)):
        members = sorted(int(candidate[h]) for h in (one, other) if h >= 0)
        sets.setdefault(tuple(members), []).append(k)
    scores = score[order]
    return ScreenedSets(
        beside,
        {members: float(np.logaddexp.reduce(scores[rows])) for members, rows in sets.items()},
        {
            members: tuple(int(h[unique[order[rows[0]]]]) for h in (a, b)
                           if h[unique[order[rows[0]]]] >= 0)
            for members, rows in sets.items()
        },
        (products.nominal.chi2 - chi2) / 2 / misfit - half,
        misfit,
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


def linear_estimates(
    products: Products, own: Sequence[int], eta: float, misfit: float
) -> tuple[EffectEstimate, ...]:
    """Estimates of the effects of some local models by the bank's signatures alone."""
    models, found = products.models, products.fit(own)
    at, estimates = models.bank.nuisances, []
    for h in own:
        ray, size = models.bank.rays[models.ray[h]], float(models.size[h])
        sd = float(np.sqrt(found.covariance[at, at] * misfit))
        middle = size * max(1 + SIZE_SD * float(found.parameters[at]), 0.02)
        spread = 1.96 * size * float(np.hypot(SIZE_SD * sd, eta))
        shape = found.parameters[at + 2 : at + 2 + len(ray.shape_parameters)]
        sizes = [max(s, 1e-6) for s in (middle, middle - spread, middle + spread)]
        estimates.append(EffectEstimate.of(ray, sizes, shape))
        at += models.weights.shape[2] - 1
    return tuple(sorted(estimates, key=lambda e: e.name))
