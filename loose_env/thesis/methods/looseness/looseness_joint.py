"""A looseness joint in a serial arm: one more joint, neither driven nor measured (3.2.2).

It is one more column of the Jacobian. Where the loose seat has moved by d, other columns change
too; which ones depends on the point and the frame of the Jacobian, and they locate the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData, UnknownName
from loose_env.kinematics import Chain, Frame, JointKind, require_kind
from loose_env.typing import Array

__all__ = ["displaced", "insert_looseness", "looseness_transform", "slot_direction"]


def insert_looseness(
    chain: Chain,
    link: int,
    axis: ArrayLike,
    *,
    kind: JointKind = "prismatic",
    anchor: ArrayLike | None = None,
) -> Chain:
    """Put a looseness joint between joint ``link`` and what that joint moves (3.30-3.32).

    ``link``: loose link, from 1; its looseness joint becomes column ``link`` counted from 0.
    ``axis`` (3,): direction of the slide or axis of the hinge, in world coordinates. ``anchor``
    (3,): point of the axis [m]; by default that of joint ``link``. A slide needs none: its velocity
    is a free vector.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> loose = insert_looseness(Chain.of(planar(2), [0.0, 0.0]), 1, [0, 1, 0])
    >>> loose.kinds
    ('revolute', 'prismatic', 'revolute')
    """
    number, unit = _link(chain, link), _unit(axis)
    require_kind(kind)
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

    ``axis`` (3,): direction of the slide or of the hinge's axis in frame (i). ``displacement``:
    motion of the looseness joint [m or rad]. Returns (4, 4): for a slide, a pure translation along
    ``axis``.

    Examples
    --------
    >>> looseness_transform([0, 1, 0], 0.5)[:3, 3]
    array([0. , 0.5, 0. ])
    """
    z = _unit(axis)
    require_kind(kind)
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


def tool_velocity(jacobian: ArrayLike, rates: ArrayLike) -> Array:
    """Tool velocity (m,) from a Jacobian (m, n) and joint velocities (n,) (3.3); loose arm (3.30).

    Examples
    --------
    >>> tool_velocity([[1.0, 2.0]], [0.5, 0.25])
    array([1.])
    """
    return np.asarray(np.asarray(jacobian) @ np.asarray(rates))


def velocity_error(
    jacobian: ArrayLike, rates: ArrayLike, loose_jacobian: ArrayLike, loose_rates: ArrayLike
) -> Array:
    """Tool velocity of the loose arm minus that of the nominal arm (3.34).

    Examples
    --------
    >>> velocity_error([[1.0, 2.0]], [0.5, 0.5], [[1.0, 0.7, 2.0]], [0.5, 0.1, 0.5])
    array([0.07])
    """
    return tool_velocity(loose_jacobian, loose_rates) - tool_velocity(jacobian, rates)


def changed_columns(before: ArrayLike, after: ArrayLike, *, tolerance: float) -> NDArray[np.bool_]:
    """Mask (n,) of the columns of a Jacobian (m, n) that changed beyond a tolerance (3.33).

    Examples
    --------
    >>> changed_columns([[1.0, 2.0]], [[1.1, 2.0]], tolerance=0.01)
    array([ True, False])
    """
    return np.asarray(np.linalg.norm(np.subtract(after, before), axis=0) > tolerance)


def link_of_changed_columns(changed: Sequence[bool] | NDArray[np.bool_], frame: Frame) -> int:
    """Locate the loose link from the changed columns (after 3.33).

    In tool coordinates columns 1 to i change, where i is the loose link. At the world's origin
    columns i+1 to n change. At the tool point in world axes columns 1 to i change if the seat
    slides, and all may if it turns. A column parallel to the slide never changes, so that the last
    changed column is a lower bound of the link in a spatial arm. Returns the link, from 1; 0 where
    the columns identify none: nothing changed, or at the base point everything did.

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


def _link(chain: Chain, link: int) -> int:
    if isinstance(link, bool) or not 1 <= link <= chain.n:
        raise UnknownName(f"the chain has links 1 to {chain.n}, counted from the base; got {link}")
    return int(link)
