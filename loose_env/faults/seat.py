"""Seats of faults: degrees of freedom, their kinds and their link motion.

A seat is one or more extra degrees of freedom between the flange of a link and the link
itself, called ``seat``, ``seat2``, ...: a slide for structural looseness, a hinge for rotational
looseness, the joint's own motion for backlash.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    unit,
)
from loose_env.typing import Array

__all__ = [
    "SEAT",
    "SeatKind",
    "SinglePart",
    "gaps_of",
    "part_seats",
    "parts_of",
    "seat_name",
    "seat_names",
    "seat_of",
    "seats_of",
    "twist_of",
]

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
    return tuple(
        0.0 if isinstance(part, (Healthy, Preload)) else part.gap for part in parts_of(fault)
    )


def part_seats(fault: Fault) -> tuple[tuple[int, ...], tuple[SeatKind, ...]]:
    """Link and kind of the seat of each part of a fault.

    There are no links where any will do.

    Examples
    --------
    >>> play = Backlash(joint=3, gap=1e-3, stiffness=(1e3, 1e3))
    >>> slide = StructuralLooseness(link=1, direction=(1, 0, 0), gap=1e-4, stiffness=(1e5, 1e5))
    >>> part_seats(SeveralFaults(faults=(play, slide)))
    ((3, 1), ('play', 'slide'))
    >>> part_seats(Healthy())
    ((), ('slide',))
    """
    if isinstance(fault, SeveralFaults):
        links, kinds = zip(*(part_seats(one) for one in fault.faults), strict=True)
        return sum(links, ()), sum(kinds, ())
    link, own = seats_of(fault)
    return (() if link is None else (link,) * len(own)), own


def seats_of(fault: Fault) -> tuple[int | None, tuple[SeatKind, ...]]:
    """Link of a fault's seat (None: any) and the kind of each of its parts.

    For one fault; `part_seats` knows several as well.

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
    if isinstance(fault, CompoundLooseness):
        return fault.link, tuple(
            "slide" if isinstance(part, StructuralLooseness) else "hinge" for part in fault.parts
        )
    if isinstance(fault, Backlash):
        return fault.joint, ("play",)
    if isinstance(fault, RotationalLooseness):
        return fault.link, ("hinge",)
    if isinstance(fault, (StructuralLooseness, Preload)):
        return fault.link, ("slide",)
    if isinstance(fault, Healthy):
        return None, ("slide",)
    raise UnknownName(
        "a fault is Healthy, Preload, StructuralLooseness, Backlash, RotationalLooseness, "
        f"CompoundLooseness or SeveralFaults, got {type(fault).__name__}: {fault!r}"
    )


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
        velocity = unit("a direction", part.direction)
    elif isinstance(part, RotationalLooseness):
        turn = unit("an axis", part.axis)
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
