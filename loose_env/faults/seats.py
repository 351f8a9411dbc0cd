"""Seats of faults: degrees of freedom, their kinds, their link motion and the load they carry.

A seat is one or more extra degrees of freedom between the flange of a link and the link
itself, called ``seat``, ``seat2``, ...: a slide for structural looseness, a hinge for rotational
looseness, the joint's own motion for backlash.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import mujoco
import numpy as np

from loose_env.arms import GRAVITY, Arm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    LooseSeat,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    is_fault,
    unit,
)
from loose_env.typing import Array

SEAT = "seat"
"""Name of the first loose degree of freedom in every model under test."""

SeatKind = Literal["slide", "hinge", "play"]
"""A slide along or a hinge about any axis of the link frame, or the joint's own motion."""

SinglePart = Healthy | Preload | StructuralLooseness | Backlash | RotationalLooseness
"""A fault of one degree of freedom."""


def parts_of(fault: Fault) -> tuple[SinglePart, ...]:
    """Decompose a fault into single-degree-of-freedom faults."""
    if isinstance(fault, SeveralFaults):
        return tuple(part for one in fault.faults for part in parts_of(one))
    return fault.parts if isinstance(fault, CompoundLooseness) else (fault,)


def gaps_of(fault: Fault) -> tuple[float, ...]:
    """Free travel of each part of a fault [m or rad]; 0 if nothing is loose."""
    return tuple(part.gap if isinstance(part, LooseSeat) else 0.0 for part in parts_of(fault))


_KIND_OF: dict[type[Any], SeatKind] = {
    Healthy: "slide",
    Preload: "slide",
    StructuralLooseness: "slide",
    RotationalLooseness: "hinge",
    Backlash: "play",
}


def part_seats(fault: Fault) -> tuple[tuple[int, ...], tuple[SeatKind, ...]]:
    """Link and kind of the seat of each part of a fault.

    There are no links where any will do.

    Raises
    ------
    UnknownName
        If it is no fault.

    Examples
    --------
    >>> play = Backlash(joint=3, gap=1e-3, stiffness=(1e3, 1e3))
    >>> slide = StructuralLooseness(link=1, direction=(1, 0, 0), gap=1e-4, stiffness=(1e5, 1e5))
    >>> part_seats(SeveralFaults(faults=(play, slide)))
    ((3, 1), ('play', 'slide'))
    >>> part_seats(Healthy())
    ((), ('slide',))
    """
    if not is_fault(fault):
        raise UnknownName(
            "a fault is Healthy, Preload, StructuralLooseness, Backlash, RotationalLooseness, "
            f"CompoundLooseness or SeveralFaults, got {type(fault).__name__}: {fault!r}"
        )
    parts = parts_of(fault)
    kinds = tuple(_KIND_OF[type(part)] for part in parts)
    return tuple(_link_of(part) for part in parts if not isinstance(part, Healthy)), kinds


def _link_of(part: Preload | LooseSeat) -> int:
    """Number of the link that carries the seat of a part."""
    return part.link if isinstance(part, Preload) else part.place


def seats_of(fault: Fault) -> tuple[int | None, tuple[SeatKind, ...]]:
    """Link of one fault's seat (None: any) and the kind of each of its parts.

    Raises
    ------
    InvalidSetting
        If there are several faults.
    UnknownName
        If it is no fault.

    Examples
    --------
    >>> seats_of(Backlash(joint=2, gap=1e-3, stiffness=(1e3, 1e3)))
    (2, ('play',))
    """
    if isinstance(fault, SeveralFaults):
        raise InvalidSetting(
            "several faults have seats on several links: take them one by one, or use part_seats"
        )
    links, kinds = part_seats(fault)
    return links[0] if links else None, kinds


def seat_of(fault: Fault) -> tuple[int | None, SeatKind]:
    """Link of a thesis fault's seat (None: any) and the kind of that seat.

    For callers that know one slide or the play of a joint; `seats_of` knows every fault.

    Raises
    ------
    InvalidSetting
        If the fault is a rotation, has several parts or is several faults.
    """
    if isinstance(fault, (RotationalLooseness, CompoundLooseness, SeveralFaults)):
        raise InvalidSetting(
            f"{fault.hypothesis} is not dealt with here: give a Healthy, Preload, "
            "StructuralLooseness or Backlash"
        )
    link, (kind,) = seats_of(fault)
    return link, kind


