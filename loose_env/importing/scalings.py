"""Units of channels: stated, else by limits, by a velocity beside, or by the model's torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.importing.names import Role
from loose_env.importing.targets import JointTarget
from loose_env.importing.units import quantity_of, unit_named
from loose_env.typing import Array

_MARGIN = 0.05
"""Part of a joint's range by which a sensor may exceed the limits [1]."""
_TURNS = 20.0
"""Largest position of a joint without limits that is taken for radians where nothing else tells:
three turns each way. A channel that is consistent with a velocity is radians beyond it, too."""
_NORMALISED = 102.0
"""Largest value taken as normalised to 100 [1]: a calibrated end, and a margin."""
_NEAR = 1.5
"""Factor within which a ratio of rates counts as that of a unit [1]."""
_RATES = {"rad/s": 1.0, "deg/s": 180 / math.pi, "rpm": 30 / math.pi, "rev/s": 0.5 / math.pi}
_SPEEDS = {"m/s": 1.0, "mm/s": 1e3, "cm/s": 1e2, "mm/min": 6e4}
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


@dataclass(frozen=True)
class Scaling:
    """How a channel's values become SI: unit, factor before it, and offset after it."""

    unit: str
    scale: float = 1.0
    offset: float = 0.0
    """[rad or m]"""
    reason: str = ""

    def si(self, runs: Sequence[Array], sign: int = 1) -> list[Array]:
        """Values of runs in SI units."""
        factor = sign * self.scale * (unit_named(self.unit, "").factor if self.unit else 1.0)
        return [v * factor + self.offset for v in runs]


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


def position_scaling(
    joint: JointTarget, values: Array, unit: str = "", why: str = ""
) -> Scaling | None:
    """Scaling of a position; None where no unit fits, or the stated one is of another quantity."""
    units = ("m", "mm") if joint.slide else ("rad", "deg")
    low, high = float(np.min(values)), float(np.max(values))
    seen = f"values {low:.4g} to {high:.4g}"
    ends = "" if joint.limits is None else f" {joint.limits[0]:.4g} to {joint.limits[1]:.4g}"
    about = f"limits{ends} {units[0]}" if ends else "no limits in the model"
    stated = quantity_of(unit)
    if stated not in ("", "number", quantity_of(units[0])):
        return None
    if stated == "number" and unit == "%":
        found = normalised_scaling(joint, values)
        return None if found is None else _because(found, seen, about)
    fitting = [each for each in units if fits(joint, low, high, each)]
    other = stated == quantity_of(units[0]) and unit not in units  # such as cm or mrad
    if other or (unit in units and (unit in fitting or not fitting or why)):
        note = "" if fits(joint, low, high, unit) else ", which they exceed"
        return Scaling(unit, reason=f"{unit} {why}; {seen}, {about}{note}")
    if fitting:
        also = (
            f"; {fitting[1]} would fit too, {fitting[0]} is taken for values this small"
            if len(fitting) > 1
            else ""
        )
        if fitting[0] == "deg" and max(abs(low), abs(high)) <= 100:
            also = "; values normalised to -100..100 would look alike"
        return Scaling(fitting[0], reason=f"{seen}, {about}: {fitting[0]}{also}")
    found = normalised_scaling(joint, values)
    if found is not None:
        return _because(found, seen, about)
    whole = bool(np.all(values == np.round(values)))
    if whole and not joint.slide and low >= 0 and high < 4096:
        turn = 2 * math.pi / 4096
        words = "ticks of 4096 a turn, 2048 at zero"
        return Scaling("rad", turn, -math.pi, f"{seen}, {about}: {words}")
    return None


def group_unit(joints: Sequence[JointTarget], values: Sequence[Array]) -> str:
    """Unit of an angle that fits the hinges of a vector best; "" where there are none.

    In each unit the largest value is a share of the joint's limit. Beyond the limit it speaks
    against the unit, the more the farther; far below it speaks against it too, but never by more
    than a joint at rest is worth.
    """
    against = {"rad": 0.0, "deg": 0.5}
    hinges = [(j, v) for j, v in zip(joints, values, strict=True) if not j.slide]
    for joint, own in hinges:
        low, high = float(np.min(own)), float(np.max(own))
        end = _TURNS if joint.limits is None else max(map(abs, joint.limits))
        for unit in against:
            share = max(abs(low), abs(high), 1e-9) * unit_named(unit, "").factor / max(end, 1e-9)
            if not fits(joint, low, high, unit):
                against[unit] += 2.0 + 2.0 * math.log(max(share, 1.0))
            elif joint.limits is not None:
                against[unit] += min(2.0, 0.5 * (math.log(share / 0.5) / 1.2) ** 2)
    return min(against, key=lambda each: against[each]) if hinges else ""


def normalised_scaling(joint: JointTarget, values: Array) -> Scaling | None:
    """Scaling of values normalised to a joint's limits; None where they cannot be."""
    low, high = float(np.min(values)), float(np.max(values))
    if joint.limits is None or max(abs(low), abs(high)) > _NORMALISED:
        return None
    unit = "m" if joint.slide else "rad"
    bottom, top = joint.limits
    if low >= -1:
        return Scaling(unit, (top - bottom) / 100, bottom, "normalised to 0..100 of the limits")
    words = "normalised to -100..100 of the limits"
    return Scaling(unit, (top - bottom) / 200, (top + bottom) / 2, words)


def rate_unit(ratio: float, slide: bool) -> str:
    """Unit of a velocity by its ratio to the derivative of the position in SI; "" if none fits.

    Examples
    --------
    >>> rate_unit(-57.0, slide=False)
    'deg/s'
    """
    units = _SPEEDS if slide else _RATES
    if ratio == 0:
        return ""
    away = {unit: abs(math.log(abs(ratio) / each)) for unit, each in units.items()}
    best = min(away, key=lambda each: away[each])
    return best if away[best] < math.log(_NEAR) else ""


def fits(joint: JointTarget, low: float, high: float, unit: str, margin: float = _MARGIN) -> bool:
    """Return whether values in a unit lie within a joint's limits, and a share of them beyond."""
    factor = unit_named(unit, "").factor
    if joint.limits is None:
        return max(abs(low), abs(high)) * factor <= (1.0 if joint.slide else _TURNS)
    margin = margin * (joint.limits[1] - joint.limits[0])
    return joint.limits[0] - margin <= low * factor and high * factor <= joint.limits[1] + margin


def _because(scaling: Scaling, seen: str, about: str) -> Scaling:
    reason = f"{seen}, {about}: {scaling.reason}"
    return Scaling(scaling.unit, scaling.scale, scaling.offset, reason)
