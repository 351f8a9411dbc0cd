"""Directions uncorrelated with the excitation, in closed form.

With c_i = cov(x_i, a), a direction u of the tool frame is uncorrelated with joint i if u . c_i is
zero. One excited joint leaves a whole plane of such directions, two leave one axis, and from three
on the least coherent direction takes their place (`lowest_coherence_direction`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics.correlation.coherence import LowestCoherence
from loose_env.statistics.directions.angles import axial_vector
from loose_env.statistics.records.covariance import (
    Covariances,
    covariances,
    excitation_factor,
    single_excitation,
    whitener,
)
from loose_env.typing import Array


def uncorrelated_plane(x: ArrayLike, a: ArrayLike) -> Array:
    """Find the plane of directions that are uncorrelated with one excited joint.

    Healthy or loose, there is such a plane; its normal is along c = cov(x, a).

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (3, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    array, shape (3,)
        Unit normal of the plane; its last non-zero component is positive.

    Raises
    ------
    InvalidData
        If the record cannot be used, more than one joint is given, or nothing correlates.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> uncorrelated_plane(x, [[2.0, -2.0, 2.0, -2.0], [1.0, 1.0, -1.0, -1.0], x]).round(3).tolist()
    [0.894, 0.0, 0.447]
    """
    c = single_excitation(_in_space(covariances(x, a)))
    if not c.any():
        raise InvalidData("x is uncorrelated with a in every direction: there is no plane")
    return axial_vector(c)


def uncorrelated_axis(x: ArrayLike, a: ArrayLike) -> Array:
    """Find the axis uncorrelated with two excited joints: their cross product.

    Parameters
    ----------
    x : array, shape (2, N)
        Accelerations of the excited joints, rad/s^2.
    a : array, shape (3, N)
        Tool acceleration in the tool frame, m/s^2.

    Returns
    -------
    array, shape (3,)
        Unit vector along c_1 x c_2; its last non-zero component is positive.

    Raises
    ------
    InvalidData
        If the record cannot be used, there are not two joints, or both move the tool alike, so
        that a whole plane is left.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> uncorrelated_axis(x, [x[0], x[1], [0.1, 0.0, 0.0, 0.1]]).round(3).tolist()
    [0.0, 0.0, 1.0]
    """
    cov = _in_space(covariances(x, a))
    if len(cov.xa) != 2:
        raise InvalidData(
            f"x has {len(cov.xa)} rows; two excited joints are needed here: with one use "
            "uncorrelated_plane, with more lowest_coherence_direction"
        )
    first, second = cov.xa
    normal = np.cross(first, second)
    sizes = float(np.linalg.norm(first) * np.linalg.norm(second))
    if float(np.linalg.norm(normal)) <= 1e-9 * sizes:
        raise InvalidData("both joints move the tool along one line: a whole plane is uncorrelated")
    return axial_vector(normal)


def lowest_coherence_of_records(records: Sequence[Covariances]) -> LowestCoherence:
    """Find the direction of lowest coherence over several records of one pose.

    As `lowest_coherence_direction`, with the variance that the joints explain, C Sx^-1 C.T, and
    the whole variance S each averaged over the records, which count alike: each record's tool
    motion is scaled to one.

    Parameters
    ----------
    records : sequence of Covariances
        Of each record; joints may differ, the tool axes may not.

    Returns
    -------
    LowestCoherence
        Direction, its coherence, and all coherences.

    Raises
    ------
    InvalidData
        If there is no record, or their tools have different numbers of axes.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> noise = [0.5, 0.5, -0.5, -0.5]
    >>> first, second = covariances(x, [x, noise, noise]), covariances(x, [noise, noise, x])
    >>> np.abs(lowest_coherence_of_records([first, second]).direction).round(2).tolist()
    [0.0, 1.0, 0.0]
    """
    if not records or len({len(cov.aa) for cov in records}) != 1:
        raise InvalidData(
            "one record or more is needed, all with the same tool axes; got "
            f"{[len(cov.aa) for cov in records]} axes"
        )
    explained = np.zeros_like(records[0].aa)
    total = np.zeros_like(explained)
    for cov in records:
        half = np.linalg.solve(excitation_factor(cov.xx), cov.xa)
        power = float(np.trace(cov.aa))
        explained += half.T @ half / power
        total += cov.aa / power
    w = whitener(total)
    rho, vectors = np.linalg.eigh(w.T @ explained @ w)
    coherences = np.clip(rho, 0.0, 1.0)
    return LowestCoherence(axial_vector(w @ vectors[:, 0]), float(coherences[0]), coherences)


def _in_space(cov: Covariances) -> Covariances:
    if len(cov.aa) != 3:
        raise InvalidData(f"a has {len(cov.aa)} rows; in space it has three")
    return cov
