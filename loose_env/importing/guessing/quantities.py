"""Quantity of a stated unit, and the roles at a joint that it allows a channel."""

from __future__ import annotations

from loose_env.errors import InvalidData
from loose_env.importing.guessing.channel_names import Role
from loose_env.importing.mapping.units import unit_named

_ALLOWED: dict[Role, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "position": (("angle", "number"), ("length", "number")),
    "velocity": (("angular speed",), ("speed",)),
    "torque": (("torque",), ("force",)),
    "current": (("current",), ("current",)),
    "command": (
        ("angle", "angular speed", "torque", "number", "voltage", "current"),
        ("length", "speed", "force", "number", "voltage", "current"),
    ),
}
"""Role -> quantities of a channel of a hinge and of a slide."""
_RATE_OF = {"angle": "angular speed", "length": "speed"}


def quantity_of(unit: str) -> str:
    """Quantity of a unit; "" for none, or for one that is not known.

    Examples
    --------
    >>> quantity_of("mm"), quantity_of("g"), quantity_of("counts")
    ('length', 'acceleration', '')
    """
    try:
        return unit_named(unit, "").quantity if unit else ""
    except InvalidData:
        return ""


def admits(unit: str, role: Role, *, slide: bool) -> bool:
    """Return whether a channel with a stated unit may have a role at a joint.

    Examples
    --------
    >>> admits("mm", "position", slide=True), admits("mm", "position", slide=False)
    (True, False)
    """
    quantity = quantity_of(unit)
    return not quantity or role not in _ALLOWED or quantity in _ALLOWED[role][slide]


def is_rate(unit: str, of: str) -> bool:
    """Return whether a channel may be the derivative of another, by their stated units."""
    own, other = quantity_of(unit), quantity_of(of)
    return not own or not other or _RATE_OF.get(other) == own


def same_quantity(unit: str, other: str) -> bool:
    """Return whether two channels may be of one quantity, by their stated units."""
    return len({quantity_of(unit), quantity_of(other)} - {""}) <= 1
