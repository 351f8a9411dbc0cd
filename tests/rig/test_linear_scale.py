"""A sliding joint is read by a linear scale, a turning one by an encoder."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import LinearArm, scara
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.excitation import Excitation, at_levels
from loose_env.rig import SimulatedRig, read_encoder
from loose_env.sensors import Encoder, SensorSuite

POSE = np.array([0.5, 0.9, -0.08, -0.4])


def test_each_row_has_the_noise_and_the_step_of_its_own_scale() -> None:
    sensor = Encoder(resolution=1e-5, noise=3e-5, linear_resolution=1e-6, linear_noise=5e-6)
    true = np.zeros((3, 20_000))
    sliding = np.array([False, True, False])
    drawn = np.random.default_rng(0).standard_normal(true.shape)
    read = read_encoder(true, sensor=sensor, drawn=drawn, sliding=sliding)
    assert read.std(axis=1) == pytest.approx([3e-5, 5e-6, 3e-5], rel=0.05)
    for row, step in zip(read, (1e-5, 1e-6, 1e-5), strict=True):
        np.testing.assert_allclose(row / step, np.round(row / step), atol=1e-6)
    # The hinges' readings are those of an arm without a slide.
    plain = read_encoder(true, sensor=sensor, drawn=drawn)
    np.testing.assert_array_equal(read[[0, 2]], plain[[0, 2]])


def test_the_quill_of_a_scara_is_read_in_micrometres() -> None:
    shake, _ = at_levels(LinearArm(scara()).at(POSE), np.array([0, 0, 2.0, 0]), duration=0.2)
    record = SimulatedRig(scara()).measure(POSE, shake)
    ideal = SimulatedRig(scara(), sensors=SensorSuite.ideal()).measure(POSE, shake)
    steps = record.encoder[2] / 1e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    off = (record.encoder - ideal.encoder).std(axis=1)
    assert off[2] == pytest.approx(np.hypot(2e-7, 1e-6 / np.sqrt(12)), rel=0.3)
    assert off[0] > 4 * off[2]  # 6 µrad steps


def test_the_predicted_floor_is_what_a_scale_at_rest_shows() -> None:
    arm = scara()
    sensors = SensorSuite(encoder=Encoder(linear_noise=3e-7))
    floor = SensorFloor.of(sensors, arm.band)
    assert floor.joints(arm).tolist() == [floor.joint, floor.joint, floor.slide, floor.joint]
    # So little shaking that the scale's noise is all that is seen of the quill.
    shake = Excitation(torque_rms=(0.0, 0.0, 1e-3, 0.0), duration=1.2, band=arm.band)
    record = statistics_of(SimulatedRig(arm, sensors=sensors).measure(POSE, shake))
    assert record.joint_rms[2] == pytest.approx(floor.slide, rel=0.2)
    nominal = predict(LinearArm(arm).at(POSE), shake, floor)
    assert np.sqrt(nominal.joint[0, 0]) == pytest.approx(floor.slide, rel=0.05)
