"""Circular block bootstrap of the covariances of one record."""

import math

import numpy as np

from loose_env.typing import Array


def resampled_covariances(
    first: Array,
    second: Array,
    length: int,
    resamples: int,
    rng: np.random.Generator,
) -> Array:
    """Covariances of `first` with `second` in block-bootstrap resamples of a record.

    A record of N samples is laid in a circle and ceil(N / length) blocks are drawn from it with
    replacement. Only sums over blocks are needed, so no record is put together in fact.

    Parameters
    ----------
    first : array, shape (k, N)
        Signals, means removed.
    second : array, shape (l, N)
        Signals sampled with them, means removed.
    length : int
        Length of a block, samples, 1 to N.
    resamples : int
        Number of records.
    rng : numpy.random.Generator
        Where the blocks are drawn from.

    Returns
    -------
    array, shape (resamples, k, l)
        Covariances, the means of each record removed.

    References
    ----------
    Politis and Romano, in Exploring the Limits of Bootstrap (1992).
    """
    k, count = first.shape
    products = (first[:, None, :] * second[None, :, :]).reshape(-1, count)
    series = np.concatenate((products, first, second))
    circle = np.concatenate((series, series[:, : length - 1]), axis=1)
    running = np.cumsum(circle, axis=1)
    sums = running[:, length - 1 :].copy()
    sums[:, 1:] -= running[:, : count - 1]
    blocks = math.ceil(count / length)
    starts = rng.integers(0, count, size=(resamples, blocks))
    means = np.stack([row[starts].sum(axis=1) for row in sums]) / (blocks * length)
    product = means[: len(products)].reshape(k, -1, resamples)
    mean_first = means[len(products) : len(products) + k]
    mean_second = means[len(products) + k :]
    return np.moveaxis(product - mean_first[:, None, :] * mean_second[None, :, :], -1, 0)
