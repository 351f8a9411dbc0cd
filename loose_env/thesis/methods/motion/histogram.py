"""Histograms of several dimensions with square bins, and contours of probability (thesis 4.1.1)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData
from loose_env.statistics import as_record
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Histogram:
    """Counts of samples in bins that are as wide in every direction."""

    counts: NDArray[np.float64]
    """Samples in each bin, shape (B,) * d; axis k of the array is direction k."""
    low: Array
    """Lower edge of the first bin in each direction, shape (d,), unit of the data."""
    width: float
    """Width of a bin, unit of the data."""

    def centres(self, axis: int) -> Array:
        """Centres of the bins in a direction (B,), unit of the data."""
        bins = self.counts.shape[axis]
        return np.asarray(self.low[axis] + self.width * (np.arange(bins) + 0.5))

    def points(self) -> Array:
        """Centres of all bins (d, B**d), in the order of ``counts.ravel()``."""
        axes = [self.centres(k) for k in range(self.counts.ndim)]
        return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")])

    def density(self) -> Array:
        """Probability density in each bin, of the shape of the counts."""
        return np.asarray(self.counts / (self.counts.sum() * self.width**self.counts.ndim))


def histogram(samples: ArrayLike, bins: int = 120) -> Histogram:
    """Sort samples into bins; the largest range is used in all directions to preserve scale.

    ``samples`` (N,) or (d, N): motion, one row a direction. Returns counts; each direction is
    centred on the middle of its own range.

    Examples
    --------
    >>> found = histogram([[0.0, 1.0, 2.0, 4.0], [0.0, 0.0, 1.0, 1.0]], bins=2)
    >>> found.counts.tolist(), found.low.tolist(), found.width
    ([[2.0, 0.0], [0.0, 2.0]], [0.0, -1.5], 2.0)
    """
    values = as_record(samples, "samples")
    lowest, highest = values.min(axis=1), values.max(axis=1)
    largest = float((highest - lowest).max())
    if largest <= 0.0:
        raise InvalidData("samples do not vary in any direction; a histogram needs a range")
    low = 0.5 * (lowest + highest) - 0.5 * largest
    width = largest / bins
    # The highest sample lies on the upper edge and belongs to the last bin.
    index = np.clip(np.floor((values - low[:, None]) / width), 0, bins - 1).astype(np.int64)
    flat = np.ravel_multi_index(tuple(index), (bins,) * len(values))
    counts = np.bincount(flat, minlength=bins ** len(values)).astype(np.float64)
    return Histogram(counts=counts.reshape((bins,) * len(values)), low=low, width=width)


def contour_levels(found: Histogram, shares: Sequence[float] = (0.5, 0.9, 0.99)) -> Array:
    """Count down to which bins must be laid, fullest first, to hold each share of the data.

    ``shares``: shares of the data, in (0, 1]. Returns (len(shares),): counts: bins with at least
    that many hold at least the share.

    Examples
    --------
    >>> found = histogram([0.0, 0.1, 0.2, 0.3, 0.6, 1.0], bins=3)
    >>> found.counts.tolist(), contour_levels(found, [0.5, 0.9]).tolist()
    ([4.0, 1.0, 1.0], [4.0, 1.0])
    """
    wanted = np.asarray(shares, dtype=np.float64)
    layers = np.sort(found.counts, axis=None)[::-1]
    laid = np.cumsum(layers)
    # A share that is met exactly must not ask for one more layer because of rounding.
    first = np.searchsorted(laid, wanted * laid[-1] * (1.0 - 1e-12))
    return np.asarray(layers[np.minimum(first, len(layers) - 1)])


def marginal(found: Histogram, axis: int) -> Array:
    """Marginal probability density of one direction: the density summed over all others (3.70).

    ``axis``: direction that is kept, 0 to d - 1. Returns (B,): density at the centres of the bins,
    one over the unit of the data.

    Examples
    --------
    >>> marginal(histogram([[0.0, 1.0, 2.0, 4.0], [0.0, 0.0, 1.0, 1.0]], bins=2), 0).tolist()
    [0.25, 0.25]
    """
    dimensions = found.counts.ndim
    others = tuple(k for k in range(dimensions) if k != axis)
    return np.asarray(found.density().sum(axis=others) * found.width ** (dimensions - 1))
