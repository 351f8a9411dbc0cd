"""Statistics of one record, where some axes of the tool stand still."""

from __future__ import annotations

from dataclasses import fields
from itertools import product

import numpy as np
import pytest

from loose_env.arms import LinearArm, scara, six_axis
from loose_env.diagnosis.records.record_statistics import RecordStatistics, statistics_of
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation, at_levels
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.statistics import kurtosis, skewness

POSE = np.array([0.5, 0.9, -0.08, -0.4])


def all_finite(record: RecordStatistics) -> bool:
    return all(np.isfinite(getattr(record, f.name)).all() for f in fields(record))


def test_every_record_of_a_scara_with_ideal_sensors_has_finite_statistics() -> None:
    arm = scara()
    at, rig = LinearArm(arm).at(POSE), SimulatedRig(arm, sensors=SensorSuite.ideal())
    for on in product((0.0, 1.0), repeat=4):
        if any(on):
            shake, _ = at_levels(at, np.array(on), duration=0.2)
            assert all_finite(statistics_of(rig.measure(POSE, shake))), on


def test_what_stands_still_follows_nothing_and_has_no_shape() -> None:
    arm = scara()
    at, rig = LinearArm(arm).at(POSE), SimulatedRig(arm, sensors=SensorSuite.ideal())
    shake, _ = at_levels(at, np.array([0, 0, 2.0, 0]), duration=0.4)
    measurement = rig.measure(POSE, shake)
    record = statistics_of(measurement)
    # The quill moves the tool along z alone.
    np.testing.assert_allclose(record.transmission[:, 2], [0, 0, 1], atol=3e-3)
    assert record.lowest_direction[2] == pytest.approx(0.0, abs=1e-3)
    assert record.lowest_coherence == pytest.approx(0.0, abs=1e-9)
    assert record.skewness[:2].tolist() == record.kurtosis[:2].tolist() == [0.0, 0.0]
    assert (record.lowest_skewness, record.lowest_kurtosis) == (0.0, 0.0)
    # The moving axis keeps the moments it has by itself.
    assert record.skewness[2] == pytest.approx(skewness(measurement.tool[2]))
    assert record.kurtosis[2] == pytest.approx(kurtosis(measurement.tool[2]))


def test_a_bent_arm_in_a_symmetric_pose_is_no_trap() -> None:
    arm = six_axis()
    at, rig = LinearArm(arm).at(np.zeros(6)), SimulatedRig(arm, sensors=SensorSuite.ideal())
    for joint in range(6):
        shake, _ = at_levels(at, np.eye(6)[joint], duration=0.2)
        assert all_finite(statistics_of(rig.measure(np.zeros(6), shake)))


def test_a_record_in_which_nothing_moves_is_refused() -> None:
    shake = Excitation(torque_rms=(1.0,), duration=0.4, band=(30.0, 150.0))
    noise = np.random.default_rng(0).standard_normal((1, 402))
    still = Measurement(
        pose=np.zeros(1),
        excitation=shake,
        rate=1000.0,
        command=noise[:, 1:-1],
        encoder=noise,
        tool=np.zeros((3, 400)),
    )
    with pytest.raises(InvalidData, match="constant"):
        statistics_of(still)
