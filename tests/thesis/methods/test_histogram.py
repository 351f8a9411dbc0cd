"""Histograms with square bins and their contours of probability."""

from __future__ import annotations

import math

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.thesis.methods.motion.histogram import contour_levels, histogram, marginal


def test_every_sample_is_counted_once_and_bins_are_square():
    samples = np.random.default_rng(1).normal(size=(2, 5000)) * [[1.0], [0.1]]
    found = histogram(samples, bins=40)
    assert found.counts.sum() == 5000
    widest = np.ptp(samples, axis=1).max()
    assert found.width == pytest.approx(widest / 40)
    assert found.points().shape == (2, 1600)
    # The narrow direction lies in the middle of the same range.
    middle = 0.5 * (samples[1].min() + samples[1].max())
    assert found.centres(1).mean() == pytest.approx(middle)


def test_mean_of_the_bins_is_the_mean_of_the_samples():
    shift = np.array([[3.0], [-1.0], [0.0]])
    samples = shift + np.random.default_rng(2).normal(size=(3, 4000))
    found = histogram(samples, bins=30)
    mean = found.points() @ found.counts.ravel() / 4000
    np.testing.assert_allclose(mean, samples.mean(axis=1), atol=0.5 * found.width)


def test_contours_of_a_gaussian_enclose_its_ellipses():
    """The share p lies where the density exceeds (1 - p) of its peak."""
    samples = np.random.default_rng(3).normal(size=(2, 1_000_000))
    found = histogram(samples, bins=60)
    shares = np.array([0.5, 0.9, 0.99])
    levels = contour_levels(found, shares)
    peak = 1_000_000 * found.width**2 / (2 * math.pi)
    np.testing.assert_allclose(levels / peak, 1 - shares, rtol=0.06)


def test_layers_hold_at_least_the_share_and_not_one_layer_more():
    found = histogram(np.random.default_rng(4).uniform(size=(2, 300)), bins=7)
    for share in (0.2, 0.5, 0.9, 1.0):
        (level,) = contour_levels(found, [share])
        kept = found.counts[found.counts >= level].sum()
        higher = found.counts[found.counts > level].sum()
        assert kept >= share * 300 * (1 - 1e-12) > higher - 1e-9


def test_marginal_of_a_gaussian():
    samples = np.random.default_rng(5).normal(size=(3, 400_000)) * [[1.0], [2.0], [1.5]]
    found = histogram(samples, bins=50)
    for axis, sd in enumerate((1.0, 2.0, 1.5)):
        density = marginal(found, axis)
        x = found.centres(axis)
        gauss = np.exp(-0.5 * (x / sd) ** 2) / (sd * math.sqrt(2 * math.pi))
        assert density.sum() * found.width == pytest.approx(1.0)
        np.testing.assert_allclose(density, gauss, atol=0.03 * gauss.max())


def test_wrong_input():
    with pytest.raises(InvalidData, match="vary"):
        histogram(np.ones((2, 10)))
