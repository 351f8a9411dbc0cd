"""The nominal prediction, and what seats would do if they opened, against simulation."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.diagnosis.likelihood.seat_response import predict_seats
from loose_env.diagnosis.records.prediction import SensorFloor, predict
from loose_env.diagnosis.records.record_statistics import statistics_of
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, StructuralLooseness
from loose_env.rig import SimulatedRig
from loose_env.sensors import SensorSuite

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
    seats = predict_seats(LinearArm(arm).at(pose), measured.torque, direction[None, :], np.zeros(3))
    index = place - 1 if kind == "slide" else arm.n + place - 1
    moved = seats.in_step + seats.in_step_open[index]
    expected = moved[1:, 0] / moved[0, 0]
    found = measured.transmission[:, joint - 1]
    # The tool of a healthy arm would move otherwise, unless the seat is not driven at all.
    scale = np.linalg.norm(seats.in_step[1:, 0] / seats.in_step[0, 0])
    assert np.linalg.norm(found - expected) < 0.04 * max(scale, np.linalg.norm(expected))
    inertia = measured.torque[joint - 1] / moved[0, 0]
    assert measured.inertia[joint - 1] == pytest.approx(inertia, rel=0.04)


def test_prediction_of_several_joints_holds_each_one_alone() -> None:
    arm = ARMS["planar3"]
    at = LinearArm(arm).at([0.3, -0.8, 1.1])
    excitation, _ = at_levels(at, np.array([1.0, 1.0, 1.0]), duration=1.2)
    quiet = SensorFloor(joint=0.0, tool=0.0)
    assert predict(at, excitation, quiet).transmission == pytest.approx(at.kinematic, abs=0.02)
