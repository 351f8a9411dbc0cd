"""How much of a residual hangs together in time, which noise does not.

The mean product of a residual with itself a little later is zero for white noise, whatever its
size, and near the mean square for whatever a model misses. It says what there is to explain
without a word on how large the noise is. A little is two samples, and one in a run of random
excitation: what a model misses there rings at up to a fifth of the sample rate, and two samples
later it has turned over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Rows

__all__ = ["Structure"]

Array = NDArray[np.float64]

LAG, SHAKEN_LAG = 2, 1
"""Samples between the two, and in a run of random excitation."""


class Structure:
    """Pairs of rows of one channel that are a little apart in time.

    Parameters
    ----------
    rows : Rows
        Where the numbers come from.
    """

    def __init__(self, rows: Rows) -> None:
        order = np.lexsort((rows.place, rows.channel, rows.trial))
        pairs = []
        for lag, shaken in ((LAG, False), (SHAKEN_LAG, True)):
            first, second = order[:-lag], order[lag:]
            same = (
                (rows.trial[first] == rows.trial[second])
                & (rows.channel[first] == rows.channel[second])
                & (rows.place[second] - rows.place[first] == lag)
                & (rows.shaken[first] == shaken)
            )
            pairs.append(np.stack([first[same], second[same]]))
        self.first, self.second = np.concatenate(pairs, axis=1)
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
