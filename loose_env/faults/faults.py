"""Fault models of an arm, each with its parameters, and the hypotheses that they define."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from annotated_types import MinLen, Predicate
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import Checked, NonNegative, Rule

FaultKind = Literal["healthy", "structural_looseness", "backlash", "rotational_looseness"]

KINDS: tuple[FaultKind, ...] = ("healthy", "structural_looseness", "backlash")
"""Kinds that are hypotheses, in the order in which these are counted."""

SEVERAL_FAULTS = "several_faults"
"""Label of an arm with more than one fault; no verdict can name it."""

UNSURE = "unsure"
"""The verdict that names nothing: what was seen fits none of the hypotheses well enough."""


def checked_kinds(kinds: Sequence[str]) -> tuple[FaultKind, ...]:
    """Validate the kinds of the hypotheses; return them in the order of `KINDS`.

    Raises
    ------
    UnknownName
        If there is no such kind.
    InvalidSetting
        If a kind is named twice or is no hypothesis, or "healthy" is missing.

    Examples
    --------
    >>> checked_kinds(["backlash", "healthy"])
    ('healthy', 'backlash')
    """
    if isinstance(kinds, str) or not isinstance(kinds, Sequence):
        raise InvalidSetting(f"kinds are several names out of {list(KINDS)}, got {kinds!r}")
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown and all(kind in get_args(FaultKind) for kind in unknown):
        raise InvalidSetting(
            f"{unknown} are no hypotheses, for no posterior knows them; kinds are {list(KINDS)}. "
            "Hide such a fault by reset(options={'fault': RotationalLooseness(...)})"
        )
    if unknown:
        raise UnknownName(f"unknown fault kind {unknown}; kinds are {list(KINDS)}")
    if len(set(kinds)) != len(kinds):
        raise InvalidSetting(f"each fault kind is named once, got {list(kinds)}")
    if "healthy" not in kinds:
        raise InvalidSetting(
            f'"healthy" is always a hypothesis: add it to the kinds, got {list(kinds)}'
        )
    return tuple(kind for kind in KINDS if kind in kinds)


def hypotheses(
    arm: Arm, kinds: Sequence[str] = KINDS, *, everywhere: bool = False
) -> tuple[str, ...]:
    """All hypotheses of an arm: healthy, then every kind at every location, base first.

    Play in a joint on whose axis the tool lies is none: nothing that the tool feels tells it from
    a healthy arm (`Arm.unfelt_joints`).

    Parameters
    ----------
    arm : Arm
        The arm.
    kinds : sequence of str
        Which kinds are hypotheses; their order does not matter.
    everywhere : bool
        True to name every location, whether the tool feels it or not.

    Raises
    ------
    UnknownName, InvalidSetting
        As `checked_kinds`.

    Examples
    --------
    >>> from loose_env.arms import vera
    >>> hypotheses(vera())[:3]
    ('healthy', 'structural_looseness@link1', 'structural_looseness@link2')
    >>> hypotheses(vera(), ("healthy", "backlash"))[1:]
    ('backlash@joint1', 'backlash@joint2')
    """
    names: list[str] = []
    for kind in checked_kinds(kinds):
        places = places_of_kind(arm, kind) if not everywhere else tuple(range(1, arm.n + 1))
        names += [hypothesis_at(kind, i) for i in places] if kind != "healthy" else [kind]
    return tuple(names)


def hypothesis_at(kind: str, place: int) -> str:
    """Hypothesis of a kind of fault at a link or joint.

    Examples
    --------
    >>> hypothesis_at("backlash", 2), hypothesis_at("structural_looseness", 1)
    ('backlash@joint2', 'structural_looseness@link1')
    """
    return f"{kind}@{_part(kind)}{place}"


def _part(kind: str) -> str:
    """Where a kind of fault sits: on a link or in a joint."""
    return "joint" if kind == "backlash" else "link"


def places_of_kind(arm: Arm, kind: str) -> tuple[int, ...]:
    """Numbers of the links or joints where a kind of fault can be found out.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> places_of_kind(planar(3), "backlash")
    (1, 2, 3)
    """
    numbers = range(1, arm.n + 1)
    return tuple(i for i in numbers if kind != "backlash" or i not in arm.unfelt_joints)


def place_of(hypothesis: str) -> int | None:
    """Link or joint number of a hypothesis; None if it has no single location.

    Examples
    --------
    >>> place_of("backlash@joint2"), place_of("healthy")
    (2, None)
    """
    _, _, place = hypothesis.partition("@")
    return int(place.removeprefix("link").removeprefix("joint")) if place else None


Vector = tuple[float, float, float]
Direction = Annotated[
    Vector, Rule("three finite numbers, not all zero, in the link frame", (Predicate(any),))
]
Point = Annotated[Vector, Rule("three finite numbers [m] in the link frame")]
Sides = Annotated[
    tuple[NonNegative, NonNegative],
    Rule("two finite numbers, zero or more, for the lower and the upper stop"),
]


class _Placed(Checked):
    """Fault at one link or joint."""

    kind: ClassVar[str]

    @property
    def place(self) -> int:
        """Number of the link or joint, from 1 at the base."""
        return int(getattr(self, _part(self.kind)))

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis that this arm belongs to."""
        return hypothesis_at(self.kind, self.place)


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
class LooseSeat(_Placed):
    """One loose degree of freedom between two stops.

    Lengths in m and forces in N where it slides, angles in rad and torques in N·m where it turns.
    """

    gap: NonNegative
    """Travel from stop to stop [m or rad]."""
    stiffness: Sides
    """Stiffness of the lower and the upper stop [N/m or N·m/rad]."""
    damping: Sides = (0.0, 0.0)
    """Damping of the lower and the upper stop [N·s/m or N·m·s/rad]."""
    friction: NonNegative = 0.0
    """Coulomb friction of the seat [N or N·m]."""
    preload: float = 0.0
    """Constant load that presses the seat on its upper stop; below zero on the lower
    [N or N·m]."""


