"""Fault kinds and the hypotheses about an arm that they define."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting, UnknownName

__all__ = [
    "DEFAULT_KINDS",
    "KINDS",
    "SEVERAL_FAULTS",
    "UNSURE",
    "FaultKind",
    "checked_kinds",
    "hypotheses",
    "place_of",
    "places_of_kind",
]

FaultKind = Literal[
    "healthy", "structural_looseness", "backlash", "rotational_looseness", "compound_looseness"
]

KINDS: tuple[FaultKind, ...] = get_args(FaultKind)
"""All kinds, in the order in which their hypotheses are counted."""

DEFAULT_KINDS: tuple[FaultKind, ...] = ("healthy", "structural_looseness", "backlash")
"""The kinds of the thesis."""

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
        If a kind is named twice, or "healthy" is missing.

    Examples
    --------
    >>> checked_kinds(["backlash", "healthy"])
    ('healthy', 'backlash')
    """
    if isinstance(kinds, str) or not isinstance(kinds, Sequence):
        raise InvalidSetting(f"kinds are several names out of {list(KINDS)}, got {kinds!r}")
    unknown = [kind for kind in kinds if kind not in KINDS]
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
    arm: Arm, kinds: Sequence[str] = DEFAULT_KINDS, *, everywhere: bool = False
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
    >>> hypotheses(vera(), ("healthy", "rotational_looseness"))[1:]
    ('rotational_looseness@link1', 'rotational_looseness@link2')
    """
    names = []
    for kind in checked_kinds(kinds):
        if kind == "healthy":
            names.append("healthy")
            continue
        part = "joint" if kind == "backlash" else "link"
        places = places_of_kind(arm, kind) if not everywhere else tuple(range(1, arm.n + 1))
        names += [f"{kind}@{part}{i}" for i in places]
    return tuple(names)


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
