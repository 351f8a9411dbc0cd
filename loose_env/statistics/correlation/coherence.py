"""Coherence of the tool's motion with several excited joints at once."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from loose_env.errors import InvalidData
from loose_env.statistics.directions.angles import axial_vector
from loose_env.statistics.records.covariance import (
    Covariances,
    covariances,
    excitation_factor,
    whitener,
)
from loose_env.typing import Array


class LowestCoherence(NamedTuple):
    """Direction of lowest coherence with the excited joints."""

    direction: Array
    """Unit vector in the tool frame, shape (d,); the last non-zero component is positive."""
    coherence: float
    """Share rho^2 of the variance along it that the excited joints explain, 0 to 1."""
    coherences: Array
    """All generalised eigenvalues rho^2, rising, shape (d,)."""


class RankTest(NamedTuple):
    """Test for a direction uncorrelated with every excited joint."""

    statistic: float
    """Chi-square."""
    degrees: int
    """Degrees of freedom."""
    p_value: float
    """Chance of a statistic this large when such a direction exists."""


def lowest_coherence_direction(x: ArrayLike, a: ArrayLike) -> LowestCoherence:
    """Find the direction of lowest coherence with all excited joints together.

    The smallest generalised eigenvector of (C Sx^-1 C.T) u = rho^2 S u, with C = cov(a, x),
    Sx = cov(x) and S = cov(a). With one excited joint in the plane this is the direction of
    lowest correlation, with rho^2 = 0. When x has fewer rows than a, the lowest rho^2 is zero
    by construction, and with two fewer the direction is one of many.

    Parameters
    ----------
    x : array, shape (m, N)
        Accelerations of the excited joints, rad/s^2.
    a : array, shape (d, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    LowestCoherence
        Direction, its rho^2, and every rho^2. Zero along a direction in which the tool does not
        move.

    Raises
    ------
    InvalidData
        If the record cannot be used or the rows of x depend on each other.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [2.0, 0.0, -2.0, 0.0]]
    >>> lowest = lowest_coherence_direction(x, a)
    >>> lowest.direction.round(6).tolist(), round(lowest.coherence, 6)
    ([0.0, 1.0], 0.5)
    """
    return lowest_coherence_direction_from(covariances(x, a))


def lowest_coherence_direction_from(cov: Covariances) -> LowestCoherence:
    """`lowest_coherence_direction` on covariances.

    Of several records, each of the three results has their axes in front.
    """
    w = whitener(cov.aa)
    whitened = np.linalg.solve(excitation_factor(cov.xx), cov.xa @ w).mT
    # Singular values of the whitened covariance are the canonical correlations rho. They come
    # falling, and the left vectors beyond them (m < d) follow no joint.
    vectors, rho, _ = np.linalg.svd(whitened)
    coherences = np.zeros(cov.aa.shape[:-1])
    coherences[..., : rho.shape[-1]] = np.minimum(rho, 1.0) ** 2
    lowest: Any = coherences[..., -1]
    return LowestCoherence(
        axial_vector((w @ vectors[..., -1:])[..., 0]),
        float(lowest) if cov.aa.ndim == 2 else lowest,
        coherences[..., ::-1],
    )


def rank_test(x: ArrayLike, a: ArrayLike, count: float | None = None) -> RankTest:
    """Test whether some tool direction is uncorrelated with all excited joints.

    If it does, -[N - 1 - (d + m + 1)/2] ln(1 - rho_d^2) is chi-square with m - d + 1 degrees of
    freedom. A small p-value says that every direction follows. A missing direction is no proof
    of a fault: compliance makes one too.

    Parameters
    ----------
    x : array, shape (m, N)
        Accelerations of the excited joints, rad/s^2; m >= d.
    a : array, shape (d, N)
        Tool acceleration in the tool frame, m/s^2.
    count : float, optional
        Number of independent samples, by default N. A record that fills only part of the band
        below half the sampling rate has fewer: see `effective_samples`.

    Returns
    -------
    RankTest
        Statistic, degrees of freedom, p-value.

    Raises
    ------
    InvalidData
        If the record cannot be used, x has fewer rows than a, or there are too few samples.

    References
    ----------
    Bartlett, The statistical significance of canonical correlations, Biometrika 32 (1941).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, slide = rng.standard_normal((2, 400)), rng.standard_normal(400)
    >>> bool(rank_test(x, [x[0], slide]).p_value > 0.05)
    True
    >>> bool(rank_test(x, [x[0], slide + x[1]]).p_value < 1e-6)
    True
    """
    return rank_test_from(covariances(x, a), count)


def rank_test_from(cov: Covariances, count: float | None = None) -> RankTest:
    """`rank_test` on covariances."""
    m, d = cov.xa.shape
    if m < d:
        raise InvalidData(f"x has {m} rows and a has {d}; the test needs as many excited joints")
    factor = (cov.count if count is None else count) - 1 - (d + m + 1) / 2
    if not (math.isfinite(factor) and factor > 0.0):
        raise InvalidData(
            f"count is {cov.count if count is None else count}; the test needs more than "
            f"{1 + (d + m + 1) / 2} independent samples"
        )
    lowest = lowest_coherence_direction_from(cov).coherence
    statistic = math.inf if lowest >= 1.0 else -factor * math.log1p(-lowest)
    degrees = m - d + 1
    return RankTest(statistic, degrees, float(chdtrc(degrees, statistic)))