def twist_of(arm: Arm, part: SinglePart) -> Array:
    """Twist of a link per unit travel of its seat, about the origin of its frame.

    Parameters
    ----------
    arm : Arm
        The arm.
    part : StructuralLooseness, Preload, RotationalLooseness or Backlash
        One degree of freedom of a seat.

    Returns
    -------
    ndarray (3,) or (6,)
        Velocity of the link frame's origin, then angular velocity, both in the link frame [1 or
        m, rad]: x, y and the turn about z for an arm in the plane, else all six.

    Raises
    ------
    InvalidSetting
        If the fault is no single degree of freedom.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> rocking = RotationalLooseness(
    ...     link=1, axis=(0, 0, 1), gap=1e-3, stiffness=(1e3, 1e3), pivot=(0.1, 0, 0)
    ... )
    >>> twist_of(planar(2), rocking).tolist()
    [0.0, -0.1, 1.0]
    """
    velocity, turn = np.zeros(3), np.zeros(3)
    if isinstance(part, (StructuralLooseness, Preload)):
        velocity = unit(part.direction)
    elif isinstance(part, RotationalLooseness):
        turn = unit(part.axis)
        velocity = np.cross(np.asarray(part.pivot, dtype=float), turn)
    elif isinstance(part, Backlash):
        joint = arm.model.joint(arm.joints[arm.link_number(part.joint) - 1])
        if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
            velocity = joint.axis.copy()
        else:
            turn = joint.axis.copy()
            velocity = np.cross(joint.pos, turn)
    else:
        raise InvalidSetting(f"a twist is that of one loose degree of freedom, got {part!r}")
    if len(arm.axes) == 2:
        return np.array([*velocity[:2], turn[2]])
    return np.concatenate([velocity, turn])


def seat_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the loose degrees of freedom of a model, from the flange outward."""
    names: list[str] = []
    while mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, seat_name(len(names))) >= 0:
        names.append(seat_name(len(names)))
    return tuple(names)


def seat_name(k: int) -> str:
    """Name of the k-th loose degree of freedom, counted from 0."""
    return SEAT if k == 0 else f"{SEAT}{k + 1}"


def seat_weight(arm: Arm, part: SinglePart) -> float:
    """Maximum load of 1 g, in any direction, on a seat of the nominal arm at zero pose.

    A slide carries the weight m g of all that lies beyond it; a hinge that weight times the
    distance of its centre of mass from the axis.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    part : StructuralLooseness, RotationalLooseness or Backlash
        One degree of freedom of a seat.

    Returns
    -------
    float
        Force of a slide [N], torque of a hinge [N·m].

    Raises
    ------
    InvalidSetting
        If the fault is no single degree of freedom.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> slide = StructuralLooseness(link=1, direction=(1, 0, 0), gap=1e-4, stiffness=(1e5, 1e5))
    >>> arm = planar(2)
    >>> mass = arm.model.body(arm.seat_bodies[0]).subtreemass[0]
    >>> bool(np.isclose(seat_weight(arm, slide), 9.81 * mass))
    True
    """
    twist = twist_of(arm, part)
    if len(twist) == 3:  # in the plane: x, y and the turn about z
        twist = np.array([twist[0], twist[1], 0.0, 0.0, 0.0, twist[2]])
    link = _link_of(part)  # type: ignore[arg-type]
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = 0.0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    body = model.body(arm.seat_bodies[arm.link_number(link) - 1]).id
    frame = data.xmat[body].reshape(3, 3)
    centre = frame.T @ (data.subtree_com[body] - data.xpos[body])
    per_travel = twist[:3] + np.cross(twist[3:], centre)
    return float(GRAVITY * model.body_subtreemass[body] * np.linalg.norm(per_travel))


def preloaded(arm: Arm, fault: Fault, share: float) -> Fault:
    """Preload every loose seat of a fault on its upper stop by a share of its weight.

    At 1 it takes a shake of 1 g along the seat to open it.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    fault : Fault
        The fault. Where nothing is loose, nothing changes.
    share : float
        Load over `seat_weight` [1]; below zero it presses on the lower stop.

    Raises
    ------
    InvalidSetting
        If the share is no finite number.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> play = Backlash(joint=2, gap=1e-3, stiffness=(1e3, 1e3))
    >>> pressed = preloaded(planar(2), play, 0.5)
    >>> pressed.preload == 0.5 * seat_weight(planar(2), play)
    True
    """
    if isinstance(fault, LooseSeat):
        if not np.isfinite(share):
            raise InvalidSetting(f"a share of the weight is a finite number, got {share!r}")
        return replace(fault, preload=float(share) * seat_weight(arm, fault))
    if isinstance(fault, (CompoundLooseness, SeveralFaults)):
        name = "parts" if isinstance(fault, CompoundLooseness) else "faults"
        pressed = tuple(preloaded(arm, one, share) for one in getattr(fault, name))
        return replace(fault, **{name: pressed})  # type: ignore[arg-type]
    return fault
