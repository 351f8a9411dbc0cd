"""Pose of an arm's parts in space, in an axonometric view."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms import Arm
from loose_env.typing import Array

__all__ = ["SpacePose", "SpaceView"]


_AZIMUTH, _ELEVATION = np.radians(-58.0), np.radians(20.0)
"""Azimuth of the camera from the x axis, and elevation above the horizon [rad]."""
_NEAR = 0.06
"""Distance over the reach below which two joints, or a joint and an axis, are drawn as one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SpacePose:
    """The arm in one pose, in the camera's coordinates: right, up, towards the eye."""

    joints: Array
    """A point on each joint's axis, where the joint is drawn, base first [m] (n, 3)."""
    axes: Array
    """Unit vector of each joint's axis (n, 3)."""
    tool: Array
    """Origin of the tool frame [m] (3,)."""
    frame: Array
    """Axes of the tool frame as columns (3, 3)."""
    seats: Array
    """From each link's frame to the camera (n, 3, 3)."""
    origins: Array
    """Origin of each link's frame [m] (n, 3)."""
    foot: Array
    """Foot of the base, below the first joint [m] (3,)."""
    floor: Array
    """Two unit vectors along what the base stands on, as columns, and its normal (3, 3)."""

    @property
    def ends(self) -> Array:
        """Far end of each link: the next joint, or the tool [m] (n, 3)."""
        return np.vstack([self.joints[1:], self.tool])

    def on_floor(self, points: Array) -> Array:
        """Shadows of points (k, 3) on what the base stands on."""
        normal = self.floor[:, 2]
        height = (points - self.foot) @ normal
        return np.asarray(points - height[:, None] * normal)


class SpaceView:
    """An axonometric view from one side and a little above, the same in every pose.

    Gravity points down in the picture. Without gravity, the world's z axis points up.

    Parameters
    ----------
    arm : Arm
        Any arm.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> at = SpaceView(scara()).at(np.zeros(4))
    >>> bool(at.axes[2, 1] > 0.9)  # the quill is seen upright
    True
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._data = mujoco.MjData(arm.model)
        gravity = np.asarray(arm.model.opt.gravity, dtype=float)
        self.gravity = float(np.linalg.norm(gravity))
        """Strength of gravity [m/s²]."""
        up = -gravity / self.gravity if self.gravity > 0 else np.array([0.0, 0.0, 1.0])
        ahead = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
        ahead = ahead - (ahead @ up) * up
        ahead = ahead / np.linalg.norm(ahead)
        aside = np.cross(up, ahead)
        level = np.cos(_AZIMUTH) * ahead + np.sin(_AZIMUTH) * aside
        eye = np.cos(_ELEVATION) * level + np.sin(_ELEVATION) * up
        right = np.cross(up, eye)
        right = right / np.linalg.norm(right)
        self._camera = np.stack([right, np.cross(eye, right), eye])

    def at(self, pose: Array) -> SpacePose:
        """Place the nominal arm in a pose [rad or m] (n,)."""
        model, data, arm = self.arm.model, self._data, self.arm
        mujoco.mj_resetData(model, data)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(model, data)
        axes = np.array([data.joint(name).xaxis for name in arm.joints])
        anchors = np.array([data.joint(name).xanchor for name in arm.joints])
        site = data.site(arm.tool)
        tool = site.xpos.copy()
        points = _along_axes(anchors, axes, tool, _NEAR * arm.reach)
        first = points[0]
        # The world's zero is taken for the ground where the arm stands above it.
        height = first[2] if first[2] > 0.02 * arm.reach else 0.28 * arm.reach
        lowest = min(float(points[:, 2].min()), float(tool[2])) - 0.06 * arm.reach
        foot = np.array([first[0], first[1], min(first[2] - height, lowest)])
        see = self._camera
        return SpacePose(
            joints=points @ see.T,
            axes=axes @ see.T,
            tool=see @ tool,
            frame=see @ site.xmat.reshape(3, 3),
            seats=np.array([see @ data.body(name).xmat.reshape(3, 3) for name in arm.seat_bodies]),
            origins=np.array([see @ data.body(name).xpos for name in arm.seat_bodies]),
            foot=see @ foot,
            floor=see.copy(),
        )


def _along_axes(anchors: Array, axes: Array, tool: Array, near: float) -> Array:
    """Choose a point on every joint's axis so that joints are seen apart (n, 3).

    Any point of its axis stands for a joint. One that turns about the link before it is drawn
    half way along that link; one in the same place as the joint before, as in a wrist, is drawn
    towards what comes next, if its axis leads there.
    """
    points = anchors.copy()
    for j in range(1, len(points)):
        before, axis = points[j - 1], axes[j]
        foot = points[j] + ((before - points[j]) @ axis) * axis
        apart = float(np.linalg.norm(points[j] - before))
        if apart > 3 * near and float(np.linalg.norm(before - foot)) < near:
            points[j] = foot + 0.55 * (points[j] - foot)
        elif apart < near:
            after = points[j + 1] if j + 1 < len(points) else tool
            ahead = float((after - points[j]) @ axis)
            if abs(ahead) > 0.3 * near:
                points[j] = points[j] + 0.6 * ahead * axis
    return points
