"""The simulated motions of chapter 5 and what is found in them."""

from __future__ import annotations

import math
from importlib import import_module

import numpy as np
import pytest

from loose_env.statistics import axial_difference, correlation_loop, lowest_correlation_direction
from loose_env.thesis.ch5_simulation import correlation as correlation_simulations
from loose_env.thesis.ch5_simulation import simulations
from loose_env.thesis.ch5_simulation.correlation import scaled_normal, uniform_across
from loose_env.thesis.ch5_simulation.distribution_matching import (
    ANGLE,
    HALF_WIDTH,
    Case,
    exact_surface,
    far_success,
    near_errors,
    planar_study,
    ridge_samples,
    spatial_study,
)
from loose_env.thesis.ch5_simulation.tool_motion import (
    card,
    draw_motions,
    motion_words,
    transitions,
)
from loose_env.thesis.printed import printed


@pytest.fixture(scope="module")
def correlations():
    return correlation_simulations.section(0)


def test_printed_accuracy_holds_on_the_model_itself():
    surface, truth = exact_surface()
    told = printed("simulations")["matching"]
    errors = near_errors(surface, truth, told["trial_values_within_percent"] / 100)
    assert errors.shape == (8, 3)
    assert 100 * np.abs(errors).max() < told["parameter_error_percent"]
    share, by_offset = far_success(surface, truth)
    assert 0.5 < share < 1.0
    assert by_offset[:6].min() == 1.0 > by_offset[6:].min()


def test_sparse_histograms_do_not_carry_the_printed_accuracy():
    few = planar_study(Case(name="few", trials=100, bins=10, sets=8), [1, 1], 0.1)
    many = planar_study(Case(name="many", trials=6000, bins=30, sets=3), [1, 2], 0.1)
    assert np.median(np.abs(few.near[:, 1])) > 0.1
    assert np.median(np.abs(many.near[:, 1])) < 0.1
    assert many.searched == 1.0 > few.searched
    assert many.searched_error < few.searched_error


def test_spatial_study_finds_the_direction():
    found = spatial_study(Case(name="many", trials=6000, bins=10, sets=2), [1, 3])
    assert found.errors.shape == (2, 4)
    assert np.degrees(np.median(found.searched)) < 4.0


def test_ridge_samples_have_the_variances_of_their_components():
    motion = ridge_samples(100_000, np.random.default_rng(2))
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    rotated = np.array([[c, s], [-s, c]]) @ motion
    np.testing.assert_allclose(np.cov(rotated), np.diag([1.0, HALF_WIDTH**2 / 3]), atol=0.03)


def test_motion_words_and_tables(monkeypatch):
    monkeypatch.setattr("loose_env.thesis.ch5_simulation.tool_motion.SAMPLES", 20_000)
    from loose_env.thesis.ch5_simulation.tool_motion import KINDS

    motions = {name: draw_motions(draw, 0, 10 * k) for k, (name, draw) in enumerate(KINDS)}
    table = np.array([[1, 1, 0], [1, 2, 1], [0, 1, 1]]) / 8
    words = motion_words(motions, table, printed("simulations"))
    assert any("agree with the derivative" in line for line in words)
    assert any("0.0000 at most" in line for line in words)
    assert transitions(table, printed("simulations")).rows[1][-2:] == ("0.5000", "0.5")
    picture = card(motions["displacement"], "displacement", "5.6", 1e3, "mm")
    assert len(picture.image.axes) == 6


def test_loop_of_the_scaled_normal_is_the_closed_form():
    x, a = scaled_normal(200_000, 4.0, np.random.default_rng(3))
    phi = np.linspace(0.0, math.pi, 19)
    expected = 2 * np.cos(phi) / np.sqrt(4 * np.cos(phi) ** 2 + np.sin(phi) ** 2)
    np.testing.assert_allclose(correlation_loop(x, a, phi), expected, atol=0.012)


def test_direction_error_of_a_wide_uniform_is_sampling_error():
    """Its deviation is (half range / sqrt 3) / (sd sqrt N); its mean stays at zero."""
    errors = []
    for k in range(200):
        x, a = uniform_across(1000, 5.0, 1.0, np.random.default_rng([4, k]))
        errors.append(axial_difference(lowest_correlation_direction(x, a), math.pi / 2))
    predicted = 5.0 / math.sqrt(3.0) / math.sqrt(1000)
    assert np.std(errors) == pytest.approx(predicted, rel=0.15)
    assert abs(np.mean(errors)) < 4 * predicted / math.sqrt(200)


def test_correlation_section(correlations):
    assert correlations.key == "correlation_simulations"
    assert len(correlations.tables) == 2 and len(correlations.cards) == 2
    errors = [float(row[2].removesuffix("°")) for row in correlations.tables[0].rows]
    assert errors == sorted(errors, reverse=True)
    assert any("leaves the direction as it is" in words for words in correlations.words)


def test_equations_name_functions(correlations):
    named = {**simulations.EQUATIONS, **correlations.equations}
    for path in named.values():
        module, _, name = path.rpartition(".")
        assert callable(getattr(import_module(module), name))
    wanted = ["3.70", "3.71", *(f"4.{k}" for k in range(1, 16)), *(f"5.{k}" for k in range(1, 7))]
    assert sorted(named) == sorted(wanted)
