"""Sensors add what they say they add, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.rig import decimation_filter, low_passed, read_accelerometer, read_encoder
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.typing import Array

RATE, FACTOR, COUNT, FIRST = 1000.0, 5, 2000, 100
EXACT = Accelerometer(noise_density=0.0, resolution=0.0)


def read(
    true: Array, sensor: Accelerometer = EXACT, *, matrix: Array | None = None, seed: int = 0
) -> Array:
    """Readings of a true acceleration (3, steps), mixed by a matrix before it is filtered."""
    mixed = true if matrix is None else matrix @ true
    smooth = low_passed(mixed, sensor=sensor, factor=FACTOR, first=FIRST, count=COUNT, rate=RATE)
    drawn = np.random.default_rng(seed).standard_normal(smooth.shape)
    return read_accelerometer(smooth, sensor=sensor, rate=RATE, drawn=drawn)


def steps() -> Array:
    """Times of the simulation steps, zero at the first reading [s]."""
    return (np.arange(FIRST + FACTOR * COUNT + 50) - FIRST) / (RATE * FACTOR)


def wave(frequency: float, axis: int = 0) -> Array:
    true = np.zeros((3, len(steps())))
    true[axis] = np.sin(2 * np.pi * frequency * steps() + 0.3)
    return true


def gain(frequency: float) -> float:
    """Rms out over rms in."""
    return float(read(wave(frequency))[0].std() * np.sqrt(2))


@pytest.mark.parametrize("frequency", [30.0, 90.0, 150.0])
def test_the_band_passes_without_loss_or_delay(frequency: float) -> None:
    at = np.arange(COUNT) / RATE
    expected = np.sin(2 * np.pi * frequency * at + 0.3)
    np.testing.assert_allclose(read(wave(frequency))[0], expected, atol=3e-3)


def test_half_of_the_amplitude_is_left_at_the_bandwidth() -> None:
    assert gain(401.0) == pytest.approx(0.5, abs=0.02)
    taps = decimation_filter(FACTOR, 400.0, RATE)
    assert len(taps) == 8 * FACTOR + 1
    np.testing.assert_allclose(taps, taps[::-1])
    assert taps.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("frequency", [851.0, 901.0, 969.0, 1031.0, 1149.0])
def test_what_would_fold_into_the_band_is_kept_out(frequency: float) -> None:
    assert gain(frequency) < 2e-3


def test_a_steady_acceleration_is_read_as_it_is() -> None:
    true = np.tile([[1.0], [-2.0], [9.81]], len(steps()))
    np.testing.assert_allclose(read(true), np.tile([[1.0], [-2.0], [9.81]], COUNT), rtol=1e-12)


def test_the_matrix_mixes_the_axes() -> None:
    matrix = np.array([[1.02, 0.03, 0.0], [-0.05, 0.98, 0.4]])
    true = wave(40.0, 0) + 2 * wave(70.0, 1) + 3 * wave(110.0, 2)
    np.testing.assert_allclose(read(true, matrix=matrix), matrix @ read(true), atol=1e-12)


def test_noise_is_white_and_of_the_stated_density() -> None:
    sensor = Accelerometer(noise_density=2e-3, resolution=0.0)
    still = np.zeros((3, len(steps())))
    noise = np.concatenate([read(still, sensor, seed=s) for s in range(20)])
    assert noise.std() == pytest.approx(2e-3 * np.sqrt(RATE / 2), rel=0.01)
    # One-sided density: twice the squared lines over rate and count.
    density = np.sqrt(np.mean(2 * np.abs(np.fft.rfft(noise)[:, 1:-1]) ** 2, axis=0) / RATE / COUNT)
    for part in np.array_split(density, 5):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(2e-3, rel=0.03)
    assert abs(np.corrcoef(noise)[0, 1:]).max() < 5 / np.sqrt(COUNT)


def test_readings_are_whole_steps_of_the_digitiser() -> None:
    sensor = Accelerometer(noise_density=0.0, resolution=0.013)
    true = 5 * wave(37.0)
    exact, rounded = read(true), read(true, sensor)
    np.testing.assert_allclose(rounded / 0.013, np.round(rounded / 0.013), atol=1e-9)
    assert np.abs(rounded - exact).max() <= 0.0065 + 1e-12
    assert (rounded - exact)[0].std() == pytest.approx(0.013 / np.sqrt(12), rel=0.05)


def test_an_encoder_adds_its_noise_and_its_step() -> None:
    angle = np.linspace(-3, 3, 40_000).reshape(2, -1)
    drawn = np.random.default_rng(0).standard_normal(angle.shape)
    read_angle = read_encoder(angle, sensor=Encoder(resolution=1e-4, noise=3e-4), drawn=drawn)
    np.testing.assert_allclose(read_angle / 1e-4, np.round(read_angle / 1e-4), atol=1e-6)
    error = read_angle - angle
    assert error.std() == pytest.approx(np.hypot(3e-4, 1e-4 / np.sqrt(12)), rel=0.02)
    assert abs(error.mean()) < 4 * 3e-4 / np.sqrt(angle.size)


def test_ideal_sensors_add_nothing() -> None:
    suite = SensorSuite.ideal(rate=500.0 * 2)
    assert suite.rate == 1000.0
    angle = np.random.default_rng(0).normal(size=(2, 50))
    drawn = np.random.default_rng(1).standard_normal(angle.shape)
    np.testing.assert_array_equal(read_encoder(angle, sensor=suite.encoder, drawn=drawn), angle)
    still = np.zeros((3, len(steps())))
    assert not read(still, suite.accelerometer).any()


@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize(
    ("make", "name"),
    [
        (Accelerometer, "noise_density"),
        (Accelerometer, "bandwidth"),
        (Accelerometer, "resolution"),
        (Encoder, "resolution"),
        (Encoder, "noise"),
    ],
)
def test_figures_below_zero_or_not_finite_are_refused(make: Any, name: str, bad: float) -> None:
    with pytest.raises(
        InvalidSetting, match=rf"{make.__name__}\.{name} must be a finite number.*got {bad}"
    ):
        make(**{name: bad})


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_no_rate_is_refused(rate: float) -> None:
    with pytest.raises(InvalidSetting, match=f"SensorSuite.rate must be positive Hz; got {rate}"):
        SensorSuite(rate=rate)


def test_a_rate_too_low_for_the_accelerometer_is_refused() -> None:
    with pytest.raises(
        InvalidSetting, match=r"400.0 Hz needs a sampling rate above twice that.*800"
    ):
        SensorSuite(rate=800.0)
