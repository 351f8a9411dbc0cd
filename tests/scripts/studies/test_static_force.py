"""The study of the static-force method: rows, and the arm that is refused."""

from __future__ import annotations

import pytest

from loose_env.arms import LinearArm, planar
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import UnknownName
from loose_env.faults import Healthy
from loose_env.thesis import JigSettings
from scripts.studies.thesis import static_force as study

SETTINGS = study.Settings(arm="planar3", cases=3, poses=2, seconds=1.0)


def test_a_row_counts_the_right_verdicts_and_the_false_alarms() -> None:
    arm = planar(3, vertical=True)
    sampler = FaultSampler(LinearArm(arm), Difficulty(gap=(2e-4, 3e-4)))
    jig = JigSettings(joint_friction=0.05)
    cases = [study.case_of(arm, sampler, number, jig, SETTINGS) for number in (2, 3, 4)]
    assert [isinstance(case.fault, Healthy) for case in cases] == [True, False, False]
    by_force = study.columns_of(cases, by_force=True).split()
    by_torque = study.columns_of(cases, by_force=False).split()
    right, place, alarms = map(float, by_force[:3])
    assert (right, place, alarms) == (100, 100, 0)
    assert float(by_torque[2]) == 100  # friction


def test_an_unknown_arm_is_refused() -> None:
    with pytest.raises(UnknownName, match="six_axis"):
        study.study(study.Settings(arm="seven_axis"))
