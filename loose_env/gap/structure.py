"""How much of a residual hangs together in time, which noise does not.

The mean product of a residual with itself two samples later is zero for white noise, whatever its
size, and near the mean square for whatever a model misses. It says what there is to explain
without a word on how large the noise is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Rows

__all__ = ["Structure"]

Array = NDArray[np.float64]

LAG = 2
"""Samples between the two."""


class Structure:
    """Pairs of rows of one channel that are `LAG` samples apart.

    Parameters
    ----------
    rows : Rows
        Where the numbers come from.
    """

    def __init__(self, rows: Rows) -> None:
        order = np.lexsort((rows.place, rows.channel, rows.trial))
        first, second = order[:-LAG], order[LAG:]
        same = (
            (rows.trial[first] == rows.trial[second])
            & (rows.channel[first] == rows.channel[second])
            & (rows.place[second] - rows.place[first] == LAG)
        )
        self.first, self.second = first[same], second[same]
        self.block, self.channel = rows.block[self.first], rows.channel[self.first]
        self.blocks, self.channels = int(rows.block.max()) + 1, int(rows.channel.max()) + 1

    def products(self, residual: Array) -> Array:
        """Sums of the products by block of time (B,)."""
        products = residual[self.first] * residual[self.second]
        return np.asarray(np.bincount(self.block, products, minlength=self.blocks), dtype=float)

    def by_channel(self, residual: Array) -> Array:
        """Sums of the products by channel, and how many there are of each (2, C)."""
        products = residual[self.first] * residual[self.second]
        return np.stack(
            [
                np.bincount(self.channel, products, minlength=self.channels),
                np.bincount(self.channel, minlength=self.channels),
            ]
        )
