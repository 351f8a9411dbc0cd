"""Every link of every arm has a place for an accelerometer that its own joint moves."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, link_site, planar, scara, six_axis, vera
from loose_env.arms.arm import CLEARANCE
from loose_env.errors import UnknownName
from loose_env.typing import Array

ARMS: tuple[Callable[[], Arm], ...] = (vera, lambda: planar(3), six_axis, scara)


def velocity(arm: Arm, link: int, pose: Array) -> tuple[Array, Array]:
    """Motion of a link's sensor per motion of its own joint, and the tangent, in the world."""
    at = link_site(arm, link)
    spec = arm.spec.copy()
    spec.body(at.body).add_site(name="here", pos=list(at.position))
    m = spec.compile()
    data = mujoco.MjData(m)
    for name, q in zip(arm.joints, pose, strict=True):
        data.joint(name).qpos[0] = q
    mujoco.mj_forward(m, data)
    jacobian = np.zeros((3, m.nv))
    mujoco.mj_jacSite(m, data, jacobian, None, m.site("here").id)
    turn = data.body(at.body).xmat.reshape(3, 3)
    return jacobian[:, m.joint(arm.joints[link - 1]).dofadr[0]], turn @ at.tangent


@pytest.mark.parametrize("make", ARMS)
def test_the_own_joint_moves_the_sensor_along_the_tangent_in_any_pose(
    make: Callable[[], Arm],
) -> None:
    arm, rng = make(), np.random.default_rng(0)
    for link in range(1, arm.n + 1):
        for _ in range(3):
            motion, tangent = velocity(arm, link, arm.random_pose(rng))
            speed = float(np.linalg.norm(motion))
            assert speed >= (1.0 if arm.sliding[link - 1] else CLEARANCE) - 1e-9
            np.testing.assert_allclose(motion / speed, tangent, atol=1e-6)


def test_a_link_that_bends_carries_its_sensor_beyond_the_bend() -> None:
    assert link_site(vera(), 1).body == "link1_end"
    assert link_site(vera(), 1, "proximal").body == "link1"


def test_a_place_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UnknownName, match="has links 1 to 3"):
        link_site(planar(3), 4)
    with pytest.raises(UnknownName, match="'proximal' or 'distal' end, got 'middle'"):
        link_site(planar(3), 1, "middle")  # type: ignore[arg-type]
