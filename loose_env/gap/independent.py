"""How many independent numbers rows that hang together in time are worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["independent_rows"]

Array = NDArray[np.float64]
Labels = NDArray[np.intp]


def independent_rows(residual: Array, block: Labels, channel: Labels) -> float:
    """How many independent numbers the rows of a residual (N,) are worth.

    Rows of one channel in one block of time may hang together; channels and blocks do not. Of
    independent rows the square of a block's sum is about its sum of squares. By as much as it is
    larger on average, the variance of whatever is estimated from blocks is larger than rows alone
    make believe (the design effect of a cluster sample, Kish, Survey Sampling, 1965), and the
    rows, and with them the log-likelihood, count as much less.

    Parameters
    ----------
    residual : ndarray (N,)
        What is left.
    block, channel : ndarray (N,)
        Block of time and channel of each row.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> block, channel = np.repeat(np.arange(200), 50), np.zeros(10000, dtype=np.intp)
    >>> round(independent_rows(rng.normal(size=10000), block, channel), -3)
    10000.0
    >>> round(independent_rows(np.repeat(rng.normal(size=200), 50), block, channel))
    200
    """
    if not len(residual):
        return 0.0
    cell = block * (int(channel.max()) + 1) + channel
    _, cell = np.unique(cell, return_inverse=True)
    sums = np.bincount(cell, residual)
    squares = float(residual @ residual)
    if squares <= 0:
        return float(len(residual))
    return float(len(residual) / max(float(sums @ sums) / squares, 1.0))
