"""Correlation with one excited joint, by direction."""

import math

import numpy as np
import pytest
from scipy import stats

from loose_env.errors import InvalidData
from loose_env.statistics import (
    axial_difference,
    correlation_loop,
    correlation_loop_from,
    covariances,
    lowest_correlation_direction,
    lowest_correlation_direction_from,
    maximum_correlation,
    maximum_correlation_from,
)


def unit(angle):
    return np.array([math.cos(angle), math.sin(angle)])


def pearson(x, a, direction):
    return stats.pearsonr(x, direction @ a).statistic


def record(rng, dimension=2, count=300):
    """Joint acceleration and a tool acceleration partly driven by it."""
    x = rng.standard_normal(count)
    mixing = rng.standard_normal((dimension, dimension))
    return x, rng.standard_normal((dimension, 1)) * x + mixing @ rng.standard_normal(
        (dimension, count)
    )


def test_the_loop_is_the_correlation_along_every_angle(rng):
    x, a = record(rng)
    angles = np.linspace(-1, 4, 23)
    expected = [pearson(x, a, unit(angle)) for angle in angles]
    np.testing.assert_allclose(correlation_loop(x, a, angles), expected)


def test_the_loop_changes_sign_from_an_angle_to_its_opposite(rng):
    x, a = record(rng)
    angles = np.linspace(0, np.pi, 19)
    np.testing.assert_allclose(
        correlation_loop(x, a, angles + np.pi), -correlation_loop(x, a, angles), atol=1e-14
    )


def test_nothing_is_correlated_along_the_lowest_direction(rng):
    x, a = record(rng)
    phi0 = lowest_correlation_direction(x, a)
    assert 0 <= phi0 < math.pi
    assert pearson(x, a, unit(phi0)) == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("angle", np.radians([0.0, 15.0, 90.0, 134.0, 179.9]))
def test_a_slide_the_joint_does_not_drive_is_found_where_transmission_is_across_it(rng, angle):
    # Only when the arm moves the tool across the slide is there no bias.
    x, slide = rng.standard_normal((2, 400))
    x -= x.mean()
    slide -= slide.mean()
    slide -= x * (slide @ x) / (x @ x)
    a = np.outer(unit(angle + math.pi / 2), x) + 0.4 * np.outer(unit(angle), slide)
    turn = axial_difference(lowest_correlation_direction(x, a), float(angle))
    assert turn == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("scale", [0.5, 2.0, 8.0])
def test_scaling_the_driven_motion_leaves_the_lowest_direction(rng, scale):
    # Section 5.3.2 of the thesis: normal against uniform motion, 6000 points each.
    x, slide = rng.standard_normal(6000), rng.uniform(-1, 1, 6000)
    phi0 = lowest_correlation_direction(x, np.stack((scale * x, slide)))
    scatter = slide.std() / (scale * math.sqrt(6000))
    assert abs(axial_difference(phi0, math.pi / 2)) < 3 * scatter


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_maximum_is_the_multiple_correlation_of_x_on_a(rng, dimension):
    x, a = record(rng, dimension)
    design = np.vstack((a, np.ones(x.size))).T
    residual = x - design @ np.linalg.lstsq(design, x, rcond=None)[0]
    value, direction = maximum_correlation(x, a)
    assert value**2 == pytest.approx(1 - residual.var() / x.var())
    assert np.linalg.norm(direction) == pytest.approx(1)
    assert pearson(x, a, direction) == pytest.approx(value)


def test_no_direction_exceeds_the_maximum(rng):
    x, a = record(rng)
    loop = correlation_loop(x, a, np.linspace(0, 2 * np.pi, 3601))
    assert loop.max() <= maximum_correlation(x, a).value * (1 + 1e-12)
    assert loop.max() == pytest.approx(maximum_correlation(x, a).value, rel=1e-5)


def test_a_rigid_noise_free_tool_has_both_directions_well_defined(rng):
    x = rng.standard_normal(100)
    a = np.outer(unit(0.3), x)
    value, direction = maximum_correlation(x, a)
    assert value == pytest.approx(1)
    np.testing.assert_allclose(direction, unit(0.3))
    assert lowest_correlation_direction(x, a) == pytest.approx(0.3 + math.pi / 2)
    across = 0.3 + math.pi / 2
    assert correlation_loop(x, a, [across])[0] == 0.0


def test_covariances_computed_once_give_the_same(rng):
    x, a = record(rng)
    cov = covariances(x, a)
    assert lowest_correlation_direction_from(cov) == lowest_correlation_direction(x, a)
    assert maximum_correlation_from(cov).value == maximum_correlation(x, a).value
    np.testing.assert_array_equal(
        correlation_loop_from(cov, [0.0, 1.0]), correlation_loop(x, a, [0.0, 1.0])
    )


@pytest.mark.parametrize("function", [lowest_correlation_direction, maximum_correlation])
def test_no_direction_stands_out_of_uncorrelated_motion(function):
    with pytest.raises(InvalidData, match="uncorrelated"):
        function([1.0, -1.0, 1.0, -1.0], [[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])


def test_several_excited_joints_are_refused(rng):
    x, a = rng.standard_normal((2, 2, 20))
    with pytest.raises(InvalidData, match="2 rows"):
        lowest_correlation_direction(x, a)


@pytest.mark.parametrize("function", [lowest_correlation_direction])
def test_an_angle_needs_a_planar_record(rng, function):
    x, a = record(rng, 3)
    with pytest.raises(InvalidData, match="3 rows"):
        function(x, a)


def test_angles_must_be_finite(rng):
    with pytest.raises(InvalidData, match="angles"):
        correlation_loop(*record(rng), [0.0, math.inf])
