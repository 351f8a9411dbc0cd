"""The memory of a series."""

import numpy as np
import pytest
from scipy import signal as scipy_signal

from loose_env.statistics.sampling.autocorrelation import memory_of


def remembering(rng, memory, count=1200):
    """First-order series past its start."""
    noise = rng.standard_normal(count + 200)
    return scipy_signal.lfilter([1.0], [1.0, -memory], noise)[200:]


@pytest.mark.parametrize("memory", [-0.5, 0.0, 0.5, 0.8])
def test_the_long_run_variance_of_a_first_order_series_is_known(rng, memory):
    found = [memory_of(remembering(rng, memory)).variance for _ in range(200)]
    assert np.mean(found) == pytest.approx(1 / (1 - memory) ** 2, rel=0.1)


def test_longer_memory_asks_for_longer_blocks(rng):
    lengths = [
        np.median([memory_of(remembering(rng, memory)).block for _ in range(30)])
        for memory in (0.0, 0.5, 0.9)
    ]
    assert 1 <= lengths[0] < 5 < lengths[1] < lengths[2]


def test_the_scatter_of_the_variance_is_that_of_its_degrees_of_freedom(rng):
    found = [memory_of(remembering(rng, 0.8)) for _ in range(300)]
    variances = np.array([memory.variance for memory in found])
    # A variance with k degrees of freedom scatters by sqrt(2 / k) of itself.
    predicted = np.sqrt(2 / np.median([memory.degrees for memory in found]))
    assert 0.5 * predicted < variances.std() / variances.mean() < 1.5 * predicted


def test_blocks_reach_less_than_the_whole_memory(rng):
    reaches = [memory_of(remembering(rng, 0.9), block=10).reach for _ in range(50)]
    # Falling weights over 10 lags of 0.9^k sum to 0.59 of the whole, by hand.
    lags = np.arange(1, 10)
    share = (1 + 2 * np.sum((1 - lags / 10) * 0.9**lags)) / (1.9 / 0.1)
    assert np.mean(reaches) == pytest.approx(share, abs=0.1)
    assert max(reaches) <= 1


def test_a_given_block_is_kept(rng):
    assert memory_of(remembering(rng, 0.5), block=17.0).block == 17.0


def test_a_series_of_zeros_has_no_scatter():
    memory = memory_of(np.zeros(50))
    assert memory.variance == 0.0
    assert memory.reach == 1.0
