"""Insertion of a seat into a MuJoCo spec, and of fault parameters into its model.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms import FASTEST_TURN, Arm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults.faults import (
    Backlash,
    Fault,
    Healthy,
    LooseSeat,
    Preload,
    RotationalLooseness,
    unit,
)
from loose_env.faults.seats import SeatKind, SinglePart, parts_of, seat_name, seat_names
from loose_env.typing import Array

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
        If a seat has more degrees of freedom than a body can, six with the link's own, or not
        every degree of freedom has its link.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> bare, seated = planar(2), seated_spec(planar(2), 1, "slide")
    >>> len(seated.joints) - len(bare.spec.joints)
    1
    """
    wanted = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    for kind in wanted:
        if kind not in ("slide", "hinge", "play"):
            raise UnknownName(f"a seat is a 'slide', a 'hinge' or a 'play', got {kind!r}")
    links = tuple(link) if isinstance(link, Sequence) else (link,) * max(len(wanted), 1)
    if len(links) != max(len(wanted), 1):
        raise InvalidSetting(
            f"each of {len(wanted)} degrees of freedom stands on one link, got links {links}"
        )
    spec = arm.spec.copy()
    for number in dict.fromkeys(arm.link_number(at) for at in links):
        own = {
            k: kind for k, (at, kind) in enumerate(zip(links, wanted, strict=False)) if at == number
        }
        _seat_link(arm, spec, number, own)
    return spec


def _seat_link(arm: Arm, spec: mujoco.MjSpec, number: int, kinds: Mapping[int, SeatKind]) -> None:
    """Add a seat to one link; kinds are encoded by their index."""
    body = spec.body(arm.seat_bodies[number - 1])
    joint = spec.joint(arm.joints[number - 1])
    if not 1 <= len(kinds) <= 6 - len(body.joints):
        raise InvalidSetting(
            f"the seat of link {number} of arm {arm.name!r} takes 1 to {6 - len(body.joints)} "
            f"degrees of freedom, got {len(kinds)}"
        )
    slides, hinges = iter(np.eye(3)), iter(_frame_about(np.array(joint.axis)))
    for k, kind in kinds.items():
        turns = kind == "hinge" or (kind == "play" and joint.type == _HINGE)
        if kind == "slide":
            axis = next(slides, None)
        else:
            axis = np.array(joint.axis) if kind == "play" else next(hinges, None)
        if axis is None:
            raise InvalidSetting(
                f"a seat has three slides and three hinges at most, got {tuple(kinds.values())}"
            )
        _add_seat(spec, body, seat_name(k), axis, joint.pos if turns else None)


def _frame_about(axis: Array) -> Array:
    """Three axes for the hinges of a seat, the joint's own first (3, 3)."""
    first = axis / np.linalg.norm(axis)
    second = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    second = second / np.linalg.norm(second)
    return np.array([axis, second, np.cross(first, second)])


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

    Call it after every change of masses, once ``mj_setConst`` has run: the stops are scaled
    with the seat's inverse weight, that along the fault's direction. ``data`` is scratch space of
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
    placed = False
    for at, part in zip(seat, parts, strict=True):
        placed |= _place(model, at, part)
    if placed:
        # The inverse weight follows the axis.
        mujoco.mj_setConst(model, mujoco.MjData(model) if data is None else data)
    for at, part in zip(seat, parts, strict=True):
        _set_part(model, at, part)
    if len(parts) > 1 and not isinstance(fault, Healthy):
        _require_slow_together(model, seat, fault, data)


def _place(model: mujoco.MjModel, at: SeatIndices, part: SinglePart) -> bool:
    """Orient a seat along the fault's direction; return whether anything changed."""
    if isinstance(part, (Healthy, Backlash)):
        return False
    seat = at.joint
    hinge = isinstance(part, RotationalLooseness)
    if model.jnt_type[seat] != (_HINGE if hinge else _SLIDE):
        raise InvalidSetting(
            f"{part.hypothesis} needs a {'hinge' if hinge else 'slide'}, which {at.name!r} of the "
            "model is not; take the seat that seats_of names"
        )
    if isinstance(part, RotationalLooseness):
        model.jnt_axis[seat] = unit(part.axis)
        model.jnt_pos[seat] = part.pivot
    else:
        model.jnt_axis[seat] = unit(part.direction)
    return True


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
