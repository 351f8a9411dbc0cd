"""Scatter by formula, and the record it asks for."""

import math

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import (
    axial_difference,
    bandpass,
    direction_sd,
    lowest_correlation_direction,
    record_length_for,
)


def flat_record(rng, rate, seconds, band, correlation):
    """Tool moving alike in both directions, correlated with x along its own x axis."""
    count = round(rate * seconds)
    signals = bandpass(rng.standard_normal((3, count)), rate, band)
    signals /= signals.std(axis=1, keepdims=True)
    x, along, across = signals
    rest = math.sqrt(1 - correlation**2)
    return x, np.stack((correlation * x + rest * along, across))


def test_1_2_s_of_350_hz_at_a_correlation_of_0_4_gives_ten_degrees(rng):
    sds = [
        direction_sd(*flat_record(rng, 2000.0, 1.2, (1.0, 350.0), 0.4), 2000.0) for _ in range(20)
    ]
    expected = math.degrees(1.96 / (0.4 * math.sqrt(2 * 349 * 1.2)))
    assert expected == pytest.approx(9.7, abs=0.1)
    assert math.degrees(1.96 * np.median(sds)) == pytest.approx(expected, rel=0.05)


def test_the_formula_predicts_the_scatter_of_the_direction(rng):
    errors, sds = [], []
    for _ in range(400):
        x, a = flat_record(rng, 1000.0, 1.2, (30.0, 150.0), 0.7)
        errors.append(axial_difference(lowest_correlation_direction(x, a), math.pi / 2))
        sds.append(direction_sd(x, a, 1000.0))
    # 400 repetitions know the scatter to 3.5 %.
    assert np.mean(sds) == pytest.approx(np.std(errors), rel=0.12)


def test_the_record_asked_for_has_the_scatter_wanted(rng):
    band, wanted = (30.0, 150.0), math.radians(2.0)
    x, a = flat_record(rng, 1000.0, 1.2, band, 0.7)
    seconds = record_length_for(wanted, x, a, 1000.0)
    longer = flat_record(rng, 1000.0, seconds, band, 0.7)
    assert direction_sd(*longer, 1000.0) == pytest.approx(wanted, rel=0.15)


def test_half_the_scatter_needs_four_times_the_record(rng):
    x, a = flat_record(rng, 1000.0, 1.2, (30.0, 150.0), 0.7)
    sd = direction_sd(x, a, 1000.0)
    assert record_length_for(sd, x, a, 1000.0) == pytest.approx(1.2)
    assert record_length_for(sd / 2, x, a, 1000.0) == pytest.approx(4.8)


def test_a_rigid_noise_free_tool_leaves_no_doubt(rng):
    x = rng.standard_normal(100)
    assert direction_sd(x, [x, 2 * x], 1000.0) == 0.0


def test_an_uncorrelated_tool_leaves_every_doubt():
    x, a = [1.0, -1.0, 1.0, -1.0], [[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]]
    assert direction_sd(x, a, 1000.0) == math.inf


def test_settings_and_records_that_cannot_be_used_are_refused(rng):
    x, a = rng.standard_normal(100), rng.standard_normal((2, 100))
    with pytest.raises(InvalidSetting, match="sd_wanted"):
        record_length_for(0.0, x, a, 1000.0)
    with pytest.raises(InvalidData, match="rate"):
        direction_sd(x, a, 0.0)
    with pytest.raises(InvalidData, match="3 rows"):
        direction_sd(x, rng.standard_normal((3, 100)), 1000.0)
