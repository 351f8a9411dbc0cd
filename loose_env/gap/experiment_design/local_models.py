"""Local linear models of every candidate, and the Gram matrix that measured motions make of them.

With the mean residual ȳ_k of motion k over n_k repetitions, in noise standard deviations and in the
K_k directions of the bank, a machine with effects e is

    ȳ_k = J_k z + Σ_e (m_e + C_e θ_e) + ε_k,      z, θ ~ N(0, I)
    ε_k ~ N(0, 1/n_k + δ_k),    δ_k = (η |ȳ_k|)² / K_k

z are the nominal parameters and θ the effects' sizes and shapes, each over its prior standard
deviation. Effects have local models: mean, and slope, curvature and shape columns. δ is the error
of the linearisation, in proportion to what it has to explain, which a repetition does not average
out. All sets of effects are then small linear problems in one Gram matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.experiment_design.bank import SignatureBank
from loose_env.typing import Array

SIZE_SD = 0.45
"""Standard deviation of a size about its linearisation point, over the point: neighbouring points
lie a factor of about three apart."""
_SHAPES = 2
"""Shape parameters of a ray at most."""


@dataclass(frozen=True, eq=False)
class LocalModels:
    """Local models as combinations of a bank's base vectors.

    A ray's signature about the size u_i is d_i + (u - u_i) d' + (1/2)(u - u_i)² d'', by the
    parabola through three points. Slope, curvature and shape derivatives are columns, each scaled
    by the standard deviation of its coefficient; that of the curvature stands for the error of the
    linearisation.
    """

    bank: SignatureBank
    _products: dict[int, tuple[Array, Array]] = field(default_factory=dict, repr=False)

    @cached_property
    def count(self) -> int:
        """Number of local models: points of all rays (H)."""
        return int(self.bank.starts[-1])

    @cached_property
    def ray(self) -> NDArray[np.intp]:
        """Index of the ray of each local model (H,)."""
        return np.repeat(np.arange(len(self.bank.rays)), np.diff(self.bank.starts))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Candidates, kind and location."""
        return self.bank.names

    @cached_property
    def candidate(self) -> NDArray[np.intp]:
        """Index of the candidate of each local model (H,)."""
        index = {name: k for k, name in enumerate(self.names)}
        return np.array([index[self.bank.rays[r].name] for r in self.ray], dtype=np.intp)

    @cached_property
    def log_prior(self) -> Array:
        """Log probability of a local model given its candidate: all rays and points alike (H,)."""
        counts = np.bincount(self.candidate, minlength=len(self.names))
        return np.asarray(-np.log(counts[self.candidate]))

    @cached_property
    def size(self) -> Array:
        """Size of each local model (H,)."""
        return np.concatenate(self.bank.sizes)

    @cached_property
    def support(self) -> NDArray[np.intp]:
        """Base vectors of each local model, those of its ray (H, B); `base` where there are fewer.

        They count from the first one beyond the nominal parameters.
        """
        bank, most = self.bank, max(map(len, self.bank.sizes)) + _SHAPES
        found = np.full((len(bank.rays), most), self.base)
        for r, shapes in enumerate(bank.shape_columns):
            own = [
                *range(bank.starts[r], bank.starts[r + 1]),
                *(k - bank.nuisances for k in shapes),
            ]
            found[r, : len(own)] = own
        return found[self.ray]

    @cached_property
    def base(self) -> int:
        """Number of base vectors beyond the nominal parameters (S)."""
        return int(self.bank.signatures[0].vectors.shape[1]) - self.bank.nuisances

    @cached_property
    def weights(self) -> Array:
        """Weights of the support in mean, slope, curvature and shapes (H, B, 2 + Q)."""
        bank = self.bank
        found = np.zeros((*self.support.shape, 3 + _SHAPES))
        for h, r in enumerate(self.ray):
            u, i = bank.sizes[r], h - int(bank.starts[r])
            slope, bend = parabola(u, float(u[i]))
            sd = SIZE_SD * u[i]
            found[h, i, 0] = 1.0
            found[h, : len(u), 1], found[h, : len(u), 2] = sd * slope, 0.5 * sd**2 * bend
            for which in range(len(bank.shape_columns[r])):
                found[h, len(u) + which, 3 + which] = u[i] / u[len(u) // 2]
        return found

    def columns(self, own: Sequence[int]) -> Array:
        """Weights of all base vectors in the means and columns of some local models.

        Returns
        -------
        ndarray (S, 1 + Q models)
            The sum of the means, then slope, curvature and shapes of each.
        """
        found = np.zeros((self.base + 1, 1))
        for h in own:
            each = np.zeros((self.base + 1, self.weights.shape[2]))
            np.add.at(each, self.support[h], self.weights[h])
            found[:, 0] += each[:, 0]
            found = np.concatenate([found, each[:, 1:]], axis=1)
        return found[:-1]

    def products(self, motion: int) -> tuple[Array, Array]:
        """Base vectors of a motion (K, V) and their inner products (V, V), in double precision.

        In single precision the large signatures hide what tells the small ones apart.
        """
        if motion not in self._products:
            vectors = self.bank.signatures[motion].vectors.astype(float)
            self._products[motion] = vectors, vectors.T @ vectors
        return self._products[motion]


def parabola(sizes: Array, at: float) -> tuple[Array, Array]:
    """Weights of the points in slope and second derivative at a size, by the nearest parabola.

    Through three of the points and no effect at size 0.

    Examples
    --------
    >>> slope, bend = parabola(np.array([1.0, 2.0]), 2.0)
    >>> float(slope @ [1.0, 4.0]), float(bend @ [1.0, 4.0])  # of u²
    (4.0, 2.0)
    """
    nodes = np.concatenate([[0.0], sizes])
    slope, bend = np.zeros(len(nodes)), np.zeros(len(nodes))
    if len(sizes) == 1:
        return np.array([1 / sizes[0]]), np.zeros(1)
    middle = int(np.argmin(np.abs(np.log(sizes / at)))) + 1
    middle = min(middle, len(nodes) - 2)
    a, b, c = nodes[middle - 1 : middle + 2]
    others = ((b, c), (a, c), (a, b))
    for k, x, (p, q) in zip(range(middle - 1, middle + 2), (a, b, c), others, strict=True):
        scale = (x - p) * (x - q)
        slope[k], bend[k] = (2 * at - p - q) / scale, 2 / scale
    return slope[1:], bend[1:]


Data = Mapping[int, tuple[Array, int]]
"""Motion -> mean of the projected residuals (K,) and number of repetitions."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares of some parameters."""

    parameters: Array
    """Posterior mean (D,)."""
    covariance: Array
    """Posterior covariance (D, D)."""
    chi2: float
    """Weighted square of what is left, with that of the parameters."""


@dataclass(frozen=True, eq=False)
class Products:
    """Products of all base vectors and residuals of the measured motions."""

    models: LocalModels
    gram: Array
    """Of the base vectors (V, V)."""
    right: Array
    """With the residuals (V,)."""
    power: float
    """Of the residuals."""
    dof: int
    """Numbers in all residuals."""

    @classmethod
    def of(cls, models: LocalModels, data: Data, eta: float) -> Products:
        """Sum them over the motions, each by its noise and linearisation error."""
        count = models.base + models.bank.nuisances
        gram, right, power, dof = np.zeros((count, count)), np.zeros(count), 0.0, 0
        for motion, (mean, repeated) in data.items():
            vectors, products = models.products(motion)
            square = float(mean @ mean)
            weight = 1 / (1 / repeated + eta**2 * square / max(len(mean), 1))
            gram += weight * products
            right += weight * (vectors.T @ mean)
            power += weight * square
            dof += len(mean)
        return cls(models, gram, right, power, dof)

    def fit(self, own: Sequence[int] = ()) -> Solution:
        """Nominal parameters, then slope, curvature and shapes of some local models."""
        p, weights = self.models.bank.nuisances, self.models.columns(own)
        mean, columns = weights[:, 0], weights[:, 1:]
        across = np.hstack([self.gram[:, :p], self.gram[:, p:] @ columns])
        precision = np.vstack([across[:p], columns.T @ across[p:]])
        left = self.right - self.gram[:, p:] @ mean
        slope = np.concatenate([left[:p], columns.T @ left[p:]])
        covariance = np.asarray(np.linalg.inv(precision + np.eye(len(precision))), dtype=float)
        found = covariance @ slope
        power = self.power - float(mean @ (self.right[p:] + left[p:]))
        return Solution(found, covariance, max(power - float(slope @ found), 0.0))

    @cached_property
    def nominal(self) -> Solution:
        """Fit of the nominal parameters alone."""
        return self.fit()

    @cached_property
    def beyond(self) -> tuple[Array, Array]:
        """Products of what nominal parameters cannot do (S, S), and with the residuals (S,)."""
        p, own = self.models.bank.nuisances, self.nominal
        across = self.gram[p:, :p]
        gram = self.gram[p:, p:] - across @ own.covariance @ across.T
        return gram, self.right[p:] - across @ own.parameters
