"""Coherence of the tool's motion with several excited joints at once."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
