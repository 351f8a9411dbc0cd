"""Gaussian mixture model, fitted by expectation maximisation.

Dempster, Laird and Rubin, Maximum likelihood from incomplete data via the EM algorithm, 1977;
Bishop, Pattern Recognition and Machine Learning, 2006, 9.2. The start follows Arthur and
Vassilvitskii, k-means++, 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics._checks import as_floats, require_finite
from loose_env.typing import Array

_LOG_2PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianMixture:
    """Weights, means and covariances of K Gaussians in D dimensions.

    Raises
    ------
    InvalidData
        If the shapes do not fit each other, the weights do not add up to one, or a covariance is
        not positive definite.

    Examples
    --------
    >>> mixture = GaussianMixture(
    ...     weights=np.array([1.0]), means=np.zeros((1, 2)), covariances=np.eye(2)[None]
    ... )
    >>> mixture.log_densities([[0.0, 0.0], [2.0, 0.0]]).round(4).tolist()
    [[-1.8379], [-3.8379]]
    """

    weights: Array
    """Share of each Gaussian; they add up to one (K,)."""
    means: Array
    """Means, unit of the points (K, D)."""
    covariances: Array
    """Covariances, unit of the points squared (K, D, D)."""

    def __post_init__(self) -> None:
        """Check shapes and values."""
        k, d = self.means.shape if self.means.ndim == 2 else (0, 0)
        if k < 1 or self.weights.shape != (k,) or self.covariances.shape != (k, d, d):
            raise InvalidData(
                f"a mixture needs weights (K,), means (K, D) and covariances (K, D, D); got "
                f"{self.weights.shape}, {self.means.shape} and {self.covariances.shape}"
            )
        for name in ("weights", "means", "covariances"):
            require_finite(getattr(self, name), name)
        if self.weights.min() < 0 or abs(float(self.weights.sum()) - 1.0) > 1e-4:
            raise InvalidData(f"weights are {self.weights}; they are shares that add up to one")
        _ = self._roots

    @cached_property
    def _roots(self) -> Array:
        """Lower Cholesky factors of the covariances (K, D, D)."""
        try:
            return np.asarray(np.linalg.cholesky(self.covariances))
        except np.linalg.LinAlgError as error:
            raise InvalidData(
                "a covariance of the mixture is not positive definite; fit it with more "
                "regularisation or fewer components"
            ) from error

    def log_densities(self, points: ArrayLike) -> Array:
        """Log of the weighted density of each component at points (N, D), (N, K)."""
        found = _points(points, self.means.shape[1])
        white = (found - self.means[:, None]) @ self._whiteners.mT
        half = np.log(np.diagonal(self._roots, axis1=1, axis2=2)).sum(1)
        logs = (-0.5 * (white**2).sum(2) - half[:, None]).T - 0.5 * found.shape[1] * _LOG_2PI
        with np.errstate(divide="ignore"):
            return np.asarray(logs + np.log(self.weights))

    @cached_property
    def _whiteners(self) -> Array:
        return np.asarray(np.linalg.inv(self._roots))

    @cached_property
    def _conditional(self) -> tuple[GaussianMixture, Array, Array]:
        """All but the first dimension; its slopes over them (K, D - 1), and deviations (K,)."""
        others = self.covariances[:, 1:, 1:]
        beside = GaussianMixture(weights=self.weights, means=self.means[:, 1:], covariances=others)
        shared = self.covariances[:, 1:, 0]
        slopes = np.linalg.solve(others, shared[..., None])[..., 0]
        variances = self.covariances[:, 0, 0] - (shared * slopes).sum(1)
        return beside, np.asarray(slopes), np.asarray(np.sqrt(variances))

    def log_upper_tail(self, points: ArrayLike) -> Array:
        """Log upper-tail probability of the first dimension of points (N, D), given the others.

        Given the others, each Gaussian is one in the first dimension, and its weight goes with
        the density of the others (Bishop 2006, 2.3.1).

        Examples
        --------
        >>> mixture = GaussianMixture(
        ...     weights=np.ones(1), means=np.zeros((1, 2)), covariances=np.eye(2)[None]
        ... )
        >>> np.exp(mixture.log_upper_tail([[0.0, 3.0], [1.645, 3.0]])).round(3).tolist()
        [0.5, 0.05]
        """
        found = _points(points, self.means.shape[1])
        beside, slopes, deviations = self._conditional
        others = beside.log_densities(found[:, 1:])
        share = others - np.logaddexp.reduce(others, axis=1, keepdims=True)
        ahead = ((found[:, None, 1:] - beside.means) * slopes).sum(2)
        from scipy.special import log_ndtr

        tails = log_ndtr((self.means[:, 0] + ahead - found[:, :1]) / deviations)
        return np.asarray(np.logaddexp.reduce(share + tails, axis=1))


def fit_gaussian_mixture(
    points: ArrayLike,
    components: int,
    rng: np.random.Generator,
    *,
    regularisation: float = 1e-3,
    steps: int = 100,
    tolerance: float = 1e-4,
) -> GaussianMixture:
    """Fit a mixture with full covariances by expectation maximisation.

    Parameters
    ----------
    points : array, shape (N, D)
        Points, more than dimensions.
    components : int
        Number of Gaussians, K.
    rng : numpy Generator
        Draws the points that the Gaussians start at.
    regularisation : float
        Added to every covariance's diagonal, as a share of the variance of the points along that
        dimension; a dimension that is constant counts as having variance one.
    steps : int
        Steps at most.
    tolerance : float
        Stops where a step gains less mean log density [nat].

    Returns
    -------
    GaussianMixture
        The fit. A Gaussian that loses all points is kept with weight close to zero.

    Raises
    ------
    InvalidData
        If the points have a wrong shape, are too few or not finite.
    InvalidSetting
        If a setting lies outside its range.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> points = np.concatenate([rng.normal(-5, 1, (300, 1)), rng.normal(5, 2, (100, 1))])
    >>> fit = fit_gaussian_mixture(points, 2, rng)
    >>> sorted(fit.weights.round(2).tolist())
    [0.25, 0.75]
    """
    found = _points(points, None)
    n, d = found.shape
    if components < 1 or regularisation <= 0 or steps < 1:
        raise InvalidSetting(
            f"components {components}, regularisation {regularisation} and steps {steps} must all "
            "be above zero"
        )
    if n <= max(d, components):
        raise InvalidData(
            f"{n} points in {d} dimensions are too few for {components} Gaussians; take more "
            "points or fewer dimensions"
        )
    variance = found.var(axis=0)
    variance[variance < 1e-12] = 1.0
    ridge = np.diag(regularisation * variance)
    scaled = found / np.sqrt(variance)
    share = np.eye(components)[_nearest(scaled, _spread(scaled, components, rng))]
    mixture, before = _from_shares(found, share, ridge), -math.inf
    for _ in range(steps):
        logs = mixture.log_densities(found)
        from scipy.special import logsumexp

        total = logsumexp(logs, axis=1)
        gain, before = float(total.mean()) - before, float(total.mean())
        if gain < tolerance:
            break
        mixture = _from_shares(found, np.exp(logs - total[:, None]), ridge)
    return mixture


def _from_shares(points: Array, share: Array, ridge: Array) -> GaussianMixture:
    """M-step: Gaussians from responsibilities (N, K)."""
    d = points.shape[1]
    number = share.sum(axis=0) + 1e-9
    means = share.T @ points / number[:, None]
    covariances = np.empty((share.shape[1], d, d))
    for k, mean in enumerate(means):
        away = points - mean
        covariances[k] = (share[:, k, None] * away).T @ away / number[k] + ridge
    return GaussianMixture(weights=number / number.sum(), means=means, covariances=covariances)


def _spread(points: Array, count: int, rng: np.random.Generator) -> Array:
    """Initial centres by k-means++ seeding."""
    chosen = [points[rng.integers(len(points))]]
    for _ in range(count - 1):
        away = np.min([((points - one) ** 2).sum(1) for one in chosen], axis=0)
        total = float(away.sum())
        share = None if total <= 0 else away / total  # all points alike: any will do
        chosen.append(points[rng.choice(len(points), p=share)])
    return np.array(chosen)


def _nearest(points: Array, centres: Array) -> NDArray[np.intp]:
    """Index of the nearest centre of each point (N,)."""
    away = np.stack([((points - one) ** 2).sum(1) for one in centres], axis=1)
    return np.asarray(np.argmin(away, axis=1))


def _points(points: ArrayLike, dimensions: int | None) -> Array:
    found = as_floats(points, "points")
    if found.ndim != 2 or (dimensions is not None and found.shape[1] != dimensions):
        wanted = "D" if dimensions is None else str(dimensions)
        raise InvalidData(f"points has shape {found.shape}; it must be (N, {wanted})")
    require_finite(found, "points")
    return found
