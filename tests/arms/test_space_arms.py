"""Arms in space on the rig: every fault shows, and a healthy arm answers as its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, scara, six_axis
from loose_env.arms.linear import LinearArm
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, Fault, StructuralLooseness
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

Case = tuple[Arm, LinearArm, Array, list[Fault]]


def faults(slides: list[tuple[float, float]], plays: list[float]) -> list[Fault]:
    """A slide of every link and play in every joint, each with the stiffness of its stops."""
    return [
        *(
            StructuralLooseness(
                link=i, direction=(1.0, -0.5, 0.7), gap=1e-4, stiffness=(k, k / 2), damping=(c, c)
            )
            for i, (k, c) in enumerate(slides, start=1)
        ),
        *(
            Backlash(joint=i, gap=4e-4, stiffness=(k, k / 2), damping=(1e-3 * k, 1e-3 * k))
            for i, k in enumerate(plays, start=1)
        ),
    ]


POSES = {
    "scara": np.array([0.5, 0.9, -0.08, -0.4]),
    "six_axis": np.array([0.4, -0.6, 0.9, 0.5, 0.7, -0.3]),
}
# The link side of a wrist joint is light: a stiff flank would be too fast for the step.
FAULTS = {
    "scara": faults(
        [(2e6, 800.0), (2e6, 800.0), (4e5, 80.0), (3e5, 40.0)], [1e4, 1e4, 500.0, 300.0]
    ),
    "six_axis": faults(
        [(2e6, 800.0)] * 3 + [(3e5, 60.0), (3e5, 30.0), (2e5, 20.0)],
        [1e4, 1e4, 1e4, 500.0, 300.0, 30.0],
    ),
}


MAKERS = {"scara": scara, "six_axis": six_axis}
JOINTS = [("scara", joint) for joint in range(1, 5)] + [("six_axis", j) for j in range(1, 7)]


@pytest.fixture(scope="module")
def case(request: pytest.FixtureRequest) -> Case:
    arm = MAKERS[request.param]()
    return arm, LinearArm(arm), POSES[arm.name], FAULTS[arm.name]


@pytest.mark.parametrize("case", MAKERS, indirect=True)
def test_every_joint_shakes_every_loose_arm_and_every_fault_shows(case: Case) -> None:
    arm, linear, pose, faults = case
    rig = SimulatedRig(arm, slots=len(faults) + 1)
    for slot, fault in enumerate(faults):
        rig.mount(slot, fault)
    departure = np.zeros((arm.n, len(faults)))
    for joint in range(arm.n):
        levels = arm.levels[1] * np.eye(arm.n)[joint]
        excitation, share = at_levels(linear.at(pose), levels, duration=0.2)
        assert share.min() == 1.0
        *loose, healthy = rig.measure_many(
            [
                Job(slot=k, pose=pose, excitation=excitation, rng=np.random.default_rng(joint))
                for k in range(rig.slots)
            ]
        )
        shaken = healthy.tool - healthy.tool.mean(axis=1, keepdims=True)
        assert np.linalg.norm(shaken) > 0
        for k, record in enumerate(loose):
            assert record.failure is None
            assert np.isfinite(record.tool).all()
            assert np.isfinite(record.encoder).all()
            gone = np.linalg.norm(record.tool - healthy.tool)
            departure[joint, k] = gone / np.linalg.norm(shaken)
    assert departure.max() < 20
    # The joint that shows a fault best shows it well.
    assert (departure.max(axis=0) > 0.1).all(), departure.round(4)


@pytest.mark.parametrize(("case", "joint"), JOINTS, indirect=["case"])
def test_a_healthy_arm_transmits_what_its_closed_form_says(case: Case, joint: int) -> None:
    arm, linear, pose, _ = case
    at = linear.at(pose)
    excitation, _ = at_levels(at, arm.levels[1] * np.eye(arm.n)[joint - 1], duration=1.2)
    record = SimulatedRig(arm, sensors=SensorSuite.ideal()).measure(pose, excitation)
    if arm.name == "scara":
        # Rigid links do not couple the vertical with the plane: one of the two stands quite still,
        # and without noise it has no statistics. The prediction knows the noise.
        found = statistics_of(SimulatedRig(arm).measure(pose, excitation))
        floor = SensorFloor.of(SensorSuite(), arm.band)
    else:
        found, floor = statistics_of(record), SensorFloor(joint=0.0, tool=0.0)
    column = predict(at, excitation, floor).transmission[:, 0]
    error = np.linalg.norm(found.transmission[:, joint - 1] - column)
    assert error < 0.03 * np.linalg.norm(column)
    # The tool's answer, line by line, is that of the linear arm.
    fine = LinearArm(arm, points=145).at(pose)
    lines = slice(36, 181)
    torque = np.fft.rfft(record.command[joint - 1])[lines]
    tool = np.fft.rfft(record.tool)[:, lines]
    answer = fine.response(excitation.excited).tool[..., 0].T * torque
    assert np.linalg.norm(tool - answer) < 0.02 * np.linalg.norm(answer)
