"""Seats of faults, the extra degrees of freedom of looseness, added to and set in a MuJoCo model.

A seat is one or more extra degrees of freedom between the flange of a link and the link
itself, called ``seat``, ``seat2``, ...: a slide for structural looseness, a hinge for rotational
looseness, the joint's own motion for backlash.

Every arm under test has a seat, of one degree of freedom or more. Healthy arms have it too,
shut by an equality constraint, so that all arms with as many degrees of freedom in their seats
share one model layout.

The stop law. With ``r`` the penetration and ``v`` its rate, a stop pushes back with

    f = max(0, k r + c v + J dv/dt),

where ``J`` is 1e-4 of the seat's effective mass: the smallest inertance MuJoCo's
constraints allow (impedance 1e-4, direct ``solref`` scaled with the inverse weight, so that
``k`` and ``c`` really are N/m and N·s/m, for a hinge N·m/rad and N·m·s/rad). Guide friction is
Coulomb friction that truly sticks (impedance 0.9999). Where a seat has several degrees of
freedom, each has stops and friction of its own. A preload is a constant force: that of a spring
which rests 1e4 m or rad away, so that it changes by a 1e-7th where the seat moves by 1 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from loose_env.arms import FASTEST_TURN, GRAVITY, Arm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults.faults import (
    Backlash,
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
    return fault.faults if isinstance(fault, SeveralFaults) else (fault,)


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
            f"or SeveralFaults, got {type(fault).__name__}: {fault!r}"
        )
    parts = parts_of(fault)
    kinds = tuple(_KIND_OF[type(part)] for part in parts)
    return tuple(_link_of(part) for part in parts if not isinstance(part, Healthy)), kinds


def _link_of(part: Preload | LooseSeat) -> int:
    """Number of the link that carries the seat of a part."""
    return part.link if isinstance(part, Preload) else part.place


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
    if isinstance(fault, SeveralFaults):
        pressed: Any = tuple(preloaded(arm, one, share) for one in fault.faults)
        return replace(fault, faults=pressed)
    return fault


_SOFT, _STIFF = 1e-4, 0.9999  # MuJoCo's smallest and largest constraint impedance
_FAR = 1.0  # a stop that is never reached [m or rad]
_PULLED_FROM = 1e4  # where the soft spring of a preload rests [m or rad]
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def seated_spec(
    arm: Arm, link: int | Sequence[int], kinds: SeatKind | Sequence[SeatKind]
) -> mujoco.MjSpec:
    """Copy the arm's spec and add a seat to ``link``: joints, stops and locks.

    The spec is the same for every fault on that seat; `set_seat` writes the fault's parameters
    into the compiled model.

    Parameters
    ----------
    arm : Arm
        The arm.
    link : int or sequence of int
        Link that gets the seat, from 1 at the base; or, for seats on several links, that of each
        degree of freedom.
    kinds : SeatKind or sequence of them
        Kind of each degree of freedom, from the flange outward. "play" moves as the link's joint
        does: a hinge about its axis, or a slide along it. The axes of the others are
        preliminary.

    Raises
    ------
    UnknownName
        If the arm has no such link, or a kind is not "slide", "hinge" or "play".
    InvalidSetting
        If not every degree of freedom has a link of its own.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> bare, seated = planar(2), seated_spec(planar(2), 1, "slide")
    >>> len(seated.joints) - len(bare.spec.joints)
    1
    """
    wanted = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    links = tuple(link) if isinstance(link, Sequence) else (link,)
    if len(links) != len(wanted) or len(set(links)) != len(links) or not links:
        raise InvalidSetting(
            f"each of {len(wanted)} degrees of freedom stands on a link of its own, got links "
            f"{links}"
        )
    spec = arm.spec.copy()
    for k, (at, kind) in enumerate(zip(links, wanted, strict=True)):
        if kind not in get_args(SeatKind):
            raise UnknownName(f"a seat is a 'slide', a 'hinge' or a 'play', got {kind!r}")
        number = arm.link_number(at)
        body, joint = spec.body(arm.seat_bodies[number - 1]), spec.joint(arm.joints[number - 1])
        turns = kind == "hinge" or (kind == "play" and joint.type == _HINGE)
        axis = np.eye(3)[0] if kind == "slide" else np.array(joint.axis)
        _add_seat(spec, body, seat_name(k), axis, joint.pos if turns else None)
    return spec


def _add_seat(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, axis: Array, anchor: Array | None
) -> None:
    """Add one degree of freedom, its two stops and its lock; a hinge has an anchor."""
    body.add_joint(
        name=name,
        type=_SLIDE if anchor is None else _HINGE,
        axis=axis,
        pos=[0, 0, 0] if anchor is None else anchor,
        # A tiny friction loss keeps the friction row in every layout.
        frictionloss=1e-9,
        solimp_friction=[_STIFF, _STIFF, 0.001, 0.5, 2],
    )
    for side, limits in (("low", (0.0, 2 * _FAR)), ("high", (-2 * _FAR, 0.0))):
        stop = spec.add_tendon(
            name=f"{name}_{side}",
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=list(limits),
            solimp_limit=[_SOFT, _SOFT, 0.001, 0.5, 2],
        )
        stop.wrap_joint(name, 1.0)
    spec.add_equality(
        name=f"{name}_lock",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=name,
        solimp=[_STIFF, _STIFF, 0.001, 0.5, 2],
    )


@dataclass(frozen=True, kw_only=True)
class SeatIndices:
    """Indices of one part of a seat in a compiled model."""

    name: str
    joint: int
    dof: int
    position: int
    lock: int
    """Equality constraint that shuts it."""
    low: int
    """Tendon of its lower stop."""
    high: int
    """Tendon of its upper stop."""


def seat_indices(model: mujoco.MjModel) -> tuple[SeatIndices, ...]:
    """Look up the parts of a model's seat, from the flange outward."""
    found = []
    for name in seat_names(model):
        joint = model.joint(name)
        found.append(
            SeatIndices(
                name=name,
                joint=int(joint.id),
                dof=int(joint.dofadr[0]),
                position=int(joint.qposadr[0]),
                lock=int(model.equality(f"{name}_lock").id),
                low=int(model.tendon(f"{name}_low").id),
                high=int(model.tendon(f"{name}_high").id),
            )
        )
    return tuple(found)


