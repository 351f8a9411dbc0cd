"""How many independent samples a record is worth."""

import math

import numpy as np
import pytest
from scipy import signal as scipy_signal

from loose_env.errors import InvalidData
from loose_env.statistics import bandpass, effective_samples

RATE = 1000.0


def resonant(rng, count, frequency=83.0, damping=0.05):
    """Noise through a lightly damped mode, past its start."""
    w, dt = 2 * math.pi * frequency, 1 / RATE
    pole = np.exp((-damping + 1j * math.sqrt(1 - damping**2)) * w * dt)
    denominator = np.poly([pole, pole.conjugate()]).real
    return scipy_signal.lfilter([1.0], denominator, rng.standard_normal((2, count + 500)))[:, 500:]


def test_white_noise_counts_in_full(rng):
    assert effective_samples(*rng.standard_normal((2, 20_000))) == pytest.approx(20_000, rel=0.05)


@pytest.mark.parametrize("band", [(30.0, 150.0), (0.5, 350.0)])
def test_flat_spectra_count_twice_their_bandwidth_times_time(rng, band):
    x, u = bandpass(rng.standard_normal((2, 20_000)), RATE, band)
    expected = 2 * (band[1] - band[0]) * 20.0
    assert effective_samples(x, u) == pytest.approx(expected, rel=0.05)


def test_it_predicts_the_scatter_of_a_correlation_near_a_resonance(rng):
    correlations, counts = [], []
    for _ in range(400):
        x, u = resonant(rng, 2000)
        correlations.append(np.corrcoef(x, u)[0, 1])
        counts.append(effective_samples(x, u))
    # Far fewer than the samples, and as many as the scatter says: 400 repetitions know it to 7 %.
    assert np.mean(counts) < 200
    assert 1 / np.mean(counts) == pytest.approx(np.mean(np.square(correlations)), rel=0.2)


def test_correlated_signals_are_not_counted_twice(rng):
    x = bandpass(rng.standard_normal(20_000), RATE, (30.0, 150.0))
    assert effective_samples(x, x) == pytest.approx(2 * 120 * 20, rel=0.1)


@pytest.mark.parametrize("count", [1199, 1200])
def test_it_does_not_depend_on_units_or_means(rng, count):
    x, u = rng.standard_normal((2, count))
    assert effective_samples(1e3 * x + 5, u - 7) == pytest.approx(effective_samples(x, u))


@pytest.mark.parametrize("count", [15, 16])
def test_it_is_the_two_sided_formula(rng, count):
    x, u = rng.standard_normal((2, count))
    power_x, power_u = np.abs(np.fft.fft([x - x.mean(), u - u.mean()])) ** 2
    beside = [(power_u[k - 1] + power_u[(k + 1) % count]) / 2 for k in range(count)]
    expected = power_x.sum() * power_u.sum() / (power_x * beside).sum()
    assert effective_samples(x, u) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("x", "u"),
    [
        ([1.0, 2.0, 4.0, 3.0], [1.0, 2.0, 3.0, 5.0, 1.0]),
        ([[1.0, 2.0, 4.0, 3.0]] * 2, [[1.0, 2.0, 4.0, 3.0]] * 2),
        ([1.0, 2.0, math.nan, 3.0], [1.0, 2.0, 4.0, 3.0]),
        ([1.0, 1.0, 1.0, 1.0], [1.0, 2.0, 4.0, 3.0]),
        ([1.0, 2.0, 3.0], [1.0, 2.0, 4.0]),
    ],
)
def test_signals_that_cannot_be_used_are_refused(x, u):
    with pytest.raises(InvalidData):
        effective_samples(x, u)
