"""Second-order statistics of one record, computed once and shared by the functions on them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import FloatArray, as_record

# Below this share of the largest variance a direction counts as not moving: rounding of the
# covariances, not the record, decides what is seen there.
STILL = 1e-12

DEPENDENT = "the rows of x depend on each other linearly; each joint needs its own excitation"


@dataclass(frozen=True, slots=True, eq=False)
class Covariances:
    """Covariances of m excitation signals x and d response signals a, means removed.

    Sums are divided by the number of samples.
    """

    xx: FloatArray
    """cov(x, x), shape (m, m), (rad/s^2)^2 for joint accelerations."""
    xa: FloatArray
    """cov(x, a), shape (m, d), rad/s^2 times m/s^2."""
    aa: FloatArray
    """cov(a, a), shape (d, d), (m/s^2)^2."""
    count: int
    """Number of samples."""


def covariances(x: ArrayLike, a: ArrayLike) -> Covariances:
    """Compute the covariances of a record, means removed.

    Parameters
    ----------
    x : array, shape (N,) or (m, N)
        Excitation: joint accelerations, rad/s^2, or joint torques, N m.
    a : array, shape (N,) or (d, N)
        Response: tool acceleration in the tool frame, m/s^2, or joint accelerations.

    Returns
    -------
    Covariances
        What the functions ending in `_from` take.

    Raises
    ------
    InvalidData
        If a shape is wrong, the lengths differ, there are fewer than four samples, a value is
        not finite, a row of x is constant or every row of a is.

    Examples
    --------
    >>> cov = covariances([1.0, -1.0, 1.0, -1.0], [[2.0, -2.0, 2.0, -2.0], [0.0, 0.0, 3.0, -3.0]])
    >>> cov.xa.tolist()
    [[2.0, 1.5]]
    """
    excitation, response = as_record(x, "x"), as_record(a, "a")
    count = excitation.shape[1]
    if response.shape[1] != count:
        raise InvalidData(
            f"x has {count} samples and a has {response.shape[1]}; they must be sampled together"
        )
    joined = np.concatenate((excitation, response))
    means = joined.mean(axis=1, keepdims=True)
    joined -= means
    # einsum sums in one fixed order, whatever the number of threads.
    full = np.einsum("in,jn->ij", joined, joined) / count
    if not np.isfinite(full).all():
        raise InvalidData("x or a holds NaN, infinite or too large values")
    m = len(excitation)
    # What is left of a constant after its mean is removed is rounding.
    moving = full.diagonal() > (1e-15 * means[:, 0]) ** 2
    if not moving[:m].all():
        raise InvalidData(f"x is constant in row {int(np.argmin(moving[:m]))}; it must vary")
    if not moving[m:].any():
        raise InvalidData("a is constant; it must vary in one row at least")
    return Covariances(xx=full[:m, :m], xa=full[:m, m:], aa=full[m:, m:], count=count)


def centred(signal: ArrayLike) -> FloatArray:
    """Return a signal of shape (N,) or (k, N) as (k, N), means removed."""
    record = as_record(signal, "signal")
    return np.subtract(record, record.mean(axis=1, keepdims=True))


def single_excitation(cov: Covariances) -> FloatArray:
    """Return c = cov(x, a), shape (d,), of a record with one excited joint."""
    if len(cov.xx) != 1:
        raise InvalidData(
            f"x has {len(cov.xx)} rows; one excited joint is needed here, with several use "
            "lowest_coherence_direction"
        )
    return cov.xa[0]


def planar_excitation(cov: Covariances) -> FloatArray:
    """Return c = cov(x, a), shape (2,), of a planar record with one excited joint."""
    c = single_excitation(cov)
    if len(c) != 2:
        raise InvalidData(
            f"a has {len(c)} rows; an angle needs two. In space one excitation leaves a whole "
            "plane uncorrelated"
        )
    return c


def whitener(aa: FloatArray) -> FloatArray:
    """Return W, shape (d, d), with W.T S W = 1 for the covariance S of the tool acceleration.

    A direction in which the tool does not move gets a small variance in place of none. That is
    the limit with sensor noise: its correlation with anything is zero.
    """
    values, vectors = np.linalg.eigh(aa)
    scale = np.sqrt(np.maximum(values, STILL * values[-1]))
    return np.asarray(vectors / scale, dtype=np.float64)


def excitation_factor(xx: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of cov(x, x), shape (m, m)."""
    try:
        factor = np.linalg.cholesky(xx)
    except np.linalg.LinAlgError as error:
        raise InvalidData(DEPENDENT) from error
    # The square of a pivot is what of a row's variance the rows above leave unexplained.
    if (factor.diagonal() ** 2 < STILL * xx.diagonal()).any():
        raise InvalidData(DEPENDENT)
    return np.asarray(factor, dtype=np.float64)
