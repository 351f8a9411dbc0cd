"""The seven alternatives where their answers are known."""

from dataclasses import replace

import numpy as np
import pytest

from loose_env.arms import planar, vera
from loose_env.faults import StructuralLooseness
from loose_env.thesis.methods.looseness.modelling_alternatives import (
    ALTERNATIVES,
    AlternativeSettings,
    Disagreement,
    compare_alternatives,
)

POSE = np.array([0.3, 1.2])
SHORT = AlternativeSettings(duration=0.5, slow_band=(2.0, 14.0))
LOOSE = StructuralLooseness(
    link=2, direction=(0.97, -0.26, 0.0), gap=2e-4, stiffness=(2e5, 2e5), damping=(20, 20)
)


def compare(arm, fault=LOOSE, settings=SHORT) -> dict[str, Disagreement]:
    rng = np.random.default_rng(1)
    return {w.name: w for w in compare_alternatives(arm, POSE, fault, rng, settings=settings)}


@pytest.fixture(scope="module")
def stiff() -> dict[str, Disagreement]:
    return compare(planar(2))


def test_a_stiff_healthy_arm_agrees_with_every_model(stiff):
    assert tuple(stiff) == ALTERNATIVES
    for w in stiff.values():
        assert w.model < 0.02 * w.gap, w.name


def test_a_gap_that_is_none_makes_no_difference(stiff):
    shut = compare(planar(2), replace(LOOSE, gap=0.0, friction=1e4))
    for name, w in shut.items():
        assert w.gap < 0.01 * stiff[name].gap, name


def test_bending_in_the_band_spoils_the_rigid_models_only():
    found = compare(vera())
    for name in ("velocity", "acceleration", "constrained dynamics"):
        assert found[name].model > found[name].gap, name
    for name in ("static force", "flexible dynamics"):
        assert found[name].model < 0.1 * found[name].gap, name


def test_the_noise_of_an_accelerometer_alone(stiff):
    from loose_env.sensors import Accelerometer, Encoder, SensorSuite

    density, (low, high) = 5e-3, planar(2).band
    sensors = SensorSuite(
        accelerometer=Accelerometer(noise_density=density, resolution=0.0),
        encoder=Encoder(noise=0.0, resolution=0.0),
    )
    found = compare(planar(2), settings=replace(SHORT, sensors=sensors, torque_noise=1e-12))
    expected = density * np.sqrt(2 * (high - low))
    assert found["acceleration"].noise == pytest.approx(expected, rel=0.01)
    assert found["flexible dynamics"].noise == pytest.approx(expected, rel=0.01)
    velocity = density * np.sqrt(2 * (1 / low - 1 / high)) / (2 * np.pi)
    assert found["velocity"].noise == pytest.approx(velocity, rel=0.03)
    assert found["acceleration"].gap == pytest.approx(stiff["acceleration"].gap)
