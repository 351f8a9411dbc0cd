"""Shape of the motion in one record, on simulated arms."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar
from loose_env.diagnosis import (
    MotionShape,
    SensorFloor,
    shape_of_motion,
    statistics_of,
)
from loose_env.errors import InvalidData
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.rig import ReducedRig
from loose_env.sensors import SensorSuite

ARM = planar(3)
POSE = np.array([0.3, 0.8, -0.6])


SLIDE = StructuralLooseness(
    link=2, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(3e6, 3e6), damping=(200.0, 200.0)
)


def play_in(joint: int) -> Backlash:
    return Backlash(joint=joint, gap=2e-4, stiffness=(2e5, 2e5), damping=(20.0, 20.0), friction=0.1)


def shape(fault: Fault, *joints: int) -> MotionShape:
    linear, rig = LinearArm(ARM), ReducedRig(ARM)
    rig.mount(0, fault)
    levels = np.where(np.isin(np.arange(3), joints), ARM.levels[-1], 0.0)
    shake, _ = at_levels(linear.at(POSE), levels, duration=1.2)
    measured = rig.measure(POSE, shake, rng=np.random.default_rng(0))
    floor = SensorFloor.of(SensorSuite(), ARM.band)
    return shape_of_motion(statistics_of(measured), linear.at(POSE), floor)


@pytest.mark.parametrize(
    ("fault", "across", "normal", "play"),
    [
        (Healthy(), False, True, False),
        (play_in(2), False, False, True),
        (play_in(3), True, False, False),
        (SLIDE, True, False, False),
    ],
    ids=("healthy", "play in the driven joint", "play beyond it", "slide beyond it"),
)
def test_only_play_in_the_driven_joint_keeps_to_the_line_and_is_not_normal(
    fault: Fault, across: bool, normal: bool, play: bool
) -> None:
    found = shape(fault, 1)
    assert (found.across > 5.0) == across
    assert (found.kurtosis < 0.3) == normal
    assert found.is_play() == play


def test_several_driven_joints_are_refused() -> None:
    with pytest.raises(InvalidData, match=r"joints \[1, 2\] were excited: excite one alone"):
        shape(Healthy(), 0, 1)
