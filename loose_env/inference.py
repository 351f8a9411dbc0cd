"""Inference: whitening, bounded steps, information bounds, bootstrap intervals, calibration.

Pure functions of arrays that diagnosis, gap, instrument and evaluation share. The solver, the
bootstrap and the intervals are scipy's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.optimize import lsq_linear

from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = [
    "Interval",
    "Reliability",
    "block_counts",
    "bootstrap_mean",
    "bounded_step",
    "expected_calibration_error",
    "expected_log_score",
    "information_bound",
    "log_determinant",
    "log_score",
    "overlap",
    "percentiles",
    "reliability",
    "squared_distances",
    "whitener",
    "wilson",
]

RESAMPLES = 2000
"""Resamples of a bootstrap."""
_LEVEL = 0.95
_CHUNK = 1_000_000  # numbers resampled at a time
_ROOM = 1e-9  # least room between bounds that the solver needs
_RIDGE = 1e-9  # curvature added to each number, over its own: two may be one direction


def whitener(covariance: Array) -> Array:
    """Matrix that brings errors to independent standard deviations: W S W' = 1.

    Parameters
    ----------
    covariance : ndarray (..., d, d)
        Covariance S, positive definite.

    Returns
    -------
    ndarray (..., d, d)
        Inverse of the lower Cholesky factor.

    Examples
    --------
    >>> whitener(np.array([[4.0, 0.0], [0.0, 0.25]])).tolist()
    [[0.5, 0.0], [0.0, 2.0]]
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def log_determinant(precision: Array) -> float:
    """Log-determinant of a positive definite matrix, its units scaled away first.

    Half of it is what Laplace's approximation of a log evidence takes off the log-density at the
    maximum, up to a constant (MacKay, Information Theory, Inference and Learning Algorithms, 2003,
    27).

    Examples
    --------
    >>> round(log_determinant(np.diag([1e-200, 1e200])), 6)
    0.0
    """
    scale = np.sqrt(np.diag(precision))
    return float(np.linalg.slogdet(precision / np.outer(scale, scale))[1] + 2 * np.log(scale).sum())


def bounded_step(
    curvature: Array, slope: Array, low: Array, high: Array, *, damping: float = 0.0
) -> Array:
    """Gauss-Newton step within bounds: the minimum of a quadratic cost.

    Parameters
    ----------
    curvature : ndarray (P, P)
        Hessian of half the cost.
    slope : ndarray (P,)
        Gradient of half the cost.
    low, high : ndarray (P,)
        Bounds of the change.
    damping : float
        Levenberg's damping: added to the curvature of each number, over its own.

    Returns
    -------
    ndarray (P,)

    Examples
    --------
    >>> bounded_step(np.eye(2), np.array([-1.0, -3.0]), np.zeros(2), np.full(2, 2.0)).round(6)
    array([1., 2.])
    """
    scale = np.sqrt(np.diag(curvature) + 1e-12)
    scaled = curvature / np.outer(scale, scale) + (_RIDGE + damping) * np.eye(len(slope))
    root = np.linalg.cholesky(scaled)
    bounds = (low * scale - _ROOM, high * scale + _ROOM)
    target = -np.linalg.solve(root, slope / scale)
    # an active-set method: four times as fast as the default for some tens of numbers
    return np.asarray(lsq_linear(root.T, target, bounds=bounds, method="bvls").x) / scale


def squared_distances(products: Array) -> Array:
    """Squared distances of points (..., n, n) from their inner products (..., n, n)."""
    squares = np.diagonal(products, axis1=-2, axis2=-1)
    both = squares[..., :, None] + squares[..., None, :]
    both -= 2 * products
    return np.asarray(np.maximum(both, 0.0, out=both))


def overlap(squared: Array, variance: ArrayLike = 1.0) -> Array:
    """Bhattacharyya's coefficient of two Gaussians, a bound on how often they are confused.

    Parameters
    ----------
    squared : ndarray (...)
        Squared distance of their means.
    variance : array_like (...)
        Variance of both along it.

    Returns
    -------
    ndarray (...)
        exp(-d² / 8 s²), from 0 to 1.

    Examples
    --------
    >>> overlap(np.array([0.0, 16.0]), 2.0).round(4).tolist()
    [1.0, 0.3679]
    """
    return np.asarray(np.exp(squared / (-8 * np.asarray(variance))))


