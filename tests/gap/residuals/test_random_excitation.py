"""Runs of random excitation: a right model meets the measured features within their scales."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.random_excitation.features import FeatureSettings, RandomFeatures
from loose_env.gap.residuals.random_excitation.frequency_response import CommandResponse
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR, mujoco

RATE, COUNT = 1000.0, 6000
FLOORS = np.array([0.02, 0.05, 0.05])
CHANNELS = (Channel("sensor.encoder"), Channel("sensor.shake", 0), Channel("sensor.shake", 1))


def command(rng: np.random.Generator) -> Array:
    """Noise between 4 and 100 Hz that grows from rest (T, 1)."""
    band = signal.butter(4, (4.0, 100.0), "bandpass", fs=RATE, output="sos")
    noise = signal.sosfilt(band, rng.normal(size=COUNT + 500))[500:]
    return (noise / noise.std() * np.minimum(np.arange(COUNT) / 300, 1))[:, None]


def response(commands: Array, *, gain: float = 1.0, late: int = 0, mode: float = 12.0) -> Array:
    """A servo mode [Hz] seen by an encoder and by two axes of an accelerometer (T, 3)."""
    w = 2 * np.pi * mode
    system = signal.cont2discrete(([w * w], [1, 0.8 * w, w * w]), 1 / RATE, "zoh")
    place = signal.lfilter(np.ravel(system[0]), system[1], np.roll(commands[:, 0], late))
    bend = np.gradient(np.gradient(place)) * 400
    return np.stack([0.3 + gain * place, 9.8 + bend, 0.3 * bend], axis=1)


def impacts(rng: np.random.Generator, *, size: float = 1.0, along: float = 0.7) -> Array:
    """Knocks at random times that ring down, along one direction of the accelerometer (T, 3)."""
    times = (rng.random(COUNT) < 0.02) * rng.normal(size=COUNT) * size
    ring = np.exp(-np.arange(60) / 8) * np.sin(2 * np.pi * 130 * np.arange(60) / RATE)
    knock = np.convolve(times, ring)[:COUNT]
    return np.stack([0.02 * knock, along * knock, np.sqrt(1 - along**2) * knock], axis=1)


def noise(rng: np.random.Generator) -> Array:
    """Of the sensors (T, 3)."""
    return rng.normal(size=(COUNT, 3)) * FLOORS


def features(values: Array, commands: Array, **settings: float) -> RandomFeatures:
    """Of a measured run."""
    return RandomFeatures(
        values, rate=RATE, commands=commands, floors=FLOORS, channels=CHANNELS,
        settings=FeatureSettings(**settings),
    )  # fmt: skip


def of_kind(found: RandomFeatures, *words: str) -> NDArray[np.intp]:
    """Numbers of the features whose names begin with one of the words."""
    return np.array([k for k, name in enumerate(found.names) if name.startswith(words)])


def test_a_right_smooth_model_differs_by_its_scales() -> None:
    rng = np.random.default_rng(1)
    apart = []
    for _ in range(40):
        u = command(rng)
        true = response(u)
        apart.append(features(true + noise(rng), u).differences(true))
    apart = np.array(apart)
    found = features(true + noise(rng), u)
    for words in (("mean",), ("gain", "phase"), ("covariance", "skewness", "kurtosis")):
        own = apart[:, of_kind(found, *words)]
        assert 0.75 < own.std() < 1.25, words
        assert np.abs(own.mean()) < 0.25, words
    assert np.abs(apart).max() < 5
    # The error of the noise floor is in the scale, and not in these runs.
    assert np.sqrt(np.mean(apart[:, of_kind(found, "rest")] ** 2)) < 1.0


def test_a_right_model_with_impacts_differs_by_its_scales() -> None:
    rng = np.random.default_rng(2)
    apart, whitened = [], []
    for _ in range(40):
        u = command(rng)
        found = features(response(u) + impacts(rng) + noise(rng), u)
        apart.append(found.differences(response(u) + impacts(rng)))
        whitened.append(found.whitened(apart[-1]))
    for words in (("mean",), ("gain", "phase"), ("rest", "covariance"), ("skewness", "kurtosis")):
        own = np.array(apart)[:, of_kind(found, *words)]
        assert 0.6 < own.std() < 1.4, words
    assert 0.7 < np.std(whitened) < 1.4
    assert np.abs(apart).max() < 6


def test_what_is_wrong_shows_in_the_features_that_it_moves() -> None:
    rng = np.random.default_rng(3)
    u = command(rng)
    found = features(response(u) + noise(rng), u)

    def worst(values: Array) -> tuple[str, float]:
        apart = np.abs(found.differences(values))
        return found.names[int(np.argmax(apart))], float(apart.max())

    assert worst(response(u))[1] < 4
    name, size = worst(response(u, gain=1.05))
    assert name.startswith("gain") and "encoder" in name and size > 8
    name, size = worst(response(u, late=2))
    assert name.startswith("phase") and size > 20
    name, size = worst(response(u) + np.array([0.0, 0.02, 0.0]))
    assert name == "mean of sensor.shake.x" and size > 10
    assert worst(response(u, mode=13.0))[1] > 20
    # Impacts that were not measured.
    apart = found.differences(response(u) + impacts(rng))
    assert np.abs(apart[of_kind(found, "rest above")]).max() > 8
    assert np.abs(apart[of_kind(found, "kurtosis")]).max() > 8


def test_impacts_of_another_direction_and_size_show() -> None:
    rng = np.random.default_rng(4)
    u = command(rng)
    found = features(response(u) + impacts(rng) + noise(rng), u)
    apart = found.differences(response(u) + impacts(rng, along=-0.7))
    assert np.abs(apart[of_kind(found, "covariance")]).max() > 4
    apart = found.differences(response(u) + impacts(rng, size=0.3))
    assert np.abs(apart[of_kind(found, "rest")]).max() > 4


def test_noise_is_added_to_simulated_readings_alone() -> None:
    rng = np.random.default_rng(5)
    u = command(rng)
    values = response(u) + noise(rng)
    found = features(values, u)
    np.testing.assert_allclose(found.of(values, noisy=True), found.measured, rtol=1e-9)
    rest = of_kind(found, "rest")
    assert (found.of(values)[rest] - found.measured[rest] > 0.5).all()


def test_wild_simulations_give_no_features() -> None:
    rng = np.random.default_rng(8)
    u = command(rng)
    values = response(u)
    values[3000:] = np.nan
    assert np.isnan(features(response(u) + noise(rng), u).of(values)).all()


def test_a_trial_names_its_excited_joints() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR))
    rng = np.random.default_rng(11)
    u = command(rng)
    controls = np.zeros((2 * COUNT - 1, 3))
    controls[:, 1] = np.repeat(u[:, 0], 2)[: 2 * COUNT - 1]
    trial = Trial(
        name="run.csv", form="forward", time=np.arange(COUNT) / RATE,
        measured=response(u) + noise(rng), step=0.5 / RATE, steps=2 * COUNT - 1,
        controls=controls, position=np.zeros(3), speed=np.zeros(3), resting=True,
        excited=("joint2",),
    )  # fmt: skip
    found = RandomFeatures.of_trial(trial, machine, CHANNELS, FLOORS)
    same = features(trial.measured, u)
    np.testing.assert_allclose(found.measured, same.measured, rtol=1e-6, atol=1e-9)
    other = Trial(**{**vars(trial), "excited": ("elbow",)})
    with pytest.raises(InvalidData, match="elbow"):
        RandomFeatures.of_trial(other, machine, CHANNELS, FLOORS)


def test_what_cannot_be_used_is_refused() -> None:
    rng = np.random.default_rng(12)
    u = command(rng)
    values = response(u) + noise(rng)
    with pytest.raises(InvalidData, match="do not fit"):
        RandomFeatures(values, rate=RATE, commands=u, floors=FLOORS[:2])
    with pytest.raises(InvalidData, match="constant"):
        features(values, np.zeros_like(u))
    with pytest.raises(InvalidData, match="at least"):
        features(values[:50], u[:50])
    with pytest.raises(InvalidData, match="nothing can be compared"):
        features(np.full_like(values, np.nan), u)
    with pytest.raises(InvalidSetting, match="chaos"):
        FeatureSettings(chaos=2.0)


def test_the_command_explains_a_resonant_response() -> None:
    rng = np.random.default_rng(13)
    u = command(rng)
    split = CommandResponse(u, RATE)
    true = response(u)
    quiet = split.incoherent(true).density.mean(axis=0)
    assert (quiet < 1e-4 * true.var(axis=0)).all()
    loud = split.incoherent(true + noise(rng)).density.mean(axis=0)
    np.testing.assert_allclose(loud, FLOORS**2, rtol=0.1)


def test_a_channel_on_one_value_is_left_out() -> None:
    rng = np.random.default_rng(9)
    commands = command(rng)
    values = response(commands) + impacts(rng) + noise(rng)
    values[:, 0] = 0.25  # the encoder of a braked joint
    assert list(features(values, commands).used) == [1, 2]
    with pytest.raises(InvalidData, match="no channel varies"):
        features(np.full((COUNT, 3), 0.25), commands)
