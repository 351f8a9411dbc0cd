"""Reach: the largest distance from the first joint to the tool over all poses."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar, scara, six_axis, vera
from scripts.thesis.rigs import cylindrical, shaken_vera


def distances(arm: Arm, poses: np.ndarray) -> np.ndarray:
    """From the first joint's anchor to the tool in each pose [m] (k,)."""
    data = mujoco.MjData(arm.model)
    mujoco.mj_kinematics(arm.model, data)
    base, tool = data.joint(arm.joints[0]).xanchor.copy(), data.site(arm.tool)
    found = []
    for pose in poses:
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(arm.model, data)
        found.append(np.linalg.norm(tool.xpos - base))
    return np.array(found)


def test_a_planar_arm_reaches_the_sum_of_its_links_to_the_last_digit() -> None:
    # Observations are scaled by it: it must not move by rounding.
    assert (vera().reach, shaken_vera().reach) == (0.8, 0.8)
    for links in range(2, 8):
        arm = planar(links)
        assert arm.reach == distances(arm, np.zeros((1, links)))[0]
        assert arm.reach == pytest.approx(0.3 * links, rel=1e-12)


def test_the_six_axis_arm_reaches_farther_than_in_its_bent_zero_pose() -> None:
    arm = six_axis()
    assert distances(arm, np.zeros((1, 6)))[0] == pytest.approx(0.724, abs=1e-3)
    assert arm.reach == pytest.approx(0.993, abs=1e-3)


def test_the_scara_reaches_out_and_down() -> None:
    # Straight arms with the bracket ahead, the quill down: one triangle.
    assert scara().reach == pytest.approx(np.hypot(0.325 + 0.275 + 0.08, 0.15 + 0.21 + 0.03))


@pytest.mark.parametrize(
    "arm",
    [six_axis(), scara(), cylindrical(), arm_from_file(DESK_ARM), planar(4)],
    ids=lambda arm: arm.name,
)
def test_no_pose_reaches_farther_and_some_pose_nearly_as_far(arm: Arm) -> None:
    rng = np.random.default_rng(5)
    found = distances(arm, np.array([arm.random_pose(rng) for _ in range(20_000)]))
    assert found.max() <= arm.reach + 1e-9
    # Six joints seldom point the same way by chance.
    assert found.max() > 0.93 * arm.reach


def test_a_limit_that_keeps_the_arm_bent_shortens_its_reach() -> None:
    arm = planar(2)
    bent = replace(arm, joint_ranges=(None, (np.pi / 3, np.pi / 2)))
    # The straight pose lies outside the range.
    assert arm.reach == pytest.approx(0.6)
    assert bent.reach == pytest.approx(2 * 0.3 * np.cos(np.pi / 6))


def test_it_is_found_again_every_time() -> None:
    assert six_axis().reach == six_axis().reach
