"""Expected information of motions between the hypotheses that are still open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.gap.experiment_design.belief import Belief
from loose_env.gap.experiment_design.posterior import NormalEquations
from loose_env.typing import Array

__all__ = ["expected_information", "pair_gains"]

_OPEN = 16
"""Sets of effects that count as open at most."""


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


def pair_gains(belief: Belief, motion: int, *, most: int = _OPEN) -> Array:
    """Expected difference of log evidence between open sets on a motion [nats] (sets, sets)."""
    weights, predictions = _predictions(belief, most)
    return 0.5 * _distances(belief, weights, predictions, motion)


def _bound(weights: Array, distances: Array) -> float:
    mixed = np.exp(-distances / 8) @ weights
    return float(max(-np.sum(weights * np.log(np.maximum(mixed, 1e-300))), 0.0))


Prediction = tuple[Array, Array, Array, tuple[int, ...]]
"""Nuisances and coefficients (D,), their covariance (D, D), columns (D - P,) and mean columns."""


def _predictions(belief: Belief, most: int) -> tuple[Array, list[Prediction]]:
    """Probabilities of the open sets and their fitted parameters."""
    sets = belief.posterior.sets[:most]
    weights = np.array([each.probability for each in sets])
    equations = belief.normal_equations()
    found = [_fitted(belief, equations, each.models) for each in sets]
    return weights / weights.sum(), found


def _fitted(belief: Belief, equations: NormalEquations, own: tuple[int, ...]) -> Prediction:
    models = belief.models
    p = belief.bank.nuisances
    columns = (
        np.concatenate([models.columns[h] for h in own]).astype(int) if own else np.empty(0, int)
    )
    weights = models.combinations[:, columns].toarray()
    mean = np.zeros(weights.shape[0])
    means = tuple(int(models.means[h]) for h in own)
    for column in means:
        mean += models.combinations[:, column].toarray()[:, 0]
    gram, right = equations.gram, equations.right
    across = gram[:p, p:] @ weights
    inside = weights.T @ gram[p:, p:] @ weights
    curvature = np.block([[gram[:p, :p], across], [across.T, inside]])
    curvature += np.eye(len(curvature))
    slope = np.concatenate(
        [right[:p] - gram[:p, p:] @ mean, weights.T @ (right[p:] - gram[p:, p:] @ mean)]
    )
    covariance = np.linalg.inv(curvature)
    return covariance @ slope, covariance, columns, means


def _distances(
    belief: Belief, weights: Array, predictions: Sequence[Prediction], motion: int
) -> Array:
    """Squared Mahalanobis distances between the predictions on a motion (sets, sets)."""
    p = belief.bank.nuisances
    nominal = belief.bank.signatures[motion].vectors[:, :p]
    columns = belief.models.by_motion[motion]
    count = nominal.shape[0]
    spread, expected = np.zeros((count, count)), []
    for weight, (found, covariance, own, means) in zip(weights, predictions, strict=True):
        rows = np.concatenate([nominal, columns[:, own]], axis=1)
        mean = rows @ found + columns[:, list(means)].sum(axis=1)
        expected.append(mean)
        spread += weight * (rows @ covariance @ rows.T)
        spread[np.diag_indices(count)] += weight * (1.0 + belief.error(mean))
    root = np.linalg.cholesky(spread)
    white = np.linalg.solve(root, np.array(expected).T).T
    squares = np.sum(white**2, axis=1)
    return np.asarray(np.maximum(squares[:, None] + squares - 2 * white @ white.T, 0.0))
