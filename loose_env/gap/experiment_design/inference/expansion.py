"""First-order expansions of a hypothesis's readings, and linear least squares of its parameters.

With the mean residual ȳ_k of motion k over n_k repetitions, in noise standard deviations and in the
K_k directions of the bank, a hypothesis whose readings are known to be y_k at parameters z_k is

    ȳ_k = y_k + J_k (z - z_k) + Σ_e (m_e + C_e θ_e) + ε_k,      z, θ ~ N(0, I)
    ε_k ~ N(0, 1/n_k + δ_k),    δ_k = (η |ȳ_k - y_k|)² / K_k

z are its nominal parameters and its effects' sizes and shapes, each over its prior standard
deviation. Effects e beside it have local models: mean, and slope, curvature and shape columns. δ is
the error of the expansion, in proportion to what it has to explain, which a repetition does not
average out: next to none where a simulation already reproduces the readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.inference import log_determinant
from loose_env.typing import Array

Data = Mapping[int, tuple[Array, int]]
"""Motion -> mean of the projected residuals (K,) and number of repetitions."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """Expansion of the readings of one motion."""

    readings: Array
    """Readings at the parameters, less the nominal ones, in the bank's directions (K,)."""
    at: Array
    """The parameters (D,)."""
    jacobian: Array
    """Derivatives there (K, D)."""
    stated: float | None = None
    """Variance of its error in each direction; by default that of the residual about it."""

    def error(self, mean: Array, eta: float) -> float:
        """Variance of the error of the expansion in each direction, for measured means (K,)."""
        if self.stated is not None:
            return self.stated
        off = mean - self.readings
        return eta**2 * float(off @ off) / max(len(off), 1)


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares of a hypothesis's own parameters."""

    parameters: Array
    """Posterior mean (D,)."""
    covariance: Array
    """Posterior covariance (D, D)."""
    chi2: float
    """Weighted square of what is left, with that of the parameters."""
    occam: float
    """Half the log-determinant of the precision."""
    grown: float
    """Log of the growth of the noise by the error of the expansions: with half of χ² and `occam`
    the negative log evidence."""
    dof: int
    """Numbers in all residuals."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Products of base vectors and residuals about a hypothesis, its own parameters eliminated."""

    gram: Array
    """(S, S)."""
    right: Array
    """(S,)."""
    own: Solution
    """Of the hypothesis alone."""


def nominal(models: LocalModels, data: Data) -> dict[int, Expansion]:
    """Expansions of the nominal model by its parameters: those of the bank."""
    count = models.bank.nuisances
    return {
        k: Expansion(np.zeros(len(mean)), np.zeros(count), models.products(k)[0][:, :count])
        for k, (mean, _) in data.items()
    }


def solve(data: Data, about: Mapping[int, Expansion], eta: float, count: int) -> Solution:
    """Least squares of the own parameters (count,) of a hypothesis."""
    precision, right, total, noise, dof = np.eye(count), np.zeros(count), 0.0, 0.0, 0
    for k, (mean, repeated) in data.items():
        weight, grown, target = _weighted(mean, repeated, about[k], eta)
        jacobian = about[k].jacobian
        precision += weight * (jacobian.T @ jacobian)
        right += weight * (jacobian.T @ target)
        total += weight * float(target @ target)
        noise += grown
        dof += len(mean)
    return _solution(precision, right, total, noise, dof)


def linear_fit(
    models: LocalModels,
    data: Data,
    beside: Sequence[int],
    about: Mapping[int, Expansion],
    eta: float,
) -> Solution:
    """Least squares of local models beside a hypothesis.

    The parameters are the hypothesis's own, then slope, curvature and shapes of each local model.
    """
    p, weights, extended = models.bank.nuisances, models.columns(beside), {}
    own = len(next(iter(about.values())).at) if about else p
    for k, (mean, _) in data.items():
        signature = models.products(k)[0][:, p:] @ weights
        at = np.concatenate([about[k].at, np.zeros(weights.shape[1] - 1)])
        jacobian = np.concatenate([about[k].jacobian, signature[:, 1:]], axis=1)
        error = about[k].error(mean, eta)
        extended[k] = Expansion(about[k].readings + signature[:, 0], at, jacobian, error)
    return solve(data, extended, eta, own + weights.shape[1] - 1)


def equations(
    models: LocalModels, data: Data, about: Mapping[int, Expansion], eta: float, count: int
) -> Equations:
    """Products for the effects beside a hypothesis with some own parameters (count,)."""
    size, p = models.base, models.bank.nuisances
    gram, across, right = np.zeros((size, size)), np.zeros((size, count)), np.zeros(size)
    for k, (mean, repeated) in data.items():
        vectors, products = models.products(k)
        weight, _, target = _weighted(mean, repeated, about[k], eta)
        gram += weight * products[p:, p:]
        across += weight * (vectors[:, p:].T @ about[k].jacobian)
        right += weight * (vectors[:, p:].T @ target)
    own = solve(data, about, eta, count)
    solved = across @ own.covariance
    return Equations(gram - solved @ across.T, right - across @ own.parameters, own)


def _weighted(
    mean: Array, repeated: int, about: Expansion, eta: float
) -> tuple[float, float, Array]:
    """Weight of a motion, log of its noise's growth, and what its own parameters must explain."""
    error = about.error(mean, eta)
    grown = 0.5 * len(mean) * float(np.log1p(repeated * error))
    return 1 / (1 / repeated + error), grown, mean - about.readings + about.jacobian @ about.at


def _solution(precision: Array, right: Array, total: float, noise: float, dof: int) -> Solution:
    covariance: Array = np.asarray(np.linalg.inv(precision), dtype=float)
    found = covariance @ right
    occam, chi2 = 0.5 * log_determinant(precision), total - float(right @ found)
    return Solution(found, covariance, max(chi2, 0.0), occam, noise, dof)
