"""Lagged products of residuals (autocorrelated part), and effective number of independent rows.

The lagged product of a residual is zero on average for white noise, whatever its size, and near the
mean square for any model error. It measures the explainable part without an estimate of the noise
level. An oscillating residual has the opposite sign after half a period, and no correlation after a
quarter: three lags are computed, and the largest product counts, of either sign. The lags leave out
the next sample, which a sensor's filter may correlate with the one before, except in runs of random
excitation, where model errors oscillate at up to a fifth of the sample rate.

In inverse runs the noise of the measured acceleration is largest at the top of the band, where it
changes sign from one sample to the next: means over two neighbouring lags cancel it.

A feature of a run that is compared by features is independent: its square less one is about zero
for a correct model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.residuals.residual_model import Rows
from loose_env.typing import Array, IndexArray

LAGS, RANDOM_LAGS = ((2,), (3,), (4,)), ((1,), (2,), (3,))
"""Samples between the two, and in runs of random excitation."""
INVERSE_LAGS = ((3, 4), (5, 6), (7, 8))
"""The same in inverse runs, the mean of two each."""


class LaggedProducts:
    """Lagged products of a residual, by channel and for each of three lags."""

    def __init__(self, rows: Rows) -> None:
        order = np.lexsort((rows.index, rows.channel, rows.trial))
        self._feature = np.flatnonzero(rows.is_feature)
        self._feature_block, self._feature_channel = (
            rows.block[rows.is_feature],
            rows.channel[rows.is_feature],
        )
        self._pairs = []
        usual = ~(rows.is_feature | rows.random_excitation | rows.inverse)
        for slot in range(len(LAGS)):
            parts = [
                (*_pairs(rows, order, lag, among), 1.0 / len(lags[slot]))
                for lags, among in (
                    (LAGS, usual),
                    (RANDOM_LAGS, rows.random_excitation & ~rows.is_feature & ~rows.inverse),
                    (INVERSE_LAGS, rows.inverse),
                )
                for lag in lags[slot]
            ]
            first = np.concatenate([part[0] for part in parts])
            second = np.concatenate([part[1] for part in parts])
            weight = np.concatenate([np.full(len(part[0]), part[2]) for part in parts])
            self._pairs.append((first, second, weight, rows.block[first], rows.channel[first]))
        self.blocks, self.channels = int(rows.block.max()) + 1, int(rows.channel.max()) + 1

    def products(self, residual: Array) -> Array:
        """Sums of the lagged products by lag and block of time (3, B)."""
        own = np.bincount(
            self._feature_block, residual[self._feature] ** 2 - 1, minlength=self.blocks
        )
        return np.stack(
            [
                own
                + np.bincount(
                    block, weight * residual[first] * residual[second], minlength=self.blocks
                )
                for first, second, weight, block, _ in self._pairs
            ]
        )

    def by_channel(self, residual: Array) -> Array:
        """Sums of the lagged products by lag and channel, and the number of rows (4, C)."""
        own = np.bincount(
            self._feature_channel, residual[self._feature] ** 2 - 1, minlength=self.channels
        )
        sums = [
            own
            + np.bincount(
                channel, weight * residual[first] * residual[second], minlength=self.channels
            )
            for first, second, weight, _, channel in self._pairs
        ]
        _, _, weight, _, channel = self._pairs[0]
        counts = np.bincount(channel, weight, minlength=self.channels)
        counts += np.bincount(self._feature_channel, minlength=self.channels)
        return np.stack([*sums, counts])

    def by_group(self, residual: Array, group: NDArray[np.intp]) -> Array:
        """Sums of the lagged products by lag and group of rows (3, G), without features."""
        count = int(group.max(initial=-1)) + 1
        return np.stack(
            [
                np.bincount(
                    group[first], weight * residual[first] * residual[second], minlength=count
                )
                for first, second, weight, _, _ in self._pairs
            ]
        )


def largest(sums: Array) -> Array:
    """Largest absolute value of sums by lag (3, ...)."""
    return np.asarray(np.max(np.abs(sums), axis=0))


def _pairs(
    rows: Rows, order: NDArray[np.intp], lag: int, among: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of row pairs at a given distance in samples, among some rows (K,) each."""
    first, second = order[:-lag], order[lag:]
    same = (
        (rows.trial[first] == rows.trial[second])
        & (rows.channel[first] == rows.channel[second])
        & (rows.index[second] - rows.index[first] == lag)
        & among[first]
    )
    return first[same], second[same]


def independent_rows(residual: Array, block: IndexArray, channel: IndexArray) -> float:
    """Effective number of independent rows of a residual (N,).

    Rows of one channel in one block of time may be correlated; channels and blocks are not. For
    independent rows the squared sum of a block is on average its sum of squares. The factor by
    which it is larger inflates the variance of any estimate from blocks (the design effect of a
    cluster sample, Kish, Survey Sampling, 1965), and reduces the effective number of rows, and with
    it the log-likelihood.

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
