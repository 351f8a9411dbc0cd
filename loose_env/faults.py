"""What can be wrong with an arm, and how a fault is seated in a MuJoCo spec.

A seat is one extra degree of freedom called ``seat`` between the flange of a link and the
link itself: a slide for structural looseness, a hinge about the joint's own axis for
backlash. Every arm under test has exactly one. Healthy arms have it too, shut by an
equality constraint, so that all arms share one model layout.

The stop law. With ``r`` the penetration and ``v`` its rate, a stop pushes back with

    f = max(0, k r + c v + J dv/dt),

where ``J`` is 1e-4 of the seat's effective mass: the smallest inertance MuJoCo's
constraints allow (impedance 1e-4, direct ``solref`` scaled with the inverse weight, so that
``k`` and ``c`` really are N/m and N·s/m). Guide friction is Coulomb friction that truly
sticks (impedance 0.9999).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.errors import InvalidSetting, UnknownName

__all__ = [
    "FASTEST_STOP",
    "SEAT",
    "Backlash",
    "Fault",
    "FaultKind",
    "Healthy",
    "Preload",
    "SeatKind",
    "StructuralLooseness",
    "hypotheses",
    "place_of",
    "seat_of",
    "seated_spec",
    "set_seat",
]

SEAT = "seat"
"""Name of the loose degree of freedom in every model under test."""

FASTEST_STOP = 1.4
"""Largest angle [rad] by which a contact mode may turn in one simulation step."""

SeatKind = Literal["slide", "hinge"]
FaultKind = Literal["healthy", "structural_looseness", "backlash"]

_SOFT, _STIFF = 1e-4, 0.9999  # MuJoCo's smallest and largest constraint impedance
_FAR = 1.0  # a stop that is never reached [m or rad]


@dataclass(frozen=True, kw_only=True)
class Healthy:
    """An arm with nothing loose: its seat is shut."""

    kind: ClassVar[FaultKind] = "healthy"

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis under which this arm falls."""
        return "healthy"


@dataclass(frozen=True, kw_only=True)
class Preload:
    """A seat held closed by a stiff spring: a bolted flange under tension. No fault."""

    kind: ClassVar[FaultKind] = "healthy"
    link: int
    """Link that carries the seat, from 1 at the base."""
    direction: tuple[float, float, float]
    """Direction of the seat in the link frame."""
    stiffness: float
    """Stiffness of the closed seat [N/m]."""
    damping: float = 0.0
    """Damping of the closed seat [N·s/m]."""

    def __post_init__(self) -> None:
        _direction(self.direction)
        _not_negative(stiffness=self.stiffness, damping=self.damping)

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis under which this arm falls."""
        return "healthy"


@dataclass(frozen=True, kw_only=True)
class StructuralLooseness:
    """A link that slides on its flange between two stops."""

    kind: ClassVar[FaultKind] = "structural_looseness"
    link: int
    """Loose link, from 1 at the base."""
    direction: tuple[float, float, float]
    """Direction of the slide in the link frame; its length does not matter."""
    gap: float
    """Travel from stop to stop [m]."""
    stiffness: tuple[float, float]
    """Stiffness of the lower and the upper stop [N/m]."""
    damping: tuple[float, float] = (0.0, 0.0)
    """Damping of the lower and the upper stop [N·s/m]."""
    friction: float = 0.0
    """Coulomb friction of the guide [N]."""

    def __post_init__(self) -> None:
        _direction(self.direction)
        _not_negative(gap=self.gap, friction=self.friction)
        _two_sides(stiffness=self.stiffness, damping=self.damping)

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis under which this arm falls."""
        return f"structural_looseness@link{self.link}"


