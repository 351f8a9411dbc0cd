"""Skewness and kurtosis."""

import math

import numpy as np
import pytest
from scipy import stats

from loose_env.errors import InvalidData
from loose_env.statistics import kurtosis, skewness


def skewed(rng, count=500):
    """Planar motion, neither symmetric nor Gaussian, its components correlated."""
    return np.array([[1.0, 0.4], [-0.7, 2.0]]) @ rng.gamma(2.0, size=(2, count)) + 30.0


@pytest.mark.parametrize("dimension", [2, 3])
def test_moments_are_those_of_scipy(rng, dimension):
    a = rng.gamma(2.0, size=(dimension, 300))
    np.testing.assert_allclose(skewness(a), stats.skew(a, axis=1))
    np.testing.assert_allclose(kurtosis(a), stats.kurtosis(a, axis=1))
    direction = rng.standard_normal(dimension)
    assert skewness(a, direction) == pytest.approx(stats.skew(direction @ a))
    assert kurtosis(a, direction) == pytest.approx(stats.kurtosis(direction @ a))


def test_a_single_signal_has_one_moment(rng):
    a = rng.gamma(2.0, size=200)
    assert skewness(a).shape == kurtosis(a).shape == ()
    assert float(kurtosis(a)) == pytest.approx(stats.kurtosis(a))


def test_known_distributions():
    two_points = np.array([1.0, -1.0] * 10)
    assert kurtosis(two_points) == pytest.approx(-2)
    even = np.linspace(-1, 1, 100_001)
    assert kurtosis(even) == pytest.approx(-1.2, abs=1e-3)
    assert skewness(even) == pytest.approx(0, abs=1e-9)
    waves = np.sin(2 * np.pi * np.arange(1000) / 50)
    assert kurtosis(waves) == pytest.approx(-1.5)


def test_a_direction_and_its_opposite_differ_in_the_sign_of_skewness_only(rng):
    a = skewed(rng)
    assert skewness(a, [1, 2]) == pytest.approx(-skewness(a, [-1, -2]))
    assert kurtosis(a, [1, 2]) == pytest.approx(kurtosis(a, [-1, -2]))


def test_impacts_raise_the_kurtosis_along_the_slide(rng):
    a = rng.standard_normal((2, 2000))
    a[1, ::100] += 20.0
    angles = np.radians(np.arange(0, 180, 5))
    along = [kurtosis(a, [math.cos(angle), math.sin(angle)]) for angle in angles]
    peak = angles[np.argmax(along)]
    assert math.degrees(peak) == pytest.approx(90, abs=10)


@pytest.mark.parametrize("function", [skewness, kurtosis])
@pytest.mark.parametrize(
    ("a", "direction"),
    [
        ([1.0, 2.0, 3.0], None),
        ([1.0, 2.0, np.nan, 3.0], None),
        ([1.0, 2.0, np.inf, 3.0], None),
        ([0.1] * 7, None),
        ([[1.0, 2.0, 3.0, 5.0], [0.3] * 4], None),
        ([[1.0, 2.0, 3.0, 5.0], [0.3] * 4], [0.0, 1.0]),
        ([1.0, 2.0, 3.0, 5.0], [1.0]),
        ([[1.0, 2.0, 3.0, 5.0]] * 2, [1.0, 0.0, 0.0]),
        (np.ones((2, 2, 5)), None),
    ],
)
def test_motion_without_moments_is_refused(function, a, direction):
    with pytest.raises(InvalidData):
        function(a, direction)
