"""Unit of a position by its range within joint limits, of a velocity by the derivative."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.importing.guessing.joint_targets import JointTarget
from loose_env.importing.guessing.quantities import quantity_of
from loose_env.importing.mapping.units import unit_named
from loose_env.typing import Array

_MARGIN = 0.05
"""Part of a joint's range by which a sensor may exceed the limits [1]."""
_TURNS = 1.1 * 2 * math.pi
"""Largest position taken of a joint without limits [rad]: a turn each way, and a margin."""
_NORMALISED = 102.0
"""Largest value taken as normalised to 100 [1]: a calibrated end, and a margin."""
_NEAR = 1.5
"""Factor within which a ratio of rates counts as that of a unit [1]."""
_RATES = {"rad/s": 1.0, "deg/s": 180 / math.pi, "rpm": 30 / math.pi}
_SPEEDS = {"m/s": 1.0, "mm/s": 1e3}


@dataclass(frozen=True)
class Scaling:
    """How a channel's values become SI: unit, factor before it, and offset after it."""

    unit: str
    scale: float = 1.0
    offset: float = 0.0
    """[rad or m]"""
    reason: str = ""


def position_scaling(
    joint: JointTarget, values: Array, unit: str = "", why: str = "as given"
) -> Scaling | None:
    """Scaling of a position; None where no unit fits, or the stated one is of another quantity."""
    units = ("m", "mm") if joint.slide else ("rad", "deg")
    low, high = float(np.min(values)), float(np.max(values))
    seen = f"values {low:.4g} to {high:.4g}"
    ends = "" if joint.limits is None else f" {joint.limits[0]:.4g} to {joint.limits[1]:.4g}"
    about = f"limits{ends} {units[0]}" if ends else "no limits in the model"
    fitting = [each for each in units if _fits(joint, low, high, each)]
    stated = quantity_of(unit)
    if stated not in ("", "number", quantity_of(units[0])):
        return None
    other = stated == quantity_of(units[0]) and unit not in units  # such as cm or mrad
    if other or (unit in units and (unit in fitting or not fitting)):
        note = "" if _fits(joint, low, high, unit) else ", which they exceed"
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
    return _otherwise(joint, values, seen, about)


def group_unit(joints: Sequence[JointTarget], values: Sequence[Array]) -> str:
    """Unit of an angle that fits most hinges of a vector; "" where none does.

    Radians are taken where both fit all alike: values within a turn are more often radians than
    a few degrees.
    """
    hinges = [(j, v) for j, v in zip(joints, values, strict=True) if not j.slide]
    counts = {
        unit: sum(_fits(j, float(np.min(v)), float(np.max(v)), unit) for j, v in hinges)
        for unit in ("rad", "deg")
    }
    best = max(counts, key=lambda each: counts[each])
    return best if hinges and counts[best] else ""


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


def _fits(joint: JointTarget, low: float, high: float, unit: str) -> bool:
    factor = unit_named(unit, "").factor
    if joint.limits is None:
        return max(abs(low), abs(high)) * factor <= (1.0 if joint.slide else _TURNS)
    margin = _MARGIN * (joint.limits[1] - joint.limits[0])
    return joint.limits[0] - margin <= low * factor and high * factor <= joint.limits[1] + margin


def _otherwise(joint: JointTarget, values: Array, seen: str, about: str) -> Scaling | None:
    """Values normalised to the joint's range, or ticks of an encoder."""
    low, high = float(np.min(values)), float(np.max(values))
    found = normalised_scaling(joint, values)
    if found is not None:
        return Scaling(found.unit, found.scale, found.offset, f"{seen}, {about}: {found.reason}")
    whole = bool(np.all(values == np.round(values)))
    if whole and not joint.slide and low >= 0 and high < 4096:
        turn = 2 * math.pi / 4096
        words = "ticks of 4096 a turn, 2048 at zero"
        return Scaling("rad", turn, -math.pi, f"{seen}, {about}: {words}")
    return None
