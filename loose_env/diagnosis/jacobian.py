"""The Jacobian of a serial arm with a looseness joint in it (thesis 3.2.2).

A looseness joint is one more column of the Jacobian, whose rate nobody drives or measures.
Where the loose seat has moved by d, other columns change too; which ones depends on the point
and the frame in which the Jacobian is written, and they tell the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms.arm import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName

__all__ = [
    "Chain",
    "Frame",
    "JointKind",
    "changed_columns",
    "displaced",
    "geometric_jacobian",
    "insert_looseness",
    "link_of_changed_columns",
    "looseness_transform",
    "slot_direction",
    "tool_velocity",
    "velocity_error",
]

Array = NDArray[np.float64]
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
            _kind(kind)
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
        """Take the joints of an arm at a pose [rad] (n,) from its MuJoCo model.

        Bending modes of the arm stay at rest and are no joints of the chain.

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


def geometric_jacobian(chain: Chain, frame: Frame = "world") -> Array:
    """Columns of the Jacobian, linear part above angular part (3.2, 3.28, 3.29, 3.32).

    A revolute joint gives z × (p - o) and z, a prismatic one z and nothing. The thesis prints
    only the revolute form.

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


def tool_velocity(jacobian: ArrayLike, rates: ArrayLike) -> Array:
    """Velocity of the tool from the joints' (3.3); with ``J`` of the loose arm, (3.30).

    Parameters
    ----------
    jacobian : array (m, n)
        Any rows of the Jacobian.
    rates : array (n,) or (n, N)
        Joint velocities, the looseness joint's too if it is in the Jacobian.

    Raises
    ------
    InvalidData
        If the shapes do not match or a value is not finite.

    Examples
    --------
    >>> tool_velocity([[1.0, 2.0]], [0.5, 0.25])
    array([1.])
    """
    j, q = np.asarray(jacobian, dtype=float), np.asarray(rates, dtype=float)
    if j.ndim != 2 or q.ndim not in (1, 2) or q.shape[0] != j.shape[1]:
        raise InvalidData(
            f"a Jacobian of shape {j.shape} needs one rate for every column, got {q.shape}"
        )
    if not (np.isfinite(j).all() and np.isfinite(q).all()):
        raise InvalidData("Jacobian and rates must be finite")
    return np.asarray(j @ q)


def velocity_error(
    jacobian: ArrayLike, rates: ArrayLike, loose_jacobian: ArrayLike, loose_rates: ArrayLike
) -> Array:
    """Velocity of the loose arm's tool less that of the nominal arm (3.34).

    Examples
    --------
    >>> velocity_error([[1.0, 2.0]], [0.5, 0.5], [[1.0, 0.7, 2.0]], [0.5, 0.1, 0.5])
    array([0.07])
    """
    return tool_velocity(loose_jacobian, loose_rates) - tool_velocity(jacobian, rates)


def insert_looseness(
    chain: Chain,
    link: int,
    axis: ArrayLike,
    *,
    kind: JointKind = "prismatic",
    anchor: ArrayLike | None = None,
) -> Chain:
    """Put a looseness joint between joint ``link`` and what that joint moves (3.30-3.32).

    Parameters
    ----------
    chain : Chain
        The nominal arm.
    link : int
        Loose link, from 1; its looseness joint becomes column ``link`` counted from 0.
    axis : array (3,)
        Direction of the slide or axis of the hinge, in world coordinates.
    kind : {"prismatic", "revolute"}
        Slide or hinge.
    anchor : array (3,), optional
        A point of the axis [m]; by default that of joint ``link``. A slide needs none: its
        velocity is a free vector.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> loose = insert_looseness(Chain.of(planar(2), [0.0, 0.0]), 1, [0, 1, 0])
    >>> loose.kinds
    ('revolute', 'prismatic', 'revolute')
    """
    number, unit = _link(chain, link), _unit(axis)
    _kind(kind)
    place = chain.anchors[number - 1] if anchor is None else np.asarray(anchor, dtype=float)
    return replace(
        chain,
        kinds=(*chain.kinds[:number], kind, *chain.kinds[number:]),
        axes=np.insert(chain.axes, number, unit, axis=0),
        anchors=np.insert(chain.anchors, number, place, axis=0),
    )


def displaced(
    chain: Chain,
    link: int,
    axis: ArrayLike,
    displacement: float,
    *,
    kind: JointKind = "prismatic",
) -> Chain:
    """Move everything distal to a loose seat by the seat's displacement [m or rad].

    Joints 1 to ``link`` stay; later joints and the tool move along the slide, or turn about the
    hinge, which lies on joint ``link``.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> float(displaced(Chain.of(planar(2), [0.0, 0.0]), 1, [0, 1, 0], 2e-4).tool[1])
    0.0002
    """
    number = _link(chain, link)
    motion = looseness_transform(axis, displacement, kind=kind)
    turn, origin = motion[:3, :3], chain.anchors[number - 1]

    def moved(points: Array) -> Array:
        return np.asarray((points - origin) @ turn.T + origin + motion[:3, 3])

    axes, anchors = chain.axes.copy(), chain.anchors.copy()
    axes[number:] = axes[number:] @ turn.T
    anchors[number:] = moved(anchors[number:])
    return replace(
        chain,
        axes=axes,
        anchors=anchors,
        tool=moved(chain.tool),
        tool_axes=turn @ chain.tool_axes,
    )


def slot_direction(axis: ArrayLike, normal: ArrayLike) -> Array:
    """Direction of a slot: the joint's axis crossed with the slot's normal (3.27).

    Examples
    --------
    >>> slot_direction([0, 0, 1], [1, 0, 0])
    array([0., 1., 0.])
    """
    z, b = _unit(axis), _unit(normal)
    if abs(z @ b) > 1e-6:
        raise InvalidData(
            "the slot's normal must be perpendicular to the joint's axis; their scalar product "
            f"is {z @ b:.3g}"
        )
    return np.asarray(np.cross(z, b))


def looseness_transform(
    axis: ArrayLike, displacement: float, *, kind: JointKind = "prismatic"
) -> Array:
    """Homogeneous transform across a looseness joint, turned back to frame (i) (3.26).

    The frame of the looseness joint has its z axis along ``axis``. After the joint's own motion
    the inverse rotation restores the axes of frame (i), so the Denavit-Hartenberg parameters of
    the neighbours stay as they were.

    Parameters
    ----------
    axis : array (3,)
        Direction of the slide or of the hinge's axis in frame (i).
    displacement : float
        Motion of the looseness joint [m or rad].
    kind : {"prismatic", "revolute"}
        Slide or hinge.

    Returns
    -------
    ndarray (4, 4)
        For a slide, a pure translation along ``axis``.

    Examples
    --------
    >>> looseness_transform([0, 1, 0], 0.5)[:3, 3]
    array([0. , 0.5, 0. ])
    """
    z = _unit(axis)
    _kind(kind)
    if not np.isfinite(displacement):
        raise InvalidData(f"displacement must be finite, got {displacement!r}")
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z) / np.linalg.norm(np.cross(helper, z))
    to_loose = np.eye(4)
    to_loose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    motion = np.eye(4)
    if kind == "prismatic":
        motion[2, 3] = displacement
    else:
        c, s = np.cos(displacement), np.sin(displacement)
        motion[:2, :2] = [[c, -s], [s, c]]
    back = to_loose.T  # no translation in it, so its transpose is its inverse
    return to_loose @ motion @ back


def changed_columns(before: ArrayLike, after: ArrayLike, *, tolerance: float) -> NDArray[np.bool_]:
    """Which columns of a Jacobian changed by more than a tolerance (3.33), shape (n,).

    Parameters
    ----------
    before, after : array (m, n)
        The Jacobian without and with the seat displaced, in the same frame.
    tolerance : float
        Largest change taken for none: norm of the column's change, in units of the Jacobian.

    Examples
    --------
    >>> changed_columns([[1.0, 2.0]], [[1.1, 2.0]], tolerance=0.01)
    array([ True, False])
    """
    a, b = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    if a.ndim != 2 or a.shape != b.shape:
        raise InvalidData(f"both Jacobians must have the same shape, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InvalidData("both Jacobians must be finite")
    if not tolerance >= 0:
        raise InvalidSetting(f"tolerance must be zero or more, got {tolerance!r}")
    return np.asarray(np.linalg.norm(b - a, axis=0) > tolerance)


def link_of_changed_columns(changed: Sequence[bool] | NDArray[np.bool_], frame: Frame) -> int:
    """Find the link whose seat moved, from the columns that changed (after 3.33).

    In tool coordinates columns 1 to i change, where i is the loose link. At the world's origin
    columns i+1 to n change. At the tool point in world axes columns 1 to i change if the seat
    slides, and all may if it turns.

    Returns
    -------
    int
        The link, from 1; 0 where the columns name none: nothing changed, or at the base point
        everything did. A column parallel to the slide never changes, so that the last changed
        column is a lower bound of the link in a spatial arm.

    Raises
    ------
    InvalidData
        If the columns do not change in one block, which a single seat cannot cause.

    Examples
    --------
    >>> link_of_changed_columns([True, True, False], "tool")
    2
    """
    mask = np.asarray(changed, dtype=bool)
    if frame not in ("world", "tool", "base"):
        raise UnknownName(f"unknown frame {frame!r}: 'world', 'tool' or 'base'")
    count = int(mask.sum())
    block = mask[len(mask) - count :] if frame == "base" else mask[:count]
    if not block.all():
        raise InvalidData(
            f"columns {(np.flatnonzero(mask) + 1).tolist()} changed, which is not one block from "
            f"the {'tool' if frame == 'base' else 'base'}: check the tolerance, or look for a "
            "second seat"
        )
    if count == 0:
        return 0
    return len(mask) - count if frame == "base" else count


def _unit(axis: ArrayLike) -> Array:
    vector = np.asarray(axis, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not np.linalg.norm(vector) > 0:
        raise InvalidData(f"an axis is three finite numbers, not all zero; got {axis!r}")
    return np.asarray(vector / np.linalg.norm(vector))


def _kind(kind: str) -> None:
    if kind not in ("revolute", "prismatic"):
        raise UnknownName(f"a joint is 'revolute' or 'prismatic', got {kind!r}")


def _link(chain: Chain, link: int) -> int:
    if isinstance(link, bool) or not 1 <= link <= chain.n:
        raise UnknownName(f"the chain has links 1 to {chain.n}, counted from the base; got {link}")
    return int(link)