def information_bound(weights: Array, squared: Array) -> float:
    """Lower bound of the information of an outcome about which hypothesis is true [nat].

    From the distances between the predictions of the hypotheses, I >= -sum_i p_i ln sum_j p_j b_ij
    with Bhattacharyya's coefficients b (Kolchinsky and Tracey, Entropy 19, 2017, 361).

    Parameters
    ----------
    weights : ndarray (n,)
        Probability of each hypothesis.
    squared : ndarray (n, n)
        Squared distances of their predictions, in standard deviations.

    Examples
    --------
    >>> half = np.full(2, 0.5)
    >>> information_bound(half, np.zeros((2, 2)))
    0.0
    >>> round(information_bound(half, 1e3 * (1 - np.eye(2))), 4)
    0.6931
    """
    mixed = overlap(squared) @ weights
    return float(max(-np.sum(weights * np.log(np.maximum(mixed, 1e-300))), 0.0))


def expected_log_score(
    weights: Array, hypothesis: NDArray[np.intp], near: Array, *, count: int | None = None
) -> tuple[Any, Any]:
    """Expected log score and largest probability of a posterior over sampled cases.

    Parameters
    ----------
    weights : ndarray (..., M)
        Probability of each case beforehand.
    hypothesis : ndarray of int (..., M)
        Hypothesis of each case.
    near : ndarray (..., M, M) or (..., 1, M)
        Weights of the cases after the outcome of each case; one row if alike after all.
    count : int, optional
        Number of hypotheses; by default one more than the highest.

    Returns
    -------
    ndarray (...), ndarray (...)
        Expected log probability of the truth [nat], and expected largest probability.

    Examples
    --------
    >>> score, sure = expected_log_score(np.full(2, 0.5), np.array([0, 1]), np.eye(2))
    >>> round(float(score), 6), float(sure)
    (0.0, 1.0)
    """
    number = int(hypothesis.max()) + 1 if count is None else count
    after = near @ (hypothesis[..., None] == np.arange(number)).astype(float)
    after /= after.sum(-1, keepdims=True)
    own = np.broadcast_to(hypothesis, (*near.shape[:-2], hypothesis.shape[-1]))[..., None]
    every = np.broadcast_to(after, (*own.shape[:-1], number))
    kept = np.log(np.maximum(np.take_along_axis(every, own, -1)[..., 0], 1e-12))
    return (kept * weights).sum(-1), (every.max(-1) * weights).sum(-1)


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate and the ends of its confidence interval."""

    estimate: float
    """The estimate."""
    low: float
    """Lower end."""
    high: float
    """Upper end."""

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def percentiles(draws: Array, estimate: float, level: float = _LEVEL) -> Interval:
    """Percentile interval of an estimate from its bootstrap draws (R,)."""
    low, high = np.quantile(draws, (0.5 * (1 - level), 0.5 * (1 + level)))
    return Interval(estimate=estimate, low=float(low), high=float(high))


def bootstrap_mean(
    values: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """Mean of independent values and its 95 % percentile bootstrap interval.

    Parameters
    ----------
    values : array_like (N,)
        One value an episode.
    rng : numpy.random.Generator
        Draws the resamples.
    resamples : int
        Number of resamples.

    Raises
    ------
    InvalidData
        If there are no values, or one is not finite.

    References
    ----------
    Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.

    Examples
    --------
    >>> found = bootstrap_mean([0.0, 1.0] * 50, rng=np.random.default_rng(0))
    >>> found.estimate, bool(0.35 < found.low < 0.45), bool(0.55 < found.high < 0.65)
    (0.5, True, True)
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or len(x) == 0 or not np.isfinite(x).all():
        raise InvalidData(f"a mean needs one or more finite numbers, got shape {x.shape}")
    mean = float(x.mean())
    if np.ptp(x) == 0:
        return Interval(estimate=mean, low=mean, high=mean)
    found = stats.bootstrap(
        (x,),
        np.mean,
        n_resamples=resamples,
        batch=max(1, _CHUNK // len(x)),
        confidence_level=_LEVEL,
        method="percentile",
        rng=rng,
    ).confidence_interval
    return Interval(estimate=mean, low=float(found.low), high=float(found.high))


def block_counts(blocks: int, draws: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """How often each block of dependent samples is taken in each bootstrap draw (draws, blocks).

    Blocks preserve autocorrelation (Kunsch, Annals of Statistics 17, 1989).

    Examples
    --------
    >>> block_counts(5, 100, np.random.default_rng(0)).sum(axis=1).tolist() == [5] * 100
    True
    """
    return rng.multinomial(blocks, np.full(blocks, 1 / blocks), size=draws)


def wilson(right: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; 0 to 1 without episodes.

    Examples
    --------
    >>> low, high = wilson(16, 20)
    >>> round(low, 2), round(high, 2)
    (0.58, 0.92)
    """
    if of == 0:
        return 0.0, 1.0
    found = stats.binomtest(right, of).proportion_ci(_LEVEL, method="wilson")
    return float(found.low), float(found.high)


BINS = 15
"""Bins of equal width from 0 to 1, as in Guo et al. (2017)."""
SMALLEST = 1e-6
"""Probabilities of the truth below this count as this in the log score."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reliability:
    """Accuracy by confidence, in bins that are not empty."""

    confidence: NDArray[np.float64]
    """Mean confidence (bins,)."""
    right: NDArray[np.float64]
    """Share that was right (bins,)."""
    count: NDArray[Any]
    """Number of claims (bins,)."""


def reliability(confidence: ArrayLike, right: ArrayLike, *, bins: int = BINS) -> Reliability:
    """Sort claims by confidence and see how often each bin was right.

    Parameters
    ----------
    confidence : array_like (N,)
        Probability given to what was claimed, 0 to 1.
    right : array_like of bool (N,)
        True where the claim was right.
    bins : int
        Bins of equal width; a claim on an edge belongs to the bin below it.

    Raises
    ------
    InvalidData
        If the two differ in length or a confidence is no probability.
    """
    p, hit = np.asarray(confidence, dtype=float), np.asarray(right, dtype=float)
    if p.ndim != 1 or p.shape != hit.shape:
        raise InvalidData(
            f"every claim has a confidence and an outcome, got {p.shape} and {hit.shape}"
        )
    if not ((p >= 0) & (p <= 1 + 1e-9)).all():
        raise InvalidData("a confidence is a probability, from 0 to 1")
    index = np.clip(np.ceil(p * bins).astype(int) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    full = count > 0
    number = count[full]
    return Reliability(
        confidence=np.bincount(index, p, minlength=bins)[full] / number,
        right=np.bincount(index, hit, minlength=bins)[full] / number,
        count=number,
    )


def expected_calibration_error(
    confidence: ArrayLike, right: ArrayLike, *, bins: int = BINS
) -> float:
    """Mean distance between confidence and share of right claims, weighted by claims.

    From 0 to 1; NaN without claims. It is never quite 0 in a finite sample: with N claims a
    perfect posterior shows about sqrt(bins / N) / 3.

    Parameters
    ----------
    confidence, right, bins
        As in `reliability`.

    References
    ----------
    Naeini, Cooper and Hauskrecht, Obtaining Well Calibrated Probabilities Using Bayesian
    Binning (AAAI 2015); Guo et al., On Calibration of Modern Neural Networks (ICML 2017).

    Examples
    --------
    >>> round(expected_calibration_error([0.8] * 10, [True] * 6 + [False] * 4), 3)
    0.2
    """
    found = reliability(confidence, right, bins=bins)
    if len(found.count) == 0:
        return float("nan")
    distance = np.abs(found.confidence - found.right)
    return float(np.sum(distance * found.count) / np.sum(found.count))


def log_score(truth_probability: ArrayLike) -> float:
    """Mean natural logarithm of the probability given to the truth [nat]; 0 is the best.

    Probabilities below `SMALLEST` count as that. NaN without claims.

    Examples
    --------
    >>> round(log_score([1.0, 0.5]), 4)
    -0.3466
    """
    p = np.asarray(truth_probability, dtype=float)
    return float(np.mean(np.log(np.maximum(p, SMALLEST)))) if p.size else float("nan")
