"""Axes in the plane and in space."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import (
    axes_grid,
    axial_difference,
    axial_mean,
    axial_vector,
    wrap_axial,
)


def test_wrapping_keeps_the_axis_and_lands_in_zero_to_pi(rng):
    angles = rng.uniform(-20, 20, 500)
    wrapped = wrap_axial(angles)
    assert ((wrapped >= 0) & (wrapped < np.pi)).all()
    np.testing.assert_allclose(np.tan(wrapped), np.tan(angles), rtol=1e-9)


@pytest.mark.parametrize("angle", [-1e-20, math.pi, -math.pi, 0.0])
def test_wrapping_never_returns_pi(angle):
    assert wrap_axial(angle) == 0.0


def test_wrapping_returns_what_it_is_given():
    assert isinstance(wrap_axial(4.0), float)
    assert wrap_axial(np.array([[4.0, 1.0]])).shape == (1, 2)


def test_difference_goes_the_short_way_round():
    assert math.degrees(axial_difference(math.radians(1), math.radians(178))) == pytest.approx(3)
    assert math.degrees(axial_difference(math.radians(178), math.radians(1))) == pytest.approx(-3)


def test_perpendicular_axes_differ_by_minus_ninety_degrees_either_way():
    assert axial_difference(math.pi / 2, 0.0) == -math.pi / 2
    assert axial_difference(0.0, math.pi / 2) == -math.pi / 2


def test_difference_broadcasts(rng):
    angles = rng.uniform(0, np.pi, 50)
    turned = axial_difference(angles + 0.3 + np.pi, angles)
    np.testing.assert_allclose(turned, 0.3)


def test_mean_is_half_the_circular_mean_of_the_doubled_angles(rng):
    angles = rng.vonmises(0.4, 5.0, 40)
    expected = stats.circmean(2 * angles) / 2
    assert axial_difference(axial_mean(angles), expected) == pytest.approx(0, abs=1e-12)


def test_mean_ignores_which_end_of_an_axis_is_named(rng):
    angles = rng.vonmises(0.0, 8.0, 20)
    flipped = angles + np.pi * rng.integers(0, 2, 20)
    assert axial_difference(axial_mean(flipped), axial_mean(angles)) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("angles", [[0.0, math.pi / 2], [], [0.1, math.nan]])
def test_axes_without_a_mean_are_refused(angles):
    with pytest.raises(InvalidData):
        axial_mean(angles)


@pytest.mark.parametrize("dimension", [2, 3])
def test_both_ends_of_an_axis_have_the_same_vector(rng, dimension):
    for vector in rng.standard_normal((20, dimension)):
        unit = axial_vector(vector)
        np.testing.assert_allclose(unit, axial_vector(-3.0 * vector))
        assert np.linalg.norm(unit) == pytest.approx(1)
        assert unit[-1] > 0


def test_a_zero_last_component_leaves_the_sign_to_the_one_before():
    np.testing.assert_array_equal(axial_vector([-2.0, 0.0]), [1.0, 0.0])


@pytest.mark.parametrize("direction", [[0.0, 0.0], [1.0, math.nan]])
def test_what_is_no_direction_is_refused(direction):
    with pytest.raises(InvalidData):
        axial_vector(direction)


def test_the_grid_leaves_no_hole() -> None:
    rng = np.random.default_rng(0)
    anywhere = rng.standard_normal((500, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    for count in (40, 400):
        nearest = np.arccos(np.abs(anywhere @ axes_grid(count).T).max(axis=1).clip(max=1.0))
        assert nearest.max() < 1.1 * np.sqrt(2 * np.pi / count)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="count"):
        axes_grid(0)
    with pytest.raises(InvalidSetting, match="whole number"):
        axes_grid(2.5)  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="dimension"):
        axes_grid(5, 4)
