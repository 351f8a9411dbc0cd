"""Fault models of an arm, each with its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, get_args

import numpy as np
from annotated_types import Predicate
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.faults.kinds import SEVERAL_FAULTS, FaultKind
from loose_env.io import Checked, NonNegative, Rule, unmet

__all__ = [
    "Backlash",
    "CompoundLooseness",
    "Fault",
    "Healthy",
    "LooseFault",
    "Preload",
    "RotationalLooseness",
    "SeveralFaults",
    "StructuralLooseness",
    "is_fault",
    "unit",
]

_INDEPENDENT = 1e-3
"""Smallest singular value of unit vectors that still count as independent [1]."""


Vector = tuple[float, float, float]
Direction = Annotated[
    Vector, Rule("three finite numbers, not all zero, in the link frame", (Predicate(any),))
]
Point = Annotated[Vector, Rule("three finite numbers [m] in the link frame")]
Sides = Annotated[
    tuple[NonNegative, NonNegative],
    Rule("two finite numbers, zero or more, for the lower and the upper stop"),
]


class _OfLink(Checked):
    """Fault at the seat of one link."""

    kind: ClassVar[str]
    link: int

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis that this arm belongs to."""
        return f"{self.kind}@link{self.link}"


@dataclass(frozen=True, kw_only=True)
class Healthy:
    """Arm without looseness: its seat is closed."""

    kind: ClassVar[FaultKind] = "healthy"
    hypothesis: ClassVar[str] = "healthy"


@dataclass(frozen=True, kw_only=True)
class Preload(Checked):
    """Preloaded seat: a bolted flange under tension, closed by a stiff spring. No fault."""

    kind: ClassVar[FaultKind] = "healthy"
    hypothesis: ClassVar[str] = "healthy"
    link: int
    """Link that carries the seat, from 1 at the base."""
    direction: Direction
    """Direction of the seat in the link frame."""
    stiffness: NonNegative
    """Stiffness of the closed seat [N/m]."""
    damping: NonNegative = 0.0
    """Damping of the closed seat [N·s/m]."""


@dataclass(frozen=True, kw_only=True)
class StructuralLooseness(_OfLink):
    """A link that slides on its flange between two stops."""

    kind: ClassVar[FaultKind] = "structural_looseness"
    link: int
    """Loose link, from 1 at the base."""
    direction: Direction
    """Direction of the slide in the link frame; its length does not matter."""
    gap: NonNegative
    """Travel from stop to stop [m]."""
    stiffness: Sides
    """Stiffness of the lower and the upper stop [N/m]."""
    damping: Sides = (0.0, 0.0)
    """Damping of the lower and the upper stop [N·s/m]."""
    friction: NonNegative = 0.0
    """Coulomb friction of the guide [N]."""
    preload: float = 0.0
    """Constant force that presses the seat on its upper stop; below zero on the lower [N]."""


