"""Covariance of the means of dependent series."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from loose_env.statistics.sampling.autocorrelation import long_run_covariance


def two_first_order_series(rng: np.random.Generator, count: int) -> np.ndarray:
    """Two series of memory 0.7, the second following the first; long-run covariance known."""
    both = lfilter([1.0], [1.0, -0.7], rng.standard_normal((2, count + 200)))[:, 200:]
    both[1] += 0.8 * both[0]
    return np.asarray(both)


def test_it_is_that_of_two_related_series_with_memory() -> None:
    rng = np.random.default_rng(0)
    true = np.array([[1.0, 0.8], [0.8, 1.64]]) / (1 - 0.7) ** 2
    found = [long_run_covariance(two_first_order_series(rng, 1500)) for _ in range(60)]
    mean = np.mean([f.covariance for f in found], axis=0)
    np.testing.assert_allclose(mean, true, rtol=0.15)
    assert min(np.linalg.eigvalsh(f.covariance)[0] for f in found) > 0


def test_a_series_that_stands_still_takes_nothing_from_the_others() -> None:
    """An accelerometer axis that nothing moves, read by an ideal sensor."""
    moving = two_first_order_series(np.random.default_rng(1), 1500)
    alone = long_run_covariance(moving)
    beside = long_run_covariance(np.vstack([moving, np.zeros(1500)]))
    assert beside.degrees == alone.degrees
    np.testing.assert_allclose(beside.covariance[:2, :2], alone.covariance, rtol=1e-9)
    assert not beside.covariance[2].any() or np.abs(beside.covariance[2]).max() < 1e-100
    still = long_run_covariance(np.zeros((2, 100)))
    assert np.isfinite(still.covariance).all() and still.degrees == 75.0
