"""The figures of a hidden fault that decide how hard it is to find."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from loose_env.envs import FaultSampler
from loose_env.evaluation.seat_openness import SeatOpenness
from loose_env.faults import (
    Backlash,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SinglePart,
    StructuralLooseness,
    gaps_of,
    parts_of,
    twist_of,
)

__all__ = ["HiddenFigures", "drive_over_friction", "hidden_figures"]


@dataclass(frozen=True, kw_only=True)
class HiddenFigures:
    """Figures of one hidden fault; all None where nothing is loose."""

    gap: float | None = None
    """Travel from stop to stop, of the widest part [m, or rad where it turns]."""
    friction: float | None = None
    """Coulomb friction of the part that is driven best [N, or N·m where it turns]."""
    friction_ratio: float | None = None
    """Rms seat drive of the top level over the friction, of the part that is driven best [1].

    Below one the strongest shaking hardly moves the seat, and the fault looks healthy."""
    opening_ratio: float | None = None
    """The same over friction and gravity's load together, all joints shaken, in the best of some
    poses; None for faults with several parts. Below one nothing opens the seat anywhere."""
    direction: tuple[float, float, float] | None = None
    """Direction of the slide, or axis of the rocking, of that part, in the link frame; None for
    play in a joint."""


def hidden_figures(sampler: FaultSampler, fault: Fault) -> HiddenFigures:
    """Say how hard a fault is driven, and what else decides whether it can be seen.

    Parameters
    ----------
    sampler : FaultSampler
        Knows the nominal arm and how hard its seats are driven.
    fault : Fault
        The hidden fault.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import vera
    >>> from loose_env.arms import LinearArm
    >>> from loose_env.envs import Difficulty
    >>> sampler = FaultSampler(LinearArm(vera()), Difficulty(friction=(0.25, 0.25)))
    >>> rng = np.random.default_rng(0)
    >>> fault = sampler.draw(rng, hypothesis="structural_looseness@link2")
    >>> round(hidden_figures(sampler, fault).friction_ratio, 6)
    4.0
    """
    found = [
        (_ratio(sampler, part), part)
        for part in parts_of(fault)
        if not isinstance(part, (Healthy, Preload))
    ]
    if not found:
        return HiddenFigures()
    ratio, best = max(found, key=lambda pair: pair[0])
    direction = None
    if isinstance(best, StructuralLooseness):
        direction = best.direction
    elif isinstance(best, RotationalLooseness):
        direction = best.axis
    assert not isinstance(best, (Healthy, Preload))
    return HiddenFigures(
        gap=float(max(gaps_of(fault))),
        friction=float(best.friction),
        friction_ratio=ratio,
        opening_ratio=_openness(sampler).ratio(fault),
        direction=direction,
    )


def drive_over_friction(sampler: FaultSampler, fault: Fault) -> float | None:
    """Rms seat drive of the top level over friction, of the part driven best [1].

    None where nothing is loose.
    """
    found = [
        _ratio(sampler, part)
        for part in parts_of(fault)
        if not isinstance(part, (Healthy, Preload))
    ]
    return max(found, default=None)


@lru_cache(maxsize=4)
def _openness(sampler: FaultSampler) -> SeatOpenness:
    return SeatOpenness(sampler.linear)


def _ratio(sampler: FaultSampler, part: SinglePart) -> float:
    """Rms seat drive of the top level over the friction of one part."""
    assert not isinstance(part, (Healthy, Preload))
    if part.friction == 0:
        return math.inf
    if isinstance(part, Backlash):
        drive = sampler.drive.hinge(part.joint)
    elif isinstance(part, StructuralLooseness):
        drive = sampler.drive.slide(part.link, part.direction)
    else:
        drive = sampler.further.drive.twist(part.link, twist_of(sampler.arm, part))
    return float(drive / part.friction)
