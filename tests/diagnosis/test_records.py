"""Statistics of a record and predictions of the nominal arm, against simulation."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import product

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    SensorFloor,
    predict,
    predict_seats,
    statistics_of,
    stiffness_errors,
)
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Backlash, StructuralLooseness
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.statistics import shape_of

POSE = np.array([0.5, 0.9, -0.08, -0.4])


@pytest.mark.parametrize("arm", [scara(), six_axis()], ids=lambda arm: arm.name)
def test_every_record_with_ideal_sensors_has_finite_statistics(arm: Arm) -> None:
    pose = POSE if arm.n == 4 else np.zeros(6)  # six axes bent, in a symmetric pose
    at, rig = LinearArm(arm).at(pose), SimulatedRig(arm, sensors=SensorSuite.ideal())
    for on in [*product((0.0, 1.0), repeat=4)][1:] if arm.n == 4 else np.eye(6):
        shake, _ = at_levels(at, np.array(on), duration=0.2)
        record = statistics_of(rig.measure(pose, shake))
        assert all(np.isfinite(getattr(record, f.name)).all() for f in fields(record)), on


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
    skewness, kurtosis = shape_of(measurement.tool[2])
    assert record.skewness[2] == pytest.approx(skewness)
    assert record.kurtosis[2] == pytest.approx(kurtosis)


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


ARMS = {"planar3": planar(3), "vera": vera()}


def shaken(arm: Arm, pose: np.ndarray, joint: int, level: float) -> object:
    levels = np.zeros(arm.n)
    levels[joint - 1] = level
    return at_levels(LinearArm(arm).at(pose), levels, duration=1.2)[0]


@pytest.mark.parametrize("name", ARMS)
def test_the_sensors_leave_the_floor_that_was_worked_out(name: str) -> None:
    arm = ARMS[name]
    pose = np.full(arm.n, 0.4)
    excitation = shaken(arm, pose, 1, 1e-6)
    record = statistics_of(SimulatedRig(arm).measure(pose, excitation))  # type: ignore[arg-type]
    floor = SensorFloor.of(SensorSuite(), arm.band)
    assert record.joint_rms[0] == pytest.approx(floor.joint, rel=0.2)
    tool = np.sqrt(np.diag(record.tool_covariance))
    assert tool == pytest.approx(np.full(2, floor.tool), rel=0.25)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("place", [1, 2, 3])
@pytest.mark.parametrize("kind", ["slide", "play"])
def test_a_seat_that_floats_moves_as_predicted(joint: int, place: int, kind: str) -> None:
    arm = ARMS["planar3"]
    pose = np.array([0.3, -0.8, 1.1])
    angle = 0.7
    direction = np.array([np.cos(angle), np.sin(angle)])
    # A gap so wide that no stop is reached, and no friction to speak of.
    fault: StructuralLooseness | Backlash
    if kind == "slide":
        fault = StructuralLooseness(
            link=place, direction=(*direction, 0.0), gap=0.05, stiffness=(1e4, 1e4)
        )
    else:
        fault = Backlash(joint=place, gap=0.2, stiffness=(1e4, 1e4))
    excitation = shaken(arm, pose, joint, 1.0)
    rig = SimulatedRig(arm, sensors=SensorSuite.ideal())
    rig.mount(0, fault)
    measured = statistics_of(rig.measure(pose, excitation))  # type: ignore[arg-type]
    at, torque = LinearArm(arm).at_all(pose[None]), measured.torque[None]
    seats = predict_seats(at, torque, direction[None, :], np.zeros((1, 3)))
    index = place - 1 if kind == "slide" else arm.n + place - 1
    moved = seats.in_step[0] + seats.in_step_open[0, index]
    expected = moved[1:, 0] / moved[0, 0]
    found = measured.transmission[:, joint - 1]
    # The tool of a healthy arm would move otherwise, unless the seat is not driven at all.
    scale = np.linalg.norm(seats.in_step[0, 1:, 0] / seats.in_step[0, 0, 0])
    assert np.linalg.norm(found - expected) < 0.04 * max(scale, np.linalg.norm(expected))
    inertia = measured.torque[joint - 1] / moved[0, 0]
    assert measured.inertia[joint - 1] == pytest.approx(inertia, rel=0.04)


def test_prediction_of_several_joints_holds_each_one_alone() -> None:
    arm = ARMS["planar3"]
    at = LinearArm(arm).at([0.3, -0.8, 1.1])
    excitation, _ = at_levels(at, np.array([1.0, 1.0, 1.0]), duration=1.2)
    quiet = SensorFloor(joint=0.0, tool=0.0)
    assert predict(at, excitation, quiet).transmission == pytest.approx(at.kinematic, abs=0.02)


def test_errors_of_springs_are_those_of_an_arm_with_other_springs() -> None:
    arm, one = vera(), np.array([True, False])
    pose, mismatch = np.array([0.3, 1.0]), Mismatch(stiffness=0.1, mass=0.0)
    (errors,) = stiffness_errors(LinearArm(arm).at_all(pose[None]), one[None], mismatch)
    # The bending mode, nothing of the excited joint, and the brake of joint 2.
    assert errors.shape == (3, 2, 1)
    assert not errors[1].any()
    assert errors[2].any()
    found = []
    for factor in (1.1, 1 / 1.1):
        spec = arm.spec.copy()
        for joint in spec.joints:
            if joint.name not in arm.joints:
                joint.stiffness = joint.stiffness * factor
        answer = LinearArm(replace(arm, spec=spec)).at(pose).response(one)
        found.append(answer.tool.real.mean(axis=0) / answer.joint[:, :1].real.mean(axis=0))
    np.testing.assert_allclose(errors[0], (found[0] - found[1]) / 2, rtol=1e-6)
    assert np.abs(errors[1]).max() < 0.1 * np.abs(errors[0]).max()
