"""Band limits, differentiation, spectra, delay and long-run variance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal as scipy_signal

from loose_env.errors import InvalidData
from loose_env.statistics import (
    acceleration_from_angle,
    bandpass,
    long_run_variance,
    phase_delay,
)

RATE = 1000.0
BAND = (30.0, 150.0)


def wave(frequency, count=1200, phase=0.3):
    return np.cos(2 * np.pi * frequency * np.arange(count) / RATE + phase)


@pytest.mark.parametrize("frequency", [30.0, 30 + 1000 / 1200, 90.0, 150.0])
def test_what_lies_in_the_band_passes_unchanged(frequency):
    np.testing.assert_allclose(bandpass(wave(frequency), RATE, BAND), wave(frequency), atol=1e-12)


@pytest.mark.parametrize("frequency", [0.0, 30 - 1000 / 1200, 150 + 1000 / 1200, 500.0])
def test_what_lies_outside_the_band_is_dropped(frequency):
    np.testing.assert_allclose(bandpass(wave(frequency), RATE, BAND), 0, atol=1e-12)


@pytest.mark.parametrize("count", [1199, 1200])
def test_the_whole_band_is_the_signal_itself(rng, count):
    noise = rng.standard_normal((2, 3, count))
    np.testing.assert_allclose(bandpass(noise, RATE, (0.0, 500.0)), noise, atol=1e-12)


def test_nothing_is_shifted_in_time():
    pulse = np.zeros(1201)
    pulse[600] = 1.0
    passed = bandpass(pulse, RATE, BAND)
    assert np.argmax(passed) == 600
    np.testing.assert_allclose(passed, passed[::-1], atol=1e-15)


def test_the_ends_of_the_band_stay_in_whatever_their_rounding():
    # 0.1 Hz is not a binary fraction; the bin lies exactly on it all the same.
    count, rate = 1000, 10.0
    slow = np.cos(2 * np.pi * 0.1 * np.arange(count) / rate)
    np.testing.assert_allclose(bandpass(slow, rate, (0.1, 0.3)), slow, atol=1e-12)


@pytest.mark.parametrize("band", [BAND, (0.0, 500.0)])
def test_acceleration_of_waves_is_exact_and_aligned(band):
    angle = 2 * wave(50.0, 1202) - 3 * wave(120.0, 1202, 1.0)
    exact = -((2 * np.pi) ** 2) * (
        2 * 50.0**2 * wave(50.0, 1202) - 3 * 120.0**2 * wave(120.0, 1202, 1.0)
    )
    np.testing.assert_allclose(
        acceleration_from_angle(angle, RATE, band), exact[1:-1], rtol=1e-9, atol=1e-6
    )


def test_slow_drift_does_not_leak_into_the_acceleration():
    t = np.arange(1202) / RATE
    angle = 1e-4 * wave(80.0, 1202)
    drift = 0.2 * t + 0.1 * t**2
    np.testing.assert_allclose(
        acceleration_from_angle(angle + drift, RATE, BAND),
        acceleration_from_angle(angle, RATE, BAND),
        atol=1e-5,
    )
    # The same drift differentiated in frequency alone would swamp the 25 rad/s^2 of motion.
    leak = bandpass(drift, RATE, BAND)
    assert np.abs(leak).max() * (2 * np.pi * 80) ** 2 > 100


def test_acceleration_keeps_to_its_band():
    angle = wave(20.0, 1202) + wave(200.0, 1202)
    assert np.abs(acceleration_from_angle(angle, RATE, BAND)).max() < 1e-6


def test_joints_are_differentiated_row_by_row(rng):
    angles = rng.standard_normal((3, 302))
    together = acceleration_from_angle(angles, RATE, BAND)
    assert together.shape == (3, 300)
    np.testing.assert_allclose(together[1], acceleration_from_angle(angles[1], RATE, BAND))


@pytest.mark.parametrize(
    ("signal", "rate", "band", "said"),
    [
        *[
            (np.ones(200), RATE, band, "band")
            for band in [(-1.0, 50.0), (50.0, 30.0), (50.0, 50.0), (30.0, 500.1), (np.nan, 50.0)]
        ],
        (np.ones(100), RATE, (11.0, 19.0), "holds no frequency"),
        *[(np.ones(100), rate, BAND, "rate") for rate in (0.0, -1.0, math.nan)],
        ([1.0, 2.0, 3.0], RATE, BAND, "samples"),
        ([1.0] * 50 + [math.nan], RATE, BAND, "NaN"),
        (3.0, RATE, BAND, "shape"),
    ],
)
def test_signals_and_bands_that_cannot_be_used_are_refused(signal, rate, band, said):
    for function in (bandpass, acceleration_from_angle):
        with pytest.raises(InvalidData, match=said):
            function(signal, rate, band)


def test_an_angle_loses_two_samples_and_needs_four_more(rng):
    with pytest.raises(InvalidData, match="5 samples"):
        acceleration_from_angle(rng.standard_normal(5), RATE, (0.0, 500.0))


LINES = np.linspace(5.0, 100.0, 80)


def turned(seconds: float, sign: int = 1) -> np.ndarray:
    """Cross-spectrum of a signal and the same one late, of uneven size."""
    size = np.linspace(0.1, 3.0, len(LINES))
    return np.asarray(sign * size * np.exp(-2j * np.pi * LINES * seconds))


@pytest.mark.parametrize("seconds", [-0.0199, -3e-4, 0.0, 1e-5, 4.2e-3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_delay_and_a_sign_are_found_exactly(seconds: float, sign: int) -> None:
    found = phase_delay(
        LINES, turned(seconds, sign), np.ones(len(LINES)), largest=0.03, either_sign=True
    )
    assert found is not None
    assert found.seconds == pytest.approx(seconds, abs=1e-9)
    assert found.sign == sign and found.fit == pytest.approx(1.0)
    assert found.rival < 0.8


def test_the_standard_deviation_is_that_of_repeated_estimates() -> None:
    rng = np.random.default_rng(0)
    errors, sds = [], []
    for _ in range(200):
        phases = np.exp(1j * rng.normal(0.0, 0.3, len(LINES)))
        found = phase_delay(
            LINES, turned(2e-3) * phases, np.ones(len(LINES)), largest=0.03, either_sign=False
        )
        assert found is not None
        errors.append(found.seconds - 2e-3)
        sds.append(found.sd)
    assert np.mean(sds) == pytest.approx(np.std(errors), rel=0.2)


def test_lines_of_another_phase_hardly_move_the_delay() -> None:
    cross = turned(2e-3)
    cross[10:16] *= 1j  # a resonance between the two
    found = phase_delay(LINES, cross, np.ones(len(LINES)), largest=0.03, either_sign=False)
    assert found is not None and found.seconds == pytest.approx(2e-3, abs=1e-4)


def test_without_lines_or_beyond_the_search_there_is_no_delay() -> None:
    ones = np.ones(len(LINES))
    nothing = np.zeros(len(LINES), dtype=complex)
    assert phase_delay(LINES, nothing, ones, largest=0.03, either_sign=True) is None
    assert phase_delay(LINES, turned(1e-3), 0 * ones, largest=0.03, either_sign=True) is None
    assert phase_delay(LINES, turned(6e-3), ones, largest=5e-3, either_sign=False) is None


def test_a_single_line_leaves_the_delay_open() -> None:
    found = phase_delay(
        np.array([50.0]), np.array([1j]), np.ones(1), largest=0.05, either_sign=True
    )
    assert found is not None and found.rival > 0.95


def remembering(rng, memory, count=1200):
    """First-order series past its start."""
    noise = rng.standard_normal(count + 200)
    return scipy_signal.lfilter([1.0], [1.0, -memory], noise)[200:]


@pytest.mark.parametrize("memory", [-0.5, 0.0, 0.5, 0.8])
def test_the_long_run_variance_of_a_first_order_series_is_known(rng, memory):
    found = [long_run_variance(remembering(rng, memory)) for _ in range(200)]
    assert np.mean(found) == pytest.approx(1 / (1 - memory) ** 2, rel=0.1)


def test_a_series_of_zeros_has_no_scatter():
    assert long_run_variance(np.zeros(50)) == 0.0
