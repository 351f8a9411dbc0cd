"""A looseness joint in a serial arm: one more joint, neither driven nor measured (3.2.2).

It is one more column of the Jacobian. Where the loose seat has moved by d, other columns change
too; which ones depends on the point and the frame of the Jacobian, and they locate the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData, UnknownName
from loose_env.faults import (
    SEAT,
    Backlash,
    Healthy,
    Preload,
    StructuralLooseness,
    seat_of,
    seated_spec,
)
from loose_env.kinematics import Chain, Frame, JointKind, require_kind
from loose_env.typing import Array


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
    chain: Chain, link: int, axis: ArrayLike, displacement: float, *, kind: JointKind = "prismatic"
) -> Chain:
    """Move everything distal to a loose seat by its displacement [m or rad]; no more (3.33).

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
        chain, axes=axes, anchors=anchors, tool=moved(chain.tool), tool_axes=turn @ chain.tool_axes
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
    """Tool velocity (m,) from a Jacobian (m, n) and joint velocities (n,): (3.3, 3.53, 4.21).

    With the looseness joint's column and rate among them it is that of the loose arm (3.30).

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
    """Mask (n,) of the columns of a Jacobian (m, n) that changed beyond a tolerance.

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
    return np.asarray(vector / np.linalg.norm(vector))


def _link(chain: Chain, link: int) -> int:
    if isinstance(link, bool) or not 1 <= link <= chain.n:
        raise UnknownName(f"the chain has links 1 to {chain.n}, counted from the base; got {link}")
    return int(link)


@dataclass(frozen=True, slots=True)
class Condition:
    """Condition number of an inertia matrix, twice."""

    raw: float
    """In SI units: largest eigenvalue over smallest. Depends on the unit of length."""
    scaled: float
    """Of the matrix with a unit diagonal; no choice of units changes it."""


def seated_inertia(
    arm: Arm, pose: ArrayLike, fault: Healthy | Preload | StructuralLooseness | Backlash
) -> Array:
    """Inertia matrix M of the driven joints and, for a fault, its seat, ordered as in (3.43).

    ``arm``: the arm; its bending modes are at rest and left out. ``pose`` (n,): joint positions
    [rad]. ``fault``: the seat. Healthy gives the nominal (n, n) matrix. Returns (n, n) or (n+1,
    n+1): joints first, base to tool, then the seat [kg m², kg m, kg].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> fault = StructuralLooseness(link=2, direction=(0, 1, 0), gap=2e-4, stiffness=(1e5, 1e5))
    >>> seated_inertia(planar(2), [0.0, 0.5], fault).shape
    (3, 3)
    """
    q = np.asarray(pose, dtype=float)
    link, kind = seat_of(fault)
    names = list(arm.joints)
    if isinstance(fault, Healthy) or link is None:
        model = arm.model
    else:
        spec = seated_spec(arm, link, kind)
        if isinstance(fault, (StructuralLooseness, Preload)):
            spec.joint(SEAT).axis = list(fault.direction)
        model = spec.compile()
        names.append(SEAT)
    data = mujoco.MjData(model)
    for name, value in zip(arm.joints, q, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    return full[np.ix_(dofs, dofs)]


def condition_of(inertia: ArrayLike) -> Condition:
    """Condition number of an inertia matrix, raw and scaled to a unit diagonal.

    Examples
    --------
    >>> condition_of([[4.0, 0.0], [0.0, 1.0]])
    Condition(raw=4.0, scaled=1.0)
    """
    m = np.asarray(inertia, dtype=float)
    values = np.linalg.eigvalsh(m)
    if values[0] <= 0:
        raise InvalidData(
            f"an inertia matrix is positive definite; the smallest eigenvalue is {values[0]:.3g}"
        )
    size = np.sqrt(np.diag(m))
    unit = np.linalg.eigvalsh(m / np.outer(size, size))
    return Condition(raw=float(values[-1] / values[0]), scaled=float(unit[-1] / unit[0]))


def backlash_condition(ratio: float) -> float:
    """Scaled condition number of one joint with play, in closed form.

    Motor side of inertia ``ratio`` times that of the link side: M = I [[1 + r, 1], [1, 1]],
    condition (1 + c) / (1 - c) with c = (1 + r)^(-1/2), about 4 / r for a light motor side.

    ``ratio``: motor side over link side, seen at the joint; gears multiply a rotor's inertia by the
    square of their ratio.

    Examples
    --------
    >>> round(backlash_condition(3.0), 6)
    3.0
    """
    coupling = 1 / np.sqrt(1 + ratio)
    # 1 - c = r c² / (1 + c): no cancellation for a light motor side.
    return float((1 + coupling) ** 2 / (ratio * coupling**2))