def set_seat(
    model: mujoco.MjModel,
    fault: Fault,
    data: mujoco.MjData | None = None,
    seat: tuple[SeatIndices, ...] | None = None,
) -> None:
    """Write a fault's parameters into a compiled model that has its seat.

    Call it after every change of masses: the stops are scaled with the seat's inverse weight, that
    along the fault's direction, for which ``mj_setConst`` is run here. ``data`` is scratch space of
    the model's layout, made anew if it is not given; ``seat`` are the model's `seat_indices`,
    looked up if they are not given.

    Raises
    ------
    InvalidSetting
        If the model has no such seat, a gap is wider than 2 m or rad, or a stop or a preloaded
        seat is too stiff for the simulation step; several stops that are touched at once make a
        stiffer one.
    """
    if seat is None:
        seat = seat_indices(model)
    parts = (fault,) * len(seat) if isinstance(fault, Healthy) else parts_of(fault)
    if len(parts) != len(seat):
        raise InvalidSetting(
            f"{fault.hypothesis} has {len(parts)} loose degrees of freedom, the model's seat has "
            f"{len(seat)}; take the seats that part_seats names"
        )
    for at, part in zip(seat, parts, strict=True):
        _place(model, at, part)
    # The inverse weight follows the axis.
    mujoco.mj_setConst(model, mujoco.MjData(model) if data is None else data)
    for at, part in zip(seat, parts, strict=True):
        _set_part(model, at, part)
    if len(parts) > 1 and not isinstance(fault, Healthy):
        _require_slow_together(model, seat, fault, data)


def _place(model: mujoco.MjModel, at: SeatIndices, part: SinglePart) -> None:
    """Orient a seat along the fault's direction."""
    if isinstance(part, (Healthy, Backlash)):
        return
    seat = at.joint
    hinge = isinstance(part, RotationalLooseness)
    if model.jnt_type[seat] != (_HINGE if hinge else _SLIDE):
        raise InvalidSetting(
            f"{part.hypothesis} needs a {'hinge' if hinge else 'slide'}, which {at.name!r} of the "
            "model is not; take the seat that part_seats names"
        )
    if isinstance(part, RotationalLooseness):
        model.jnt_axis[seat] = unit(part.axis)
        model.jnt_pos[seat] = part.pivot
    else:
        model.jnt_axis[seat] = unit(part.direction)


