"""Belief: measured motions of one machine in, posterior over sets of effects and outlook out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from loose_env.gap.core.identifiability import unexplained
from loose_env.gap.experiment_design.bank import SignatureBank
from loose_env.gap.experiment_design.local_models import LocalModels, Products
from loose_env.gap.experiment_design.screening import (
    BeliefSettings,
    HypothesisSet,
    Posterior,
    ScreenedSets,
    linear_estimates,
    screened,
)
from loose_env.inference import information_bound
from loose_env.typing import Array


class Belief:
    """Belief about one machine, updated by measured motions.

    Parameters
    ----------
    models : LocalModels
        Local models of the bank.
    settings : BeliefSettings, optional
        Priors and errors.
    """

    def __init__(self, models: LocalModels, settings: BeliefSettings | None = None) -> None:
        self.models, self.settings = models, settings or BeliefSettings()
        self.bank: SignatureBank = models.bank
        self.sums: dict[int, Array] = {}
        """Motion -> sum of the projected residuals of its repetitions (K,)."""
        self.counts: dict[int, int] = {}
        """Motion -> repetitions."""
        self.rest: dict[int, float] = {}
        """Motion -> rms of the latest residual beyond the bank's directions [noise sd]."""
        self._posterior: Posterior | None = None

    def add(self, motion: int, readings: Array) -> None:
        """Add measured readings (n, C) of a motion of the library, by its index."""
        found = self.bank.signatures[motion]
        inside, rest = found.projected(readings, self.bank.arm.noise)
        self.sums[motion] = self.sums.get(motion, np.zeros(len(inside))) + inside
        self.counts[motion] = self.counts.get(motion, 0) + 1
        self.rest[motion] = rest
        self._posterior = None

    @property
    def products(self) -> Products:
        """Products of the motions so far."""
        data = {k: (summed / self.counts[k], self.counts[k]) for k, summed in self.sums.items()}
        return Products.of(self.models, data, self.settings.linearisation)

    @property
    def posterior(self) -> Posterior:
        """Posterior over sets of effects, given all motions so far."""
        if self._posterior is None:
            first = screened(self.products, self.settings)
            self._posterior = _posterior(self.products, first, self.settings.linearisation)
        return self._posterior


_KEPT, _ESTIMATED = 40, 8
"""Sets of a posterior, and those with estimates."""


def _posterior(products: Products, first: ScreenedSets, eta: float) -> Posterior:
    """Posterior over the sets that were compared."""
    models = products.models
    scores = np.array(list(first.score.values()))
    shares = np.exp(scores - np.logaddexp.reduce(scores))
    marginal = np.zeros(len(models.names))
    sets: list[HypothesisSet] = []
    members = list(first.score)
    for k in np.argsort(-shares, kind="stable"):
        marginal[list(members[k])] += shares[k]
        if len(sets) < _KEPT:
            own, known = first.best[members[k]], len(sets) < _ESTIMATED
            sets.append(
                HypothesisSet(
                    names=tuple(sorted(models.names[m] for m in members[k])),
                    probability=float(shares[k]),
                    effects=linear_estimates(products, own, eta, first.misfit) if known else (),
                    models=own,
                )
            )
    return Posterior(tuple(sets), models.names, marginal, *first.alone(), first.misfit)


_OPEN = 16
"""Sets of effects that count as open at most."""
_SAMPLES = 32
"""Readings that are drawn from the prediction of each open set."""
_LEAST = 1e-3
"""Probability of an open set over that of the most probable one, at least."""


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
    prediction, in the noise and the linearisation error.

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
    weights, names, predictions = _predictions(belief)
    rewards = np.array([[reward(named, truth) for truth in names] for named in names])
    information, gain = [], []
    for motion in range(len(belief.bank.library)):
        squared = _distances(belief, weights, predictions, motion)
        centred = np.eye(len(weights)) - weights
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


Prediction = tuple[Array, Array, Array]
"""Nominal parameters and coefficients (D,), their covariance (D, D), and the weights of the base
vectors in mean and columns (S, 1 + D - P)."""


def _predictions(
    belief: Belief,
) -> tuple[Array, list[tuple[str, ...]], list[Prediction]]:
    """Probabilities of the open sets, their effects and their fitted parameters."""
    if not belief.counts:
        return _prior_predictions(belief)
    best = belief.posterior.best.probability
    sets = [s for s in belief.posterior.sets[:_OPEN] if s.probability > _LEAST * best]
    weights = np.array([each.probability for each in sets])
    products, found = belief.products, []
    for each in sets:
        fit = products.fit(each.models)
        found.append((fit.parameters, fit.covariance, belief.models.columns(each.models)))
    return weights / weights.sum(), [each.names for each in sets], found


def _prior_predictions(
    belief: Belief,
) -> tuple[Array, list[tuple[str, ...]], list[Prediction]]:
    """Before any motion: no effect, and each candidate about the middle of its sizes."""
    models, settings = belief.models, belief.settings
    p = belief.bank.nuisances
    own: list[tuple[int, ...]] = [()]
    for candidate in range(len(models.names)):
        those = np.flatnonzero(models.candidate == candidate)
        own.append((int(those[len(those) // 2]),))
    weights = np.full(len(own), settings.single / max(len(own) - 1, 1))
    weights[0] = settings.none
    found: list[Prediction] = []
    for each in own:
        columns = models.columns(each)
        count = p + columns.shape[1] - 1
        found.append((np.zeros(count), np.eye(count), columns))
    names = [tuple(models.names[models.candidate[h]] for h in each) for each in own]
    return weights / weights.sum(), names, found


def _distances(
    belief: Belief, weights: Array, predictions: Sequence[Prediction], motion: int
) -> Array:
    """Squared distances that a motion adds between the predictions of the sets (sets, sets)."""
    p, eta = belief.bank.nuisances, belief.settings.linearisation
    vectors, rows, means = belief.models.products(motion)[0], [], []
    for parameters, _, weight in predictions:
        signature = vectors[:, p:] @ weight
        rows.append(np.concatenate([vectors[:, :p], signature[:, 1:]], axis=1))
        means.append(rows[-1] @ parameters + signature[:, 0])
    mean = np.array(means)
    noise = 1.0 + eta**2 * float(weights @ np.sum(mean**2, axis=1)) / mean.shape[1]
    found = np.empty((len(mean), len(mean)))
    for k, (own, (_, covariance, _)) in enumerate(zip(rows, predictions, strict=True)):
        off, columns = (mean - mean[k]).T / np.sqrt(noise), own / np.sqrt(noise)
        so_far = np.asarray(np.linalg.inv(covariance), float)
        found[:, k] = unexplained(
            np.sum(off**2, axis=0), columns.T @ off, columns.T @ columns, so_far
        )
    return np.maximum(found + found.T, 0.0) / 2
