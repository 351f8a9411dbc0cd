"""Expected information of motions between the hypotheses that are still open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.gap.experiment_design.inference.belief import Belief
from loose_env.gap.experiment_design.inference.expansion import linear_fit, nominal
from loose_env.typing import Array

__all__ = ["expected_information", "pair_gains"]

_OPEN = 16
"""Sets of effects that count as open at most."""
_LEAST = 1e-3
"""Probability of an open set over that of the most probable one, at least."""


def expected_information(
    belief: Belief, motions: Sequence[int] | None = None, *, most: int = _OPEN
) -> Array:
    """Expected information of each motion about which set of effects is missing [nats].

    A lower bound of the mutual information between set and readings, from the Bhattacharyya
    distances between the predictions of the sets (Kolchinsky and Tracey, Entropy 19, 2017, 361):

        I ≥ − Σ_i p_i ln Σ_j p_j exp(−B_ij),    B_ij = (1/8) Δᵀ S⁻¹ Δ

    Δ is the difference of two predictions at the fitted parameters and S their mean covariance: the
    noise, the linearisation error, and what the parameters are still uncertain by.

    Parameters
    ----------
    belief : Belief
        Belief about the machine.
    motions : sequence of int, optional
        Indices in the library; all by default.
    most : int
        Sets that are taken as open, by probability.

    Returns
    -------
    ndarray (motions,)
    """
    which = range(len(belief.bank.library)) if motions is None else motions
    weights, predictions = _predictions(belief, most)
    return np.array([_bound(weights, _distances(belief, weights, predictions, m)) for m in which])


def pair_gains(belief: Belief, motion: int) -> Array:
    """Expected difference of log evidence between open sets on a motion [nats] (sets, sets)."""
    weights, predictions = _predictions(belief, _OPEN)
    return 0.5 * _distances(belief, weights, predictions, motion)


def _bound(weights: Array, distances: Array) -> float:
    mixed = np.exp(-distances / 8) @ weights
    return float(max(-np.sum(weights * np.log(np.maximum(mixed, 1e-300))), 0.0))


Prediction = tuple[Array, Array, Array]
"""Nominal parameters and coefficients (D,), their covariance (D, D), and the weights of the base
vectors in mean and columns (S, 1 + D - P)."""


def _predictions(belief: Belief, most: int) -> tuple[Array, list[Prediction]]:
    """Probabilities of the open sets and their fitted parameters."""
    best = belief.posterior.best.probability
    sets = [s for s in belief.posterior.sets[:most] if s.probability > _LEAST * best]
    weights = np.array([each.probability for each in sets])
    data, found = belief.data, []
    about = nominal(belief.models, data)
    for each in sets:
        fit = linear_fit(belief.models, data, each.models, about, belief.settings.linearisation)
        found.append((fit.parameters, fit.covariance, belief.models.columns(each.models)))
    return weights / weights.sum(), found


def _distances(
    belief: Belief, weights: Array, predictions: Sequence[Prediction], motion: int
) -> Array:
    """Squared Mahalanobis distances between the predictions on a motion (sets, sets)."""
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
    squares = np.sum(white**2, axis=1)
    return np.asarray(np.maximum(squares[:, None] + squares - 2 * white @ white.T, 0.0))