def _set_part(model: mujoco.MjModel, at: SeatIndices, part: SinglePart) -> None:
    step = model.opt.timestep
    dof, lock, low, high = at.dof, at.lock, at.low, at.high
    model.eq_active0[lock] = isinstance(part, Healthy)
    model.eq_solref[lock] = (2 * step, 1.0)
    model.dof_solref[dof] = (2 * step, 1.0)
    friction, reach = 0.0, _FAR
    stops = ((1.0, 0.0), (1.0, 0.0))
    if isinstance(part, LooseSeat):
        friction, reach = part.friction, part.gap / 2
        if reach > _FAR:
            raise InvalidSetting(
                f"a gap of {part.gap:g} is wider than a seat has room for, {2 * _FAR:g} m or rad"
            )
        stops = tuple(zip(part.stiffness, part.damping, strict=True))  # type: ignore[assignment]
    model.dof_frictionloss[dof] = max(friction, 1e-9)
    model.tendon_range[low] = (-reach, 2 * _FAR)
    model.tendon_range[high] = (-2 * _FAR, reach)
    for stop, (stiffness, damping) in zip((low, high), stops, strict=True):
        weight = (1 - _SOFT) * model.tendon_invweight0[stop]
        _require_slow("a stop", stiffness, damping, weight, step)
        # The direct format needs both numbers negative; MuJoCo takes 0 as its default.
        model.tendon_solref_lim[stop] = (
            -max(stiffness * weight, 1e-12),
            -max(damping * weight, 1e-12),
        )
    closed, rest = (0.0, 0.0), 0.0
    if isinstance(part, LooseSeat) and part.preload:
        closed = (abs(part.preload) / _PULLED_FROM, 0.0)
        rest = float(np.copysign(_PULLED_FROM, part.preload))
    if isinstance(part, Preload):
        closed = (part.stiffness, part.damping)
        _require_slow("a preloaded seat", *closed, model.dof_invweight0[dof], step)
    model.jnt_stiffness[at.joint], model.dof_damping[dof] = closed
    model.qpos_spring[at.position] = rest


def _require_slow(what: str, stiffness: float, damping: float, weight: float, step: float) -> None:
    """Reject a spring or damper too stiff for the time step; ``weight`` is inverse mass."""
    if stiffness * weight * step**2 > FASTEST_TURN**2:
        mode = np.sqrt(stiffness * weight) / (2 * np.pi)
        raise InvalidSetting(
            f"{what} with a stiffness of {stiffness:g} has a contact mode of {mode:.0f} Hz, too "
            f"fast for a step of {step:g} s; use {FASTEST_TURN**2 / weight / step**2:.3g} at "
            f"most, or a step of {FASTEST_TURN / np.sqrt(stiffness * weight):.2g} s at most"
        )
    # Stable explicit stepping of a spring and a damper needs w h (k h + 2 c) < 4.
    if weight * step * (stiffness * step + 2 * damping) >= 4:
        most = (4 / (weight * step) - stiffness * step) / 2
        raise InvalidSetting(
            f"{what} with a damping of {damping:g} is too stiff for a step of {step:g} s; use "
            f"less than {most:.3g}"
        )


def _require_slow_together(
    model: mujoco.MjModel,
    seat: Sequence[SeatIndices],
    fault: Fault,
    data: mujoco.MjData | None,
) -> None:
    """Reject stops that are too stiff for the time step when all parts are in contact."""
    scratch = mujoco.MjData(model) if data is None else data
    dofs = np.array([at.dof for at in seat])
    mujoco.mj_resetData(model, scratch)
    mujoco.mj_fwdPosition(model, scratch)
    inverse = np.zeros((len(seat), model.nv))
    mujoco.mj_solveM(model, scratch, inverse, np.eye(model.nv)[dofs])
    mobility = inverse[:, dofs]
    step = model.opt.timestep
    loose = [part for part in parts_of(fault) if isinstance(part, LooseSeat)]
    stiffness = np.array([max(p.stiffness) for p in loose])
    damping = np.array([max(p.damping) for p in loose])

    def fastest(diagonal: Array) -> float:
        root = np.sqrt(diagonal)
        return float(np.linalg.eigvalsh(root[:, None] * mobility * root)[-1])

    spring = fastest(stiffness) * step**2
    both = fastest(stiffness * step**2 + 2 * damping * step)
    if spring > FASTEST_TURN**2 or both >= 4:
        share = min(FASTEST_TURN**2 / max(spring, 1e-300), 4 / max(both, 1e-300))
        raise InvalidSetting(
            f"the stops of {fault.hypothesis}, stiffness {stiffness.tolist()} and damping "
            f"{damping.tolist()}, are too stiff together for a step of {step:g} s; multiply all by "
            f"less than {share:.3g}, or use a smaller step"
        )
