"""Expected information of each motion [nats], its value in reward, and pairwise gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from loose_env.gap.experiment_design.inference.belief import Belief
from loose_env.gap.experiment_design.inference.expansion import linear_fit, nominal
from loose_env.inference import information_bound, squared_distances
from loose_env.typing import Array

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

        I ≥ − Σ_i p_i ln Σ_j p_j exp(−B_ij),    B_ij = (1/8) Δᵀ S⁻¹ Δ

    Δ is the difference of two predictions at the fitted parameters and S their mean covariance: the
    noise, the linearisation error, and what the parameters are still uncertain by.

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
        products = _products(belief, weights, predictions, motion)
        information.append(information_bound(weights, squared_distances(products)))
        gain.append(value_of_information(weights, products, rewards))
    return Outlook(np.array(information), np.array(gain))


def pair_gains(belief: Belief, motion: int) -> Array:
    """Expected difference of log evidence between open sets on a motion [nats] (sets, sets)."""
    weights, _, predictions = _predictions(belief)
    products = _products(belief, weights, predictions, motion)
    return 0.5 * squared_distances(products)


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
    data, found = belief.data, []
    about = nominal(belief.models, data)
    for each in sets:
        fit = linear_fit(belief.models, data, each.models, about, belief.settings.linearisation)
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


def _products(
    belief: Belief, weights: Array, predictions: Sequence[Prediction], motion: int
) -> Array:
    """Inner products of the predictions on a motion over their covariance (sets, sets)."""
    p = belief.bank.nuisances
    vectors = belief.bank.signatures[motion].vectors
    nominal, beyond = vectors[:, :p], vectors[:, p:]
    count, eta = len(vectors), belief.settings.linearisation
    spread, expected = np.eye(count), []
    for weight, (found, covariance, own) in zip(weights, predictions, strict=True):
        signature = beyond @ own.astype(np.float32)
        rows = np.concatenate([nominal, signature[:, 1:]], axis=1).astype(float)
        mean = rows @ found + signature[:, 0]
        expected.append(mean)
        spread += weight * (rows @ covariance @ rows.T)
        spread[np.diag_indices(count)] += weight * eta**2 * float(mean @ mean) / count
    root = np.linalg.cholesky(spread)
    white = np.linalg.solve(root, np.array(expected).T).T
    return np.asarray(white @ white.T)
