"""The rigs of Experiments Two and Three show what the thesis saw of them."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest
from scipy.signal import csd, welch

from loose_env.thesis.ch6_experiments.slide.directions import angles
from loose_env.thesis.ch6_experiments.slide.experiments_two_three import section
from loose_env.thesis.ch6_experiments.slide.records import (
    RESOLVER_UNIT,
    SlideRecords,
    slide_records,
)
from loose_env.thesis.ch6_experiments.slide.velocities import velocity_correlations
from loose_env.thesis.methods.motion.signals import line_of_motion
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section


@pytest.fixture(scope="module")
def records() -> SlideRecords:
    return slide_records(1)


@pytest.fixture(scope="module")
def done() -> Section:
    return section(1)


def test_the_dominant_frequency_is_where_slide_and_coil_part(records):
    # The force is flat to 2 kHz, so a dominant frequency comes from the stinger: there the slide
    # lies against the coil, well below it the two move as one.
    frequency, power = welch(records.x[0], records.rate, nperseg=4096)
    peak = int(np.argmax(power))
    beside = np.median(power[(frequency > 200) & (frequency < 400)])
    assert power[peak] > 20 * beside
    frequency, cross = csd(records.shaker[0], records.x[0], records.rate, nperseg=4096)
    phase = np.degrees(np.abs(np.angle(cross)))
    assert phase[peak] > 165.0
    assert np.median(phase[(frequency > 80) & (frequency < 200)]) < 15.0


def test_across_the_motion_the_bench_shows_its_own_peaks(records):
    # 90 degrees: the first accelerometer lies across the rails.
    frequency, power = welch(records.x[-1], records.rate, nperseg=8192)
    beside = np.median(power[(frequency > 65) & (frequency < 85)])
    for peak in printed("signals")["bench_peaks_hz"]:
        near = (frequency > peak - 4) & (frequency < peak + 4)
        assert power[near].max() > 4 * beside


def test_the_cube_reads_the_motion_at_its_angle(records):
    found = angles(records, (2.0, 200.0))
    off = np.abs(found.by_rms - found.alpha)
    inside = (found.alpha >= 15) & (found.alpha <= 75)
    assert off[inside].max() < 2.0
    assert off[[0, -1]].min() > off[inside].max()
    assert found.correlation[9] > 0.98


def test_sums_of_both_rules_correlate_alike_and_steps_do_not():
    rng = np.random.default_rng(2)
    t = np.arange(20_000) / 10_000
    wave = np.sin(2 * np.pi * 710 * t)
    x, y = wave + 0.1 * rng.standard_normal((2, len(t)))
    # Power 1/2 against 0.01: r = 0.98 of the accelerations themselves.
    assert line_of_motion(x, y).correlation == pytest.approx(0.98, abs=0.003)
    found = velocity_correlations(x, y, 10_000.0, 0.04)
    assert found["two_point", "summed"] == pytest.approx(found["newton_cotes", "summed"], abs=0.05)
    # One step multiplies the wave by |H(710 Hz)| and the noise by 1.58 or 3.72.
    for rule, weights in (("two_point", [1.5, -0.5]), ("newton_cotes", [55, -59, 37, -9])):
        w = np.array(weights, dtype=float) / sum(weights)
        gain = abs(np.sum(w * np.exp(2j * np.pi * 0.071 * np.arange(len(w)))))
        wanted = gain**2 / 2 / (gain**2 / 2 + 0.01 * np.sum(w**2))
        assert found[rule, "step by step"] == pytest.approx(wanted, abs=0.02)


def test_the_resolver_turns_in_whole_units_and_lags_by_the_play():
    from loose_env.thesis.ch6_experiments.slide.records import GEAR_PLAY, resolver_records

    found = resolver_records(1)
    assert found.resolver.dtype == np.float64
    np.testing.assert_array_equal(found.resolver, np.round(found.resolver))
    away = (found.resolver + 0.5) * RESOLVER_UNIT - found.angle
    assert np.abs(away).max() < GEAR_PLAY / 2 + 0.6 * RESOLVER_UNIT
    assert np.ptp(found.resolver) * RESOLVER_UNIT < np.ptp(found.angle)


def test_the_section_is_whole_and_repeats(done):
    again = section(1)
    assert list(done.words) == list(again.words)
    assert [t.rows for t in done.tables] == [t.rows for t in again.tables]
    assert len(done.cards) == 4
    assert "nan" not in " ".join(
        [*done.words, *(c for t in done.tables for r in t.rows for c in r)]
    )


def test_every_equation_names_a_function(done):
    for place in done.equations.values():
        module, _, name = place.rpartition(".")
        assert callable(getattr(import_module(module), name))
