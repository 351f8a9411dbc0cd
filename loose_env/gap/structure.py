"""How much of a residual hangs together in time, which noise does not.

The mean product of a residual with itself a few samples later is zero for white noise, whatever its
size, and near the mean square for whatever a model misses. It says what there is to explain without
a word on how large the noise is. A residual that rings has turned over after half a period, and
shows nothing after a quarter: three lags are looked at, and the largest product counts, of either
sign. The lags leave out the next sample, which a sensor's filter may tie to the one before, but in
runs of random excitation, where what is missed rings at up to a fifth of the sample rate.

A feature of a run that is compared by features stands for itself: its square less one is about
zero where nothing is missing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Rows

__all__ = ["Structure", "largest"]

Array = NDArray[np.float64]

LAGS, SHAKEN_LAGS = (2, 3, 4), (1, 2, 3)
"""Samples between the two, and in runs of random excitation."""


class Structure:
    """Pairs of rows of one channel that are a little apart in time, for each of three lags.

    Parameters
    ----------
    rows : Rows
        Where the numbers come from.
    """

    def __init__(self, rows: Rows) -> None:
        order = np.lexsort((rows.place, rows.channel, rows.trial))
        self._white = np.flatnonzero(rows.white)
        self._white_block, self._white_channel = rows.block[rows.white], rows.channel[rows.white]
        self._pairs = []
        for usual, shaken in zip(LAGS, SHAKEN_LAGS, strict=True):
            found = [_pairs(rows, order, usual, False), _pairs(rows, order, shaken, True)]
            first, second = np.concatenate(found, axis=1)
            self._pairs.append((first, second, rows.block[first], rows.channel[first]))
        self.blocks, self.channels = int(rows.block.max()) + 1, int(rows.channel.max()) + 1

    def products(self, residual: Array) -> Array:
        """Sums of the products by lag and block of time (3, B)."""
        own = np.bincount(self._white_block, residual[self._white] ** 2 - 1, minlength=self.blocks)
        return np.stack(
            [
                own + np.bincount(block, residual[first] * residual[second], minlength=self.blocks)
                for first, second, block, _ in self._pairs
            ]
        )

    def by_channel(self, residual: Array) -> Array:
        """Sums of the products by lag and channel, and how many rows there are of each (4, C)."""
        own = np.bincount(
            self._white_channel, residual[self._white] ** 2 - 1, minlength=self.channels
        )
        sums = [
            own + np.bincount(channel, residual[first] * residual[second], minlength=self.channels)
            for first, second, _, channel in self._pairs
        ]
        counts = np.bincount(self._pairs[0][3], minlength=self.channels)
        counts += np.bincount(self._white_channel, minlength=self.channels)
        return np.stack([*sums, counts])


def largest(sums: Array) -> Array:
    """Largest of sums by lag (3, ...), of either sign (...)."""
    return np.asarray(np.max(np.abs(sums), axis=0))


def _pairs(rows: Rows, order: NDArray[np.intp], lag: int, shaken: bool) -> NDArray[np.intp]:
    """Numbers of rows that are so many samples apart, in runs of one sort (2, K)."""
    first, second = order[:-lag], order[lag:]
    same = (
        (rows.trial[first] == rows.trial[second])
        & (rows.channel[first] == rows.channel[second])
        & (rows.place[second] - rows.place[first] == lag)
        & (rows.shaken[first] == shaken)
        & ~rows.white[first]
    )
    return np.stack([first[same], second[same]])
