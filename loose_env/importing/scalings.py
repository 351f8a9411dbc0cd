"""Units of channels: stated, else by limits and by velocities; quantities that a role admits.

Every way to read a vector of positions (radians, degrees, shares of the limits, ticks) gets a score
against it, the sum over its joints of

    2 + 2 log(share) where values are outside the limits, else min(2, log(share / 0.5)² / 3),
    share = largest value / largest limit,

and what a velocity beside contradicts; the least is taken. Far below a limit speaks against a unit
too, but never by more than a joint at rest is worth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.importing.evidence import Signal
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
_TICKS = 4096
"""Ticks a turn of the servos whose words are logged as they are."""
_NEAR = 1.5
"""Factor within which a ratio of rates counts as that of a unit [1]."""
_AGAINST = {"rad": 0.0, "m": 0.0, "deg": 0.5, "mm": 0.5, "ticks": 0.5, "normalised": 2.0}
"""What speaks against a unit where values fit: the rarer one."""
_LENGTHS, _ANY = ("m", "mm"), ("normalised", "ticks")
_UNFIT = 4.0
"""What a joint whose values no unit of a kind can be speaks against it."""
_DEFINED = 2.0
"""What the definition of a format speaks for radians: less than values far outside the limits."""
_RATES = {"rad/s": 1.0, "deg/s": 180 / math.pi, "rpm": 30 / math.pi, "rev/s": 0.5 / math.pi}
_SPEEDS = {"m/s": 1.0, "mm/s": 1e3, "cm/s": 1e2, "mm/min": 6e4}
_ALLOWED: dict[str, tuple[str, ...]] = {
    "position": ("angle", "length", "number"),
    "velocity": ("angular speed", "speed"),
    "torque": ("torque", "force", "number", "current"),
    "position drive": ("number", "voltage", "angle", "length"),
    "velocity drive": ("number", "voltage", "angle", "length", "angular speed", "speed"),
    "torque drive": ("number", "voltage", "torque", "force", "current"),
}
"""Role, or kind of drive that is commanded -> quantities of a channel."""
_OF_SLIDES, _OF_HINGES = ("length", "speed", "force"), ("angle", "angular speed", "torque")
_RATE_OF = {"angle": "angular speed", "length": "speed"}


@dataclass(frozen=True)
class Scaling:
    """How a channel's values become SI: unit, factor before it, and offset after it."""

    unit: str
    scale: float = 1.0
    offset: float = 0.0
    """[rad or m]"""
    reason: str = ""

    @property
    def factor(self) -> float:
        """Factor from the channel's values to SI units."""
        return self.scale * (unit_named(self.unit, "").factor if self.unit else 1.0)

    def si(self, runs: Sequence[Array]) -> list[Array]:
        """Values of runs in SI units."""
        return [v * self.factor + self.offset for v in runs]


def admits(unit: str, role: Role, *, slide: bool, drive: str = "") -> bool:
    """Return whether a channel with a stated unit may have a role at a joint.

    Examples
    --------
    >>> admits("mm", "position", slide=True), admits("mm", "position", slide=False)
    (True, False)
    """
    quantity = quantity_of(unit)
    allowed = _ALLOWED[f"{drive} drive" if role == "command" else role]
    other = _OF_HINGES if slide else _OF_SLIDES
    return not quantity or (quantity in allowed and quantity not in other)


def is_rate(unit: str, of: str) -> bool:
    """Return whether a channel may be the derivative of another, by their stated units."""
    own, other = quantity_of(unit), quantity_of(of)
    return not own or not other or _RATE_OF.get(other) == own


def position_scalings(
    pairs: Mapping[str, tuple[JointTarget, Signal]], speeds: Mapping[str, float], defined: bool
) -> dict[str, Scaling | None]:
    """Scaling of each position of a vector; None where no unit fits.

    Parameters
    ----------
    pairs : mapping
        Joints and the channels of their positions.
    speeds : mapping
        Joint -> rate of its channel's values that makes 1 rad/s or m/s, by a velocity beside.
    defined : bool
        Whether the format defines radians and metres.
    """
    signed = any(not s.unit and s.low < -1 for _, s in pairs.values())
    ways = {joint: _ways(*pair, signed=signed) for joint, pair in pairs.items()}
    unstated = {j: t for j, (t, s) in pairs.items() if not s.unit}
    against: dict[str, float] = {}
    for way, prior in _AGAINST.items():
        alike = [j for j, t in unstated.items() if way in _ANY or t.slide == (way in _LENGTHS)]
        against[way] = prior - _DEFINED * (defined and way in ("rad", "m")) + sum(
            _against(way, *pairs[j], ways[j][way], speeds.get(j)) if way in ways[j] else _UNFIT
            for j in alike
        )  # fmt: skip
    return {
        joint: _chosen(*pair, ways[joint], against, speeds.get(joint), defined)
        for joint, pair in pairs.items()
    }


