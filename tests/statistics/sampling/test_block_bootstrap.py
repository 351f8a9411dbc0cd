"""Circular blocks."""

import numpy as np
import pytest

from loose_env.statistics.sampling.block_bootstrap import resampled_covariances


def centred(signal):
    return signal - signal.mean(axis=1, keepdims=True)


def test_one_block_of_the_whole_circle_is_the_record_itself(rng):
    first, second = centred(rng.standard_normal((2, 40))), centred(rng.standard_normal((3, 40)))
    drawn = resampled_covariances(first, second, 40, 5, rng)
    assert drawn.shape == (5, 2, 3)
    np.testing.assert_allclose(drawn, np.broadcast_to(first @ second.T / 40, (5, 2, 3)))


@pytest.mark.parametrize("length", [1, 3, 7])
def test_covariances_are_those_of_records_put_together_from_blocks(rng, length):
    first, second = centred(rng.standard_normal((1, 20))), centred(rng.standard_normal((2, 20)))
    drawn = resampled_covariances(first, second, length, 6, np.random.default_rng(5))
    blocks = -(-20 // length)
    starts = np.random.default_rng(5).integers(0, 20, size=(6, blocks))
    for found, begin in zip(drawn, starts, strict=True):
        at = (begin[:, None] + np.arange(length)).ravel() % 20
        together = np.vstack((first[:, at], second[:, at]))
        np.testing.assert_allclose(found, np.cov(together, bias=True)[:1, 1:], atol=1e-12)


def test_single_samples_scatter_as_independent_ones(rng):
    x, u = centred(rng.standard_normal((1, 500))), centred(rng.standard_normal((1, 500)))
    drawn = resampled_covariances(x, u, 1, 4000, rng)[:, 0, 0]
    assert drawn.std() == pytest.approx((x * u).std() / np.sqrt(500), rel=0.05)


def test_the_same_generator_state_gives_the_same_records(rng):
    x = centred(rng.standard_normal((1, 50)))
    first = resampled_covariances(x, x, 4, 10, np.random.default_rng(1))
    again = resampled_covariances(x, x, 4, 10, np.random.default_rng(1))
    other = resampled_covariances(x, x, 4, 10, np.random.default_rng(2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
