"""Joints of a serial arm in one pose, base first, and the geometric Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.typing import Array

__all__ = ["Chain", "Frame", "JointKind", "geometric_jacobian", "require_kind"]

JointKind = Literal["revolute", "prismatic"]
Frame = Literal["tool", "world", "base"]
"""Point and axes of a Jacobian: tool point in tool axes, tool point in world axes, or the point
of the tool's body that lies on the world's origin, in world axes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Joints of a serial arm in one pose, in world coordinates, base first."""

    kinds: tuple[JointKind, ...]
    """Kind of each joint (n,)."""
    axes: Array
    """Unit vector of each joint's axis (n, 3)."""
    anchors: Array
    """A point of each joint's axis [m] (n, 3)."""
    tool: Array
    """Tool point [m] (3,)."""
    tool_axes: Array
    """Rotation from the tool frame to the world (3, 3)."""

    def __post_init__(self) -> None:
        n = len(self.kinds)
        shapes = {"axes": (n, 3), "anchors": (n, 3), "tool": (3,), "tool_axes": (3, 3)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InvalidData(
                    f"{name} of a chain of {n} joints must be finite and of shape {shape}, "
                    f"got shape {value.shape}"
                )
            object.__setattr__(self, name, value)
        for kind in self.kinds:
            require_kind(kind)
        if n and np.abs(np.linalg.norm(self.axes, axis=1) - 1).max() > 1e-6:
            raise InvalidData("axes of a chain must be unit vectors; divide each by its length")
        if np.abs(self.tool_axes.T @ self.tool_axes - np.eye(3)).max() > 1e-6:
            raise InvalidData("tool_axes must be a rotation matrix, its columns the tool's axes")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kinds)

    @classmethod
    def of(cls, arm: Arm, pose: ArrayLike) -> Chain:
        """Extract the joints of an arm at a pose [rad] (n,) from its MuJoCo model.

        The tool's position is a function of pose and parameters (3.1). Bending modes of the arm
        stay at rest and are no joints of the chain.

        Raises
        ------
        InvalidSetting
            If the pose does not have one finite number for every joint.

        Examples
        --------
        >>> from loose_env.arms import planar
        >>> float(Chain.of(planar(2), [0.0, 0.0]).tool[0])
        0.6
        """
        q = np.asarray(pose, dtype=float)
        if q.shape != (arm.n,) or not np.isfinite(q).all():
            raise InvalidSetting(
                f"a pose of {arm.name!r} is {arm.n} finite numbers [rad], got {pose!r}"
            )
        data = mujoco.MjData(arm.model)
        data.qpos[arm.pose_addresses] = q
        mujoco.mj_kinematics(arm.model, data)
        joints = [arm.model.joint(name) for name in arm.joints]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        site = data.site(arm.tool)
        return cls(
            kinds=tuple("prismatic" if j.type[0] == slide else "revolute" for j in joints),
            axes=np.array([data.xaxis[j.id] for j in joints]),
            anchors=np.array([data.xanchor[j.id] for j in joints]),
            tool=site.xpos.copy(),
            tool_axes=site.xmat.reshape(3, 3).copy(),
        )


def require_kind(kind: str) -> None:
    """Reject an unknown kind of joint.

    Raises
    ------
    UnknownName
        If the kind is neither "revolute" nor "prismatic".
    """
    if kind not in ("revolute", "prismatic"):
        raise UnknownName(f"a joint is 'revolute' or 'prismatic', got {kind!r}")


def geometric_jacobian(chain: Chain, frame: Frame = "world") -> Array:
    """Columns of the Jacobian, linear part above angular part (3.2, 3.28, 3.29, 3.32).

    A revolute joint gives z × (p - o) and z (3.54), a prismatic one z and nothing (3.55). The
    thesis prints the whole column only in the revolute form.

    Parameters
    ----------
    chain : Chain
        Joints and tool.
    frame : {"world", "tool", "base"}
        Tool point in world axes; tool point in tool axes; or the twist at the world's origin.

    Returns
    -------
    ndarray (6, n)
        Rows 0 to 2 [m/s per rad/s, or 1 for a prismatic joint], rows 3 to 5 [1].

    Raises
    ------
    UnknownName
        If there is no such frame.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> geometric_jacobian(Chain.of(planar(2), [0.0, 0.0]))[1]
    array([0.6, 0.3])
    """
    if frame not in ("world", "tool", "base"):
        raise UnknownName(f"unknown frame {frame!r}: 'world', 'tool' or 'base'")
    point = np.zeros(3) if frame == "base" else chain.tool
    turning = np.array([k == "revolute" for k in chain.kinds])[:, None]
    linear = np.where(turning, np.cross(chain.axes, point - chain.anchors), chain.axes)
    angular = np.where(turning, chain.axes, 0.0)
    if frame == "tool":
        linear, angular = linear @ chain.tool_axes, angular @ chain.tool_axes
    return np.vstack([linear.T, angular.T])
