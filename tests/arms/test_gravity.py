"""Gravity acts on every arm that does not lie in a level plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar, scara, six_axis, vera
from loose_env.arms.linear import LinearArm

UPRIGHT = [planar(3, vertical=True), six_axis(), scara(), arm_from_file(DESK_ARM)]
LEVEL = [planar(3), vera()]


@pytest.mark.parametrize("arm", UPRIGHT, ids=lambda arm: arm.name)
def test_an_arm_that_is_not_level_carries_its_weight(arm: Arm) -> None:
    assert np.linalg.norm(arm.model.opt.gravity) == pytest.approx(9.81)
    linear, rng = LinearArm(arm), np.random.default_rng(0)
    for _ in range(10):
        at = linear.at(arm.random_pose(rng))
        # Drives hold the weight, and it lies on the seats: a loose link sinks onto its stop.
        assert np.abs(at.gravity_torque).max() > 0.01 * max(arm.torque_limits)
        beyond = arm.model.body(arm.seat_bodies[0]).subtreemass[0]
        assert np.linalg.norm(at.seat_load[0]) == pytest.approx(9.81 * beyond, rel=1e-6)


@pytest.mark.parametrize("arm", LEVEL, ids=lambda arm: arm.name)
def test_a_level_arm_carries_none_in_its_plane(arm: Arm) -> None:
    linear, rng = LinearArm(arm), np.random.default_rng(0)
    for _ in range(10):
        at = linear.at(arm.random_pose(rng))
        np.testing.assert_allclose(at.gravity_torque, 0.0, atol=1e-9)
        np.testing.assert_allclose(at.seat_load, 0.0, atol=1e-9)


@pytest.mark.parametrize("gravity", [None, "0 0 0", "0 -9.81 0"])
def test_a_file_s_own_gravity_is_kept(tmp_path: Path, gravity: str | None) -> None:
    option = "" if gravity is None else f'<option gravity="{gravity}"/>'
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco>{option}<worldbody><body name="rod"><joint name="pivot" axis="1 0 0"
        actuatorfrcrange="-90 90"/><inertial pos="0 .2 .2" mass="1" diaginertia=".01 .01 .001"/>
        <site name="tool" pos="0 0 .5"/></body></worldbody></mujoco>"""
    )
    arm = arm_from_file(path)
    torque = LinearArm(arm).at([0.0]).gravity_torque[0]
    # Lever 0.2 m across either way; without a word of it MuJoCo's gravity is along -z.
    expected = {None: 9.81 * 0.2, "0 0 0": 0.0, "0 -9.81 0": -9.81 * 0.2}[gravity]
    assert torque == pytest.approx(expected, rel=1e-6, abs=1e-9)