@dataclass(frozen=True, kw_only=True)
class Backlash:
    """A joint with play between its motor side and its link side."""

    kind: ClassVar[FaultKind] = "backlash"
    joint: int
    """Joint with play, from 1 at the base."""
    gap: float
    """Travel from stop to stop [rad]."""
    stiffness: tuple[float, float]
    """Stiffness of the lower and the upper flank [N·m/rad]."""
    damping: tuple[float, float] = (0.0, 0.0)
    """Damping of the lower and the upper flank [N·m·s/rad]."""
    friction: float = 0.0
    """Coulomb friction between the two sides [N·m]."""

    def __post_init__(self) -> None:
        _not_negative(gap=self.gap, friction=self.friction)
        _two_sides(stiffness=self.stiffness, damping=self.damping)

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis under which this arm falls."""
        return f"backlash@joint{self.joint}"


Fault = Healthy | Preload | StructuralLooseness | Backlash


def hypotheses(arm: Arm) -> tuple[str, ...]:
    """All hypotheses about an arm: healthy, a loose link, a joint with play.

    Examples
    --------
    >>> from loose_env.arms import vera
    >>> hypotheses(vera())[:3]
    ('healthy', 'structural_looseness@link1', 'structural_looseness@link2')
    """
    places = range(1, arm.n + 1)
    return (
        "healthy",
        *(f"structural_looseness@link{i}" for i in places),
        *(f"backlash@joint{i}" for i in places),
    )


def place_of(hypothesis: str) -> int | None:
    """Link or joint number that a hypothesis names; None for healthy.

    Examples
    --------
    >>> place_of("backlash@joint2"), place_of("healthy")
    (2, None)
    """
    _, _, place = hypothesis.partition("@")
    return int(place.removeprefix("link").removeprefix("joint")) if place else None


def seat_of(fault: Fault) -> tuple[int | None, SeatKind]:
    """Link whose seat a fault uses (None: any) and the kind of that seat."""
    if isinstance(fault, Backlash):
        return fault.joint, "hinge"
    if isinstance(fault, (StructuralLooseness, Preload)):
        return fault.link, "slide"
    if isinstance(fault, Healthy):
        return None, "slide"
    raise UnknownName(
        "a fault is Healthy, Preload, StructuralLooseness or Backlash, "
        f"got {type(fault).__name__}: {fault!r}"
    )


def seated_spec(arm: Arm, link: int, kind: SeatKind) -> mujoco.MjSpec:
    """Copy the arm's spec and give ``link`` a seat: the joint, its two stops and its lock.

    The spec is the same for every fault on that seat; `set_seat` writes the fault's figures
    into the compiled model.

    Raises
    ------
    UnknownName
        If the arm has no such link, or the kind is not "slide" or "hinge".
    """
    number = arm.link_number(link)
    if kind not in ("slide", "hinge"):
        raise UnknownName(f"a seat is a 'slide' or a 'hinge', got {kind!r}")
    spec = arm.spec.copy()
    body = spec.body(arm.seat_bodies[number - 1])
    joint = spec.joint(arm.joints[number - 1])
    hinge = kind == "hinge"
    body.add_joint(
        name=SEAT,
        type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=joint.axis if hinge else [1, 0, 0],
        pos=joint.pos if hinge else [0, 0, 0],
        # A tiny friction loss keeps the friction row in every layout.
        frictionloss=1e-9,
        solimp_friction=[_STIFF, _STIFF, 0.001, 0.5, 2],
    )
    for name, limits in (("seat_low", (0.0, 2 * _FAR)), ("seat_high", (-2 * _FAR, 0.0))):
        stop = spec.add_tendon(
            name=name,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=list(limits),
            solimp_limit=[_SOFT, _SOFT, 0.001, 0.5, 2],
        )
        stop.wrap_joint(SEAT, 1.0)
    spec.add_equality(
        name="seat_lock",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=SEAT,
        solimp=[_STIFF, _STIFF, 0.001, 0.5, 2],
    )
    return spec


def set_seat(model: mujoco.MjModel, fault: Fault, data: mujoco.MjData | None = None) -> None:
    """Write a fault's figures into a compiled model that has its seat.

    Call it after every change of masses, once ``mj_setConst`` has run: the stops are scaled
    with the seat's inverse weight, that along the fault's direction. ``data`` is scratch space of
    the model's layout, made anew if it is not given.

    Raises
    ------
    InvalidSetting
        If a stop or a preloaded seat is too stiff for the simulation step.
    """
    step = model.opt.timestep
    seat = model.joint(SEAT)
    dof, lock = seat.dofadr[0], model.equality("seat_lock").id
    low, high = model.tendon("seat_low").id, model.tendon("seat_high").id
    shut = isinstance(fault, Healthy)
    model.eq_active0[lock] = shut
    model.eq_solref[lock] = (2 * step, 1.0)
    model.dof_solref[dof] = (2 * step, 1.0)
    if isinstance(fault, (StructuralLooseness, Preload)):
        model.jnt_axis[seat.id] = _direction(fault.direction)
        # The inverse weight follows the axis.
        mujoco.mj_setConst(model, mujoco.MjData(model) if data is None else data)
    friction, reach = 0.0, _FAR
    stops = ((1.0, 0.0), (1.0, 0.0))
    if isinstance(fault, (StructuralLooseness, Backlash)):
        friction, reach = fault.friction, fault.gap / 2
        stops = tuple(zip(fault.stiffness, fault.damping, strict=True))  # type: ignore[assignment]
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
    closed = (0.0, 0.0)
    if isinstance(fault, Preload):
        closed = (fault.stiffness, fault.damping)
        _require_slow("a preloaded seat", *closed, model.dof_invweight0[dof], step)
    model.jnt_stiffness[seat.id], model.dof_damping[dof] = closed


def _require_slow(what: str, stiffness: float, damping: float, weight: float, step: float) -> None:
    """Refuse a spring or damper too fast for the step; ``weight`` is the inverse of its mass."""
    if stiffness * weight * step**2 > FASTEST_STOP**2:
        mode = np.sqrt(stiffness * weight) / (2 * np.pi)
        raise InvalidSetting(
            f"{what} with a stiffness of {stiffness:g} has a contact mode of {mode:.0f} Hz, too "
            f"fast for a step of {step:g} s; use {FASTEST_STOP**2 / weight / step**2:.3g} at "
            f"most, or a step of {FASTEST_STOP / np.sqrt(stiffness * weight):.2g} s at most"
        )
    # Stable explicit stepping of a spring and a damper needs w h (k h + 2 c) < 4.
    if weight * step * (stiffness * step + 2 * damping) >= 4:
        most = (4 / (weight * step) - stiffness * step) / 2
        raise InvalidSetting(
            f"{what} with a damping of {damping:g} is too stiff for a step of {step:g} s; use "
            f"less than {most:.3g}"
        )


def _direction(direction: tuple[float, float, float]) -> NDArray[np.float64]:
    vector = np.asarray(direction, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not np.linalg.norm(vector) > 0:
        raise InvalidSetting(
            "a direction is three finite numbers, not all zero, in the link frame; "
            f"got {direction!r}"
        )
    return np.asarray(vector / np.linalg.norm(vector))


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not np.isfinite(value) or value < 0:
            raise InvalidSetting(f"{name} must be a finite number, zero or more; got {value!r}")


def _two_sides(**pairs: tuple[float, float]) -> None:
    for name, pair in pairs.items():
        if np.shape(pair) != (2,):
            raise InvalidSetting(
                f"{name} is two numbers, for the lower and the upper stop; got {pair!r}"
            )
        for value in pair:
            _not_negative(**{name: value})
