"""Skewness and excess kurtosis of a motion, by direction.

Sums are divided by the number of samples, as in the thesis (4.16 to 4.20).
"""

from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_direction, as_samples
from loose_env.typing import Array

# Standard deviation relative to the mean, or of one component to the other, taken as rounding.
ROUNDING = 1e-12


@overload
def skewness(a: ArrayLike, direction: None = None) -> Array: ...
@overload
def skewness(a: ArrayLike, direction: ArrayLike) -> float: ...
def skewness(a: ArrayLike, direction: ArrayLike | None = None) -> Array | float:
    """Measure the asymmetry of the distribution, E[(X - mu)^3] / sigma^3 (4.19).

    Zero for a Gaussian motion. Stops of unequal stiffness make it differ from zero. Mean and
    variance of a component are those of (4.16 to 4.18).

    Parameters
    ----------
    a : array, shape (N,) or (d, N)
        Tool acceleration in the tool frame, m/s^2.
    direction : array, shape (d,), optional
        Direction in the tool frame, of any length above zero.

    Returns
    -------
    array, shape () or (d,), or float
        Skewness of each row of a, or of the component along `direction`.

    Raises
    ------
    InvalidData
        If a or the direction cannot be used, or a component asked for does not vary.

    Examples
    --------
    >>> skewness([[0.0, 0.0, 0.0, 4.0], [-1.0, 1.0, -1.0, 1.0]]).round(4).tolist()
    [1.1547, 0.0]
    """
    z = _standardised(a, direction)
    moment = np.einsum("...n,...n,...n->...", z, z, z) / z.shape[-1]
    return np.asarray(moment) if direction is None else float(moment)


@overload
def kurtosis(a: ArrayLike, direction: None = None) -> Array: ...
@overload
def kurtosis(a: ArrayLike, direction: ArrayLike) -> float: ...
def kurtosis(a: ArrayLike, direction: ArrayLike | None = None) -> Array | float:
    """Measure the excess kurtosis, E[(X - mu)^4] / sigma^4 - 3 (4.20).

    Zero for a Gaussian motion; impacts at the stops raise it.

    Parameters
    ----------
    a : array, shape (N,) or (d, N)
        Tool acceleration in the tool frame, m/s^2.
    direction : array, shape (d,), optional
        Direction in the tool frame, of any length above zero.

    Returns
    -------
    array, shape () or (d,), or float
        Excess kurtosis of each row of a, or of the component along `direction`.

    Raises
    ------
    InvalidData
        If a or the direction cannot be used, or a component asked for does not vary.

    Examples
    --------
    >>> kurtosis([[-1.0, 1.0, -1.0, 1.0], [0.0, 0.0, 0.0, 1.0]], [1.0, 0.0])
    -2.0
    """
    z = _standardised(a, direction)
    square = z * z
    moment = np.einsum("...n,...n->...", square, square) / z.shape[-1] - 3.0
    return np.asarray(moment) if direction is None else float(moment)


def shape_of(rows: ArrayLike) -> tuple[Array, Array]:
    """Measure `skewness` and `kurtosis` of every row together, in one pass.

    Parameters
    ----------
    rows : array, shape (d, N)
        Signals of any unit.

    Returns
    -------
    array, array, each of shape (d,)
        Skewness and excess kurtosis.

    Raises
    ------
    InvalidData
        If the rows cannot be used, or one does not vary.

    Examples
    --------
    >>> rows = [[-1.0, 1.0, -1.0, 1.0], [0.0, 0.0, 0.0, 4.0]]
    >>> [values.round(4).tolist() for values in shape_of(rows)]
    [[0.0, 1.1547], [-2.0, -0.6667]]
    """
    z = _standardised(rows, None)
    square = z * z
    count = z.shape[-1]
    third = np.einsum("...n,...n->...", square, z) / count
    fourth = np.einsum("...n,...n->...", square, square) / count - 3.0
    return np.asarray(third), np.asarray(fourth)


def _standardised(a: ArrayLike, direction: ArrayLike | None) -> Array:
    record = as_samples(a, "a")
    if record.ndim > 2:
        raise InvalidData(f"a has shape {record.shape}; it must be (N,) or (d, N)")
    if direction is not None:
        if record.ndim != 2:
            raise InvalidData(f"a has shape {record.shape}; a direction needs (d, N)")
        record = np.einsum("d,dn->n", as_direction(direction, len(record)), record)
    with np.errstate(invalid="ignore", over="ignore"):
        means = record.mean(axis=-1, keepdims=True)
        centred = record - means
        sd = np.sqrt(np.einsum("...n,...n->...", centred, centred) / record.shape[-1])[..., None]
    if not np.isfinite(sd).all():
        raise InvalidData("a holds NaN, infinite or too large values")
    if (sd <= ROUNDING * np.abs(means)).any():
        raise InvalidData("a is constant in a component asked for; it must vary")
    return np.asarray(centred / sd)