@dataclass(frozen=True, kw_only=True)
class StructuralLooseness(LooseSeat):
    """A link that slides on its flange between two stops."""

    kind: ClassVar[FaultKind] = "structural_looseness"
    link: int
    """Loose link, from 1 at the base."""
    direction: Direction
    """Direction of the slide in the link frame; its length does not matter."""


@dataclass(frozen=True, kw_only=True)
class Backlash(LooseSeat):
    """A joint with play between its motor side and its link side.

    The play is the joint's own motion: about its axis, or along it where the joint slides.
    """

    kind: ClassVar[FaultKind] = "backlash"
    joint: int
    """Joint with play, from 1 at the base."""


@dataclass(frozen=True, kw_only=True)
class RotationalLooseness(LooseSeat):
    """A link that rocks on its flange about an axis, between two stops (3.2.2).

    About the axis of its joint this would be `Backlash`.
    """

    kind: ClassVar[FaultKind] = "rotational_looseness"
    link: int
    """Loose link, from 1 at the base."""
    axis: Direction
    """Axis of the rocking in the link frame; its length does not matter."""
    pivot: Point = (0.0, 0.0, 0.0)
    """A point of the axis in the link frame [m]."""


LooseFault = StructuralLooseness | Backlash | RotationalLooseness
"""A fault that leaves one seat loose."""


@dataclass(frozen=True, kw_only=True)
class SeveralFaults(Checked):
    """Several simultaneous faults of one arm; no verdict names them.

    Each is what it is alone, with stops, friction and a place in its gap of its own.
    """

    kind: ClassVar[str] = SEVERAL_FAULTS
    hypothesis: ClassVar[str] = SEVERAL_FAULTS
    faults: Annotated[
        tuple[StructuralLooseness | Backlash | RotationalLooseness, ...],
        Rule("a tuple of two or more loose faults; give a single one as it is", (MinLen(2),)),
    ]
    """Two faults or more, each on a link or joint of its own number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "faults", tuple(self.faults))
        places = [fault.place for fault in self.faults]
        if len(set(places)) != len(places):
            raise InvalidSetting(
                f"several faults lie on links and joints of different numbers; got places {places}"
            )


Fault = Healthy | Preload | LooseFault | SeveralFaults


def is_fault(value: object) -> bool:
    """Return whether a value is a fault of any kind."""
    return isinstance(value, get_args(Fault))


def unit(vector: Vector) -> NDArray[np.float64]:
    """Normalise a vector (3,)."""
    given = np.asarray(vector, dtype=float)
    return np.asarray(given / np.linalg.norm(given))