def _ways(joint: JointTarget, s: Signal, *, signed: bool) -> dict[str, Scaling]:
    """Ways to read the values of a position."""
    found = {unit: Scaling(unit) for unit in (("m", "mm") if joint.slide else ("rad", "deg"))}
    if joint.limits is not None and max(abs(s.low), abs(s.high)) <= _NORMALISED:
        (bottom, top), unit = joint.limits, next(iter(found))
        words = "normalised to -100..100 of the limits"
        found["normalised"] = Scaling(unit, (top - bottom) / 200, (top + bottom) / 2, words)
        if s.low >= -1 and not (signed and not s.unit):
            words = "normalised to 0..100 of the limits"
            found["normalised"] = Scaling(unit, (top - bottom) / 100, bottom, words)
    if s.whole and not joint.slide and s.low >= 0 and s.high < _TICKS:
        words = f"ticks of {_TICKS} a turn, {_TICKS // 2} at zero"
        found["ticks"] = Scaling("rad", 2 * math.pi / _TICKS, -math.pi, words)
    return found


def _against(
    way: str, joint: JointTarget, s: Signal, scaling: Scaling, speed: float | None
) -> float:
    """Score of one joint against a way to read its values."""
    ends = scaling.si([np.array([s.low, s.high])])[0]
    share = max(float(np.abs(ends).max()), 1e-9) / max(_end(joint), 1e-9)
    if way == "normalised":
        share = max(abs(s.low), abs(s.high), 1e-9) / 100
    if not _within(joint, ends):
        found = 2.0 + 2.0 * math.log(max(share, 1.0))
    else:
        found = 0.0 if joint.limits is None else min(2.0, math.log(share / 0.5) ** 2 / 3)
    return found + (0.0 if speed is None else 3 * abs(math.log(scaling.factor * speed)))


def _end(joint: JointTarget) -> float:
    """Largest position that is expected [rad or m]."""
    return (1.0 if joint.slide else _TURNS) if joint.limits is None else max(map(abs, joint.limits))


def _within(joint: JointTarget, ends: Sequence[float] | Array, margin: float = _MARGIN) -> bool:
    """Return whether positions lie within a joint's limits, and a share of them beyond."""
    low, high = ends
    if joint.limits is None:
        return bool(max(abs(low), abs(high)) <= _end(joint))
    margin = margin * (joint.limits[1] - joint.limits[0])
    return bool(joint.limits[0] - margin <= low and high <= joint.limits[1] + margin)


def _chosen(
    joint: JointTarget, s: Signal, ways: Mapping[str, Scaling], against: Mapping[str, float],
    speed: float | None, defined: bool,
) -> Scaling | None:  # fmt: skip
    """Scaling of one position: as stated, as its vector's, or its own where that does not fit."""
    unit = "m" if joint.slide else "rad"
    limits = joint.limits
    about = "no limits in the model" if limits is None else (
        f"limits {limits[0]:.4g} to {limits[1]:.4g} {unit}")  # fmt: skip
    seen = f"values {s.low:.4g} to {s.high:.4g}, {about}"
    stated = quantity_of(s.unit)
    if s.unit == "%":
        ways = {way: each for way, each in ways.items() if way == "normalised"}
    elif stated not in ("", "number"):
        if stated != quantity_of(unit):
            return None
        factor = unit_named(s.unit, "").factor
        within = _within(joint, (s.low * factor, s.high * factor))
        return Scaling(s.unit, reason=f"{s.unit} as stated; {seen}{_exceeds(within)}")

    def fits(way: str, margin: float = _MARGIN) -> bool:
        told = speed is not None or (defined and way == unit)
        return told or _within(joint, ways[way].si([np.array([s.low, s.high])])[0], margin)

    common = min(ways, key=lambda way: against[way], default="")
    if common and not fits(common, 0.5):
        own = {w: _AGAINST[w] + _against(w, joint, s, ways[w], speed) for w in ways if fits(w)}
        common = min(own, key=lambda way: own[way], default="")
    if not common:
        return None
    scaling = ways[common]
    why = "by the velocity beside" if speed is not None else scaling.reason or scaling.unit
    if defined and common == unit:
        why = f"{unit} as the format defines"
    also = "normalised" in ways and common == "deg"
    more = "; values normalised to -100..100 would look alike" if also else ""
    within = _within(joint, scaling.si([np.array([s.low, s.high])])[0])
    return replace(scaling, reason=f"{seen}: {why}{_exceeds(within)}{more}")


def _exceeds(within: bool) -> str:
    return "" if within else ", which they exceed"


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
