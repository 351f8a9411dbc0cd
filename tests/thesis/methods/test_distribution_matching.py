"""Fit of a Gaussian ridge to histograms whose truth is known."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from loose_env.errors import InvalidData, MissingExtra
from loose_env.statistics import axial_difference
from loose_env.thesis.methods.motion.distribution_matching import (
    MatchSettings,
    match_planar,
    match_spatial,
    search_planar,
    search_spatial,
)
from loose_env.thesis.methods.motion.gaussian_ridge import (
    along,
    exponent_from_sd,
    hemisphere,
    planar_ridge,
    planar_trial,
    rotation,
    sd_from_exponent,
    spatial_ridge,
    spatial_trial,
    to_plane,
    variance_trial,
)
from loose_env.thesis.methods.motion.histogram import Histogram, histogram

TRUTH = np.array([10.0, -0.5, 0.6])


def grid(dimension, bins=16, reach=4.0):
    shape = (bins,) * dimension
    low = np.full(dimension, -reach)
    return Histogram(counts=np.ones(shape), low=low, width=2 * reach / bins)


def surface():
    empty = grid(2)
    heights = planar_ridge(empty.points(), TRUTH)
    return replace(empty, counts=heights.reshape(empty.counts.shape))


def samples(count, rng, half=3.0):
    gauss, flat = rng.standard_normal(count), rng.uniform(-half, half, count)
    c, s = math.cos(0.6), math.sin(0.6)
    return np.stack([c * gauss - s * flat, s * gauss + c * flat])


@pytest.mark.parametrize("weights", ["sampling", "unit"])
@pytest.mark.parametrize("factors", [(1.1, 1.1, 1.1), (0.9, 0.9, 0.9), (1.1, 0.9, 1.1)])
def test_printed_accuracy_from_trial_values_within_ten_percent(weights, factors):
    match = match_planar(surface(), TRUTH * factors, MatchSettings(weights=weights))
    assert match.converged
    np.testing.assert_allclose(match.parameters, TRUTH, rtol=1e-3)
    assert match.sd[0] == pytest.approx(1.0, rel=1e-3)
    np.testing.assert_allclose(match.direction, [-math.sin(0.6), math.cos(0.6)], atol=1e-3)


def test_one_start_at_right_angles_fails_and_several_do_not():
    right = search_planar(surface(), starts=6)
    wrong = match_planar(surface(), planar_trial(surface(), 0.6 + math.pi / 2))
    np.testing.assert_allclose(right.parameters, TRUTH, rtol=1e-3)
    assert abs(axial_difference(float(wrong.parameters[2]), 0.6)) > 1.0
    assert right.residual < 1e-6 * wrong.residual
    assert right.starts == 6 and wrong.starts == 1


def test_direction_of_samples():
    for k in range(3):
        data = histogram(samples(6000, np.random.default_rng([7, k])), bins=30)
        match = search_planar(data, starts=6)
        assert abs(math.degrees(axial_difference(float(match.parameters[2]), 0.6))) < 2.5
        assert match.sd[0] == pytest.approx(1.0, abs=0.1)


def test_match_does_not_depend_on_the_unit():
    motion = samples(2000, np.random.default_rng(8))
    metre = match_planar(data := histogram(motion, 20), planar_trial(data, 0.5))
    tiny = match_planar(data := histogram(1e-4 * motion, 20), planar_trial(data, 0.5))
    np.testing.assert_allclose(tiny.parameters, metre.parameters * [1, 1e8, 1], rtol=1e-4)
    assert tiny.residual == pytest.approx(metre.residual, rel=1e-6)


def test_spatial_surface_is_found_with_its_covariance():
    truth = np.array([50.0, 0.7, 0.2, 1.1, 0.5, 0.6])
    empty = grid(3, bins=9)
    column = replace(empty, counts=spatial_ridge(empty.points(), truth).reshape(9, 9, 9))
    match = search_spatial(column, starts=6)
    assert abs(match.direction @ rotation(0.5, 0.6)[2]) == pytest.approx(1.0, abs=1e-9)
    root = np.array([[0.7, 0.0], [0.2, 1.1]])
    sd = np.sqrt(np.linalg.eigvalsh(np.linalg.inv(root @ root.T)))[::-1]
    np.testing.assert_allclose(match.sd, sd, rtol=1e-3)


def test_spatial_direction_of_samples():
    rng, frame = np.random.default_rng(9), rotation(0.5, 0.6)
    motion = np.vstack([rng.standard_normal((2, 6000)), rng.uniform(-3, 3, 6000)])
    data = histogram(frame.T @ motion, bins=12)
    match = match_spatial(data, spatial_trial(data, frame[2] + 0.5 * frame[0]))
    assert math.degrees(math.acos(min(1.0, abs(match.direction @ frame[2])))) < 3.0


def test_trial_variance_of_a_round_motion():
    rng = np.random.default_rng(10)
    for dimension in (2, 3):
        data = histogram(0.5 * rng.standard_normal((dimension, 100_000)), bins=60)
        assert variance_trial(data) == pytest.approx(0.25, rel=0.03)
    flat = histogram(0.5 * rng.standard_normal((2, 100_000)), bins=60)
    # Equation 4.9 with the sum of the counts: a1 = -(mean squared distance)^-1.
    squared = np.sum(flat.points() ** 2, axis=0) @ flat.counts.ravel() / flat.counts.sum()
    np.testing.assert_allclose(planar_trial(flat, 0.3), [flat.counts.max(), -1 / squared, 0.3])


def test_models():
    assert sd_from_exponent(exponent_from_sd(0.3)) == pytest.approx(0.3)
    points = np.random.default_rng(11).standard_normal((2, 20))
    expected = 3.0 * np.exp(-0.7 * along(points, 0.4) ** 2)
    np.testing.assert_allclose(planar_ridge(points, [3.0, -0.7, 0.4]), expected)
    frame = rotation(0.7, -0.4)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(
        to_plane(frame[2][:, None], 0.7, -0.4).ravel(), [0, 0, 1], atol=1e-12
    )
    # The column's height does not change along its axis, and falls as its covariance says.
    b = [2.0, 0.8, 0.3, 1.2, 0.7, -0.4]
    shifted = [spatial_ridge((u * frame[2])[:, None], b)[0] for u in (0.0, 5.0)]
    assert shifted == pytest.approx([2.0, 2.0])
    root = np.array([[0.8, 0.0], [0.3, 1.2]])
    p = np.array([0.4, -0.9])
    height = spatial_ridge((frame.T @ [*p, 1.0])[:, None], b)[0]
    assert height == pytest.approx(2.0 * math.exp(-0.5 * p @ root @ root.T @ p))


def test_hemisphere_covers_all_axes():
    vectors = hemisphere(50)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=0), 1.0)
    axes = np.random.default_rng(12).standard_normal((3, 2000))
    axes /= np.linalg.norm(axes, axis=0)
    nearest = np.degrees(np.arccos(np.abs(axes.T @ vectors).max(axis=1).clip(max=1.0)))
    assert nearest.max() < 20.0


def test_empty_bins_change_the_match():
    data = histogram(samples(6000, np.random.default_rng(13)), bins=20)
    trial = planar_trial(data, 0.6 + 0.5)
    filled = match_planar(data, trial)
    everything = match_planar(data, trial, MatchSettings(bins="all", iterations=30))
    error = [abs(axial_difference(float(m.parameters[2]), 0.6)) for m in (filled, everything)]
    assert error[0] < math.radians(5.0) < math.radians(10.0) < error[1]


def test_wrong_input():
    data = surface()
    with pytest.raises(InvalidData, match="too few"):
        match_planar(replace(data, counts=np.eye(16)[:1].T @ np.eye(16)[:1]), TRUTH)


def test_missing_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "odrpack", None)
    with pytest.raises(MissingExtra, match=r"loose-env\[report\]"):
        match_planar(surface(), TRUTH)
