"""Which agents no other one beats in both cost and success."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData

__all__ = ["pareto_front"]


def pareto_front(cost: ArrayLike, value: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point dominates.

    A point dominates another if it costs no more and is worth no less, and is better in one
    of the two. Equal points do not dominate each other.

    Parameters
    ----------
    cost : array_like (N,)
        What is to be small: mean records.
    value : array_like (N,)
        What is to be large: success.

    Returns
    -------
    ndarray of bool (N,)
        Whether each point lies on the front.

    Raises
    ------
    InvalidData
        If the two differ in length or hold what is not finite.

    Examples
    --------
    >>> pareto_front([1, 2, 3, 2], [0.7, 0.9, 0.9, 0.8]).tolist()
    [True, True, False, False]
    """
    c, v = np.asarray(cost, dtype=float), np.asarray(value, dtype=float)
    if c.ndim != 1 or c.shape != v.shape or not (np.isfinite(c).all() and np.isfinite(v).all()):
        raise InvalidData(
            f"a front needs a finite cost and value for each point, got {c.shape} and {v.shape}"
        )
    no_worse = (c[:, None] <= c) & (v[:, None] >= v)
    better = (c[:, None] < c) | (v[:, None] > v)
    return np.asarray(~(no_worse & better).any(axis=0))
