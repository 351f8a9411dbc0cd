"""Fault of an arm (kind, location), the name of its hypothesis, and the direction of a slide."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from loose_env.errors import InvalidData

HEALTHY = "healthy"
"""Name of the hypothesis that nothing is loose."""
FaultKind = Literal["healthy", "structural_looseness", "backlash"]
"""Kinds of fault."""
Vector = tuple[float, float, float]


def hypothesis_of(kind: str, where: str | None) -> str:
    """Name of a hypothesis, as the keys of a posterior have it.

    Examples
    --------
    >>> hypothesis_of("backlash", "elbow"), hypothesis_of("healthy", None)
    ('backlash@elbow', 'healthy')
    """
    return kind if where is None else f"{kind}@{where}"


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Fault of an arm.

    Examples
    --------
    >>> Fault(kind="structural_looseness", where="forearm", direction=(0.0, 0.6, 0.8)).hypothesis
    'structural_looseness@forearm'
    >>> Fault(kind="healthy", where="forearm")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a healthy arm has no location, got 'forearm'
    """

    kind: FaultKind
    """"healthy", "structural_looseness" or "backlash"."""
    where: str | None = None
    """The model's own name of the body that is loose on its joint, or of the joint that has play;
    None for a healthy arm."""
    direction: Vector | None = None
    """Unit vector along which the body slides, in its own frame, axial; None for a healthy arm,
    for backlash, and where the data do not say."""
    direction_half_angle_deg: float | None = None
    """Half the opening of the cone about ``direction`` that holds the truth with 95 %
    probability [degrees]."""
    gap_m: float | None = None
    """Free travel [m]; of backlash the free turn [rad], where the joint slides [m]. None where the
    data do not say."""
    gap_interval_m: tuple[float, float] | None = None
    """Ends of its 95 % interval, in the unit of ``gap_m``."""

    def __post_init__(self) -> None:
        """Check."""
        if self.kind not in get_args(FaultKind):
            raise InvalidData(
                f"the kind of a fault is one of {list(get_args(FaultKind))}, not {self.kind!r}"
            )
        if self.kind == HEALTHY and self.where is not None:
            raise InvalidData(f"a healthy arm has no location, got {self.where!r:.60}")
        if self.kind != HEALTHY and not self.where:
            raise InvalidData(f"{self.kind} needs the name of a location, got {self.where!r}")
        if self.direction is not None:
            if self.kind != "structural_looseness":
                raise InvalidData(f"{self.kind} has no direction, got {self.direction}")
            length = math.sqrt(sum(x * x for x in self.direction))
            if not abs(length - 1) < 1e-3:
                raise InvalidData(f"the direction is a unit vector, got {self.direction}")
        ends = self.gap_interval_m
        if ends is not None and not 0 <= ends[0] <= ends[1]:
            raise InvalidData(f"an interval of the gap goes upwards from zero or more, got {ends}")

    @property
    def hypothesis(self) -> str:
        """Key of the posterior."""
        return hypothesis_of(self.kind, self.where)


@dataclass(frozen=True, kw_only=True)
class SlideDirection:
    """Along which direction a link would slide if it were the loose one."""

    axis: Vector
    """Unit vector in the body's own frame, axial."""
    half_angle_deg: float
    """Half the opening of its 95 % cone [degrees]."""
