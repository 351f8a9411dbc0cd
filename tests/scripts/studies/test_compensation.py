"""The study of compensated excitation: what it compensates, and at which level."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest

from loose_env.arms import LinearArm, vera
from loose_env.excitation import at_levels
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.statistics import acceleration_from_angle
from loose_env.thesis.methods.motion.signals import spectral_flatness


@pytest.fixture(scope="module")
def study() -> ModuleType:
    return importlib.import_module("scripts.studies.thesis.compensation")


@pytest.mark.parametrize(("joint", "flat_enough"), [(0, 0.6), (1, 0.75)])
def test_shaped_torque_makes_the_joint_motion_white(
    study: ModuleType, joint: int, flat_enough: float
) -> None:
    # VERA's beam bends inside the band: flat torque gives anything but flat motion. Joint 1 has
    # an antiresonance deeper than the tenfold range of the shape.
    arm = vera()
    rig, pose = SimulatedRig(arm, sensors=SensorSuite.ideal()), np.array([0.2, 0.9])
    at = LinearArm(arm).at(pose)
    flat, _ = at_levels(at, np.where(np.arange(2) == joint, 2.0, 0.0), duration=4.8)
    before = rig.measure(pose, flat, rng=np.random.default_rng(1))
    shape = study.shaping_of(before, joint, "white joint motion")
    white = study.shaped(flat, at, joint, shape)
    after = rig.measure(pose, white, rng=np.random.default_rng(2))

    def flatness(record: Measurement) -> float:
        motion = acceleration_from_angle(record.encoder[joint], record.rate, arm.band)
        return float(spectral_flatness(motion, record.rate, arm.band, segments=8))

    assert flatness(before) < 0.4
    assert flatness(after) > flat_enough
    # The tool moves as much as before, so that a difference is the spectrum's.
    assert after.tool.std() == pytest.approx(before.tool.std(), rel=0.3)


def test_the_shape_undoes_a_transfer_function_within_its_range(study: ModuleType) -> None:
    frequency = np.linspace(30, 150, 51)
    size = 1 + frequency / 100
    product = study.inverse_of(frequency, size)(frequency) * size
    np.testing.assert_allclose(product, product[0], rtol=1e-12)
    deep = np.ones(51)
    deep[10], deep[40] = 1e-9, 1e9
    weights = study.inverse_of(frequency, deep)(frequency)
    assert weights.max() / weights.min() == pytest.approx(study.RANGE)


def test_errors_of_paired_cases_are_resampled_by_arm(study: ModuleType) -> None:
    one = np.random.default_rng(0).uniform(0, 90, 40)
    middle, low, high = study.difference(one, one + 5.0, 20, 0)
    assert (middle, low, high) == pytest.approx((5.0, 5.0, 5.0))