@dataclass(frozen=True, kw_only=True)
class Backlash(Checked):
    """A joint with play between its motor side and its link side.

    The play is the joint's own motion: about its axis, or along it where the joint slides. There,
    every parameter is per metre and in newtons.
    """

    kind: ClassVar[FaultKind] = "backlash"
    joint: int
    """Joint with play, from 1 at the base."""
    gap: NonNegative
    """Travel from stop to stop [rad, or m where the joint slides]."""
    stiffness: Sides
    """Stiffness of the lower and the upper flank [N·m/rad, or N/m]."""
    damping: Sides = (0.0, 0.0)
    """Damping of the lower and the upper flank [N·m·s/rad, or N·s/m]."""
    friction: NonNegative = 0.0
    """Coulomb friction between the two sides [N·m, or N]."""
    preload: float = 0.0
    """Constant torque or force that presses the seat on its upper stop, below zero on the lower
    [N·m, or N]."""

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis that this arm belongs to."""
        return f"{self.kind}@joint{self.joint}"


@dataclass(frozen=True, kw_only=True)
class RotationalLooseness(_OfLink):
    """A link that rocks on its flange about an axis, between two stops (3.2.2).

    About the axis of its joint this would be `Backlash`.
    """

    kind: ClassVar[FaultKind] = "rotational_looseness"
    link: int
    """Loose link, from 1 at the base."""
    axis: Direction
    """Axis of the rocking in the link frame; its length does not matter."""
    gap: NonNegative
    """Angle from stop to stop [rad]."""
    stiffness: Sides
    """Stiffness of the lower and the upper stop [N·m/rad]."""
    damping: Sides = (0.0, 0.0)
    """Damping of the lower and the upper stop [N·m·s/rad]."""
    friction: NonNegative = 0.0
    """Coulomb friction of the seat [N·m]."""
    preload: float = 0.0
    """Constant torque that presses the seat on its upper stop; below zero on the lower [N·m]."""
    pivot: Point = (0.0, 0.0, 0.0)
    """A point of the axis in the link frame [m]."""


@dataclass(frozen=True, kw_only=True)
class CompoundLooseness(_OfLink):
    """Link loose on its flange in two or more directions (3.2.2, 8.3.2).

    An undersized pin lets the link slide both ways across it: two parts. A seat loose in all
    six directions has six. Each part has its own stops, its own friction and its own place in
    its gap, so that the room the link has is a box: a round hole would be a cylinder, which two
    slides take for the square around it, and friction acts on each part alone.

    The parts follow each other from the flange outward. In gaps of seats their order shows
    in the second order of the travel only.
    """

    kind: ClassVar[FaultKind] = "compound_looseness"
    link: int
    """Loose link, from 1 at the base."""
    parts: tuple[StructuralLooseness | RotationalLooseness, ...]
    """Two to six ways in which the link is loose, independent of each other."""

    def __post_init__(self) -> None:
        parts = self.parts
        if not isinstance(parts, tuple) or not 2 <= len(parts) <= 6:
            raise InvalidSetting(
                "a compound looseness is a tuple of two to six parts; for one use "
                f"StructuralLooseness or RotationalLooseness; got {parts!r}"
            )
        for part in parts:
            if not isinstance(part, (StructuralLooseness, RotationalLooseness)):
                raise InvalidSetting(
                    "parts of a compound looseness are StructuralLooseness or "
                    f"RotationalLooseness; got {part!r}"
                )
            if part.link != self.link:
                raise InvalidSetting(
                    f"all parts of a compound looseness lie on its link {self.link}; got one "
                    f"on link {part.link}"
                )
        slides = [p.direction for p in parts if isinstance(p, StructuralLooseness)]
        axes = [p.axis for p in parts if isinstance(p, RotationalLooseness)]
        _independent("directions of the slides", slides)
        _independent("axes of the rotations", axes)


LooseFault = StructuralLooseness | Backlash | RotationalLooseness | CompoundLooseness
"""A fault that leaves one seat loose, in one way or several."""


@dataclass(frozen=True, kw_only=True)
class SeveralFaults:
    """Several simultaneous faults of one arm; no verdict names them.

    Each is what it is alone, with stops, friction and a place in its gap of its own.
    """

    kind: ClassVar[str] = SEVERAL_FAULTS
    hypothesis: ClassVar[str] = SEVERAL_FAULTS
    faults: tuple[LooseFault, ...]
    """Two faults or more, each on a link or joint of its own number."""

    def __post_init__(self) -> None:
        faults = self.faults
        if not isinstance(faults, tuple) or len(faults) < 2:
            raise InvalidSetting(
                f"several faults are a tuple of two or more; give a single one as it is; got "
                f"{faults!r}"
            )
        for fault in faults:
            if not isinstance(fault, get_args(LooseFault)):
                raise InvalidSetting(
                    "each of several faults is StructuralLooseness, Backlash, "
                    f"RotationalLooseness or CompoundLooseness; got {fault!r}"
                )
        places = [f.joint if isinstance(f, Backlash) else f.link for f in faults]
        if len(set(places)) != len(places):
            raise InvalidSetting(
                "several faults lie on links and joints of different numbers, for one link loose "
                f"in several ways use CompoundLooseness; got places {places}"
            )


Fault = Healthy | Preload | LooseFault | SeveralFaults


def is_fault(value: object) -> bool:
    """Return whether a value is a fault of any kind."""
    return isinstance(value, get_args(Fault))


def unit(what: str, vector: Vector) -> NDArray[np.float64]:
    """Normalise a vector of the link frame (3,).

    Raises
    ------
    InvalidSetting
        If it is not three finite numbers, or points nowhere.
    """
    if words := unmet(Direction, vector):
        raise InvalidSetting(f"{what} is {words}; got {vector!r}")
    given = np.asarray(vector, dtype=float)
    return np.asarray(given / np.linalg.norm(given))


def _independent(what: str, vectors: list[Vector]) -> None:
    if not vectors:
        return
    units = np.array([unit("a direction", v) for v in vectors])
    if len(vectors) > 3 or np.linalg.svd(units, compute_uv=False).min() < _INDEPENDENT:
        raise InvalidSetting(
            f"the {what} must be independent, three at most: leave out those that the others "
            f"make; got {vectors}"
        )
