"""Pose of a planar arm's parts in its plane of motion."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = ["PlanarPose", "PlanarView", "moves_in_a_plane"]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanarPose:
    """The arm in one pose, in the two coordinates of the picture."""

    joints: Array
    """Joints, base first [m] (n, 2)."""
    tool: Array
    """Origin of the tool frame [m] (2,)."""
    frame: Array
    """The two measured axes of the tool frame as columns (2, 2)."""
    seats: Array
    """From each link's frame to the picture (n, 2, 3)."""

    @property
    def ends(self) -> Array:
        """Far end of each link: the next joint, or the tool [m] (n, 2)."""
        return np.vstack([self.joints[1:], self.tool])


def moves_in_a_plane(arm: Arm) -> bool:
    """Return whether all joint axes are parallel and the accelerometer measures two axes.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import scara
    >>> moves_in_a_plane(planar(2)), moves_in_a_plane(scara())
    (True, False)
    """
    axes = _joint_axes(arm, mujoco.MjData(arm.model))
    return len(arm.axes) == 2 and bool(np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() < 1e-6)


def _joint_axes(arm: Arm, data: mujoco.MjData) -> Array:
    """Joint axes in world coordinates, all joints at zero (n, 3)."""
    mujoco.mj_forward(arm.model, data)
    return np.array([data.joint(name).xaxis for name in arm.joints])


class PlanarView:
    """The plane in which an arm moves, seen against its joint axes.

    Gravity points down in the picture where the plane holds it; elsewhere the x axis of the
    world points right.

    Parameters
    ----------
    arm : Arm
        An arm whose joint axes are parallel and whose accelerometer measures two axes.

    Raises
    ------
    InvalidSetting
        If the arm does not move in a plane.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> view = PlanarView(planar(2))
    >>> view.at(np.array([0.0, np.pi / 2])).tool.round(3).tolist()
    [0.3, 0.3]
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._data = mujoco.MjData(arm.model)
        axes = _joint_axes(arm, self._data)
        if not moves_in_a_plane(arm):
            raise InvalidSetting(
                f"a picture shows an arm that moves in a plane: parallel joint axes and two "
                f"measured tool axes. Arm {arm.name!r} has joint axes "
                f"{axes.round(3).tolist()} and measures the tool axes {arm.axes}"
            )
        normal = axes[0] / np.linalg.norm(axes[0])
        gravity = np.asarray(arm.model.opt.gravity, dtype=float)
        within = gravity - (gravity @ normal) * normal
        self.vertical = float(np.linalg.norm(within)) > 0.1 * float(np.linalg.norm(gravity))
        """True if gravity acts within the plane, down in the picture."""
        if self.vertical:
            right = np.cross(-within, normal)
        else:
            world = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
            right = world - (world @ normal) * normal
        right = right / np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(normal, right)])

    def at(self, pose: Array) -> PlanarPose:
        """Place the nominal arm in a pose [rad] (n,)."""
        model, data, arm = self.arm.model, self._data, self.arm
        mujoco.mj_resetData(model, data)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(model, data)
        site = data.site(arm.tool)
        origin = data.joint(arm.joints[0]).xanchor.copy()
        turns = [data.body(name).xmat.reshape(3, 3) for name in arm.seat_bodies]
        return PlanarPose(
            joints=np.array(
                [self._axes @ (data.joint(name).xanchor - origin) for name in arm.joints]
            ),
            tool=self._axes @ (site.xpos - origin),
            frame=(self._axes @ site.xmat.reshape(3, 3))[:, list(arm.axes)],
            seats=np.array([self._axes @ turn for turn in turns]),
        )
