"""Parameters of a hidden fault that decide its difficulty, such as seat drive over friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import shut_seats
from loose_env.envs import FaultSampler
from loose_env.excitation import at_levels
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
)


class SeatOpenness:
    """Drives the seats of an arm as hard as its levels allow, in a number of poses.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> openness = SeatOpenness(LinearArm(planar(2)))
    >>> seat = StructuralLooseness(
    ...     link=2, direction=(0, 1, 0), gap=1e-4, stiffness=(1e4, 1e4), friction=10.0
    ... )
    >>> openness.ratio(seat) > 1
    True
    """

    def __init__(self, linear: LinearArm, poses: int = 12) -> None:
        self._arm = arm = linear.arm
        self._linear = LinearArm(arm, points=8, remember=poses)
        rng = np.random.default_rng(0)
        self._drives: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        top = np.full(arm.n, arm.levels[-1])
        for _ in range(poses):
            pose = arm.random_pose(rng)
            played, _share = at_levels(self._linear.at(pose), top, duration=1.0)
            torque = np.array(played.torque_rms)
            if torque.any():  # not where gravity leaves the drives nothing
                self._drives.append((pose, torque))

    def ratio(self, fault: Fault) -> float | None:
        """Rms force on the shut seat over friction and gravity's load, in the best pose [1].

        All joints are shaken at the top level. None for faults without one seat that slides.
        """
        if isinstance(fault, StructuralLooseness):
            u = np.asarray(fault.direction, dtype=float)[: len(self._arm.axes)]
            place = self._arm.link_number(fault.link) - 1
        elif isinstance(fault, Backlash):
            u = np.eye(len(self._arm.axes))[0]
            place = self._arm.n + self._arm.link_number(fault.joint) - 1
        else:
            return None
        best = 0.0
        for pose, torque in self._drives:
            forces, loads = shut_seats(self._linear.at(pose), torque, u[None] / np.linalg.norm(u))
            held = fault.friction + float(loads[place])
            best = max(best, float(forces[place]) / held if held > 0 else np.inf)
        return best


@dataclass(frozen=True, kw_only=True)
class FaultParameters:
    """Parameters of one hidden fault; all None where nothing is loose."""

    gap: float | None = None
    """Travel from stop to stop, of the widest part [m, or rad where it turns]."""
    friction: float | None = None
    """Coulomb friction of the part that is driven best [N, or N·m where it turns]."""
    friction_ratio: float | None = None
    """Rms seat drive of the top level over the friction, of the part that is driven best [1].

    Below one the strongest shaking hardly moves the seat, and the fault looks healthy. None of a
    link that rocks."""
    opening_ratio: float | None = None
    """The same over friction and gravity's load together, all joints shaken, in the best of some
    poses; None for faults with several parts. Below one nothing opens the seat anywhere."""
    direction: tuple[float, float, float] | None = None
    """Direction of the slide, or axis of the rocking, of that part, in the link frame; None for
    play in a joint."""


def fault_parameters(sampler: FaultSampler, fault: Fault) -> FaultParameters:
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
    >>> round(fault_parameters(sampler, fault).friction_ratio, 6)
    4.0
    """
    found = _driven(sampler, fault)
    if not found:
        return FaultParameters()
    ratio, best = max(found, key=lambda pair: pair[0])
    direction = None
    if isinstance(best, StructuralLooseness):
        direction = best.direction
    elif isinstance(best, RotationalLooseness):
        direction = best.axis
    assert not isinstance(best, (Healthy, Preload))
    return FaultParameters(
        gap=float(max(gaps_of(fault))),
        friction=float(best.friction),
        friction_ratio=ratio or None,
        opening_ratio=_openness(sampler).ratio(fault),
        direction=direction,
    )


def drive_over_friction(sampler: FaultSampler, fault: Fault) -> float | None:
    """Rms seat drive of the top level over friction, of the part driven best [1].

    None where nothing is loose.
    """
    return max((ratio for ratio, _ in _driven(sampler, fault)), default=None)


def _driven(sampler: FaultSampler, fault: Fault) -> list[tuple[float, SinglePart]]:
    """Parts of a fault that can be loose, each with its drive over friction."""
    return [
        (_ratio(sampler, part), part)
        for part in parts_of(fault)
        if not isinstance(part, (Healthy, Preload))
    ]


@lru_cache(maxsize=4)
def _openness(sampler: FaultSampler) -> SeatOpenness:
    return SeatOpenness(sampler.linear)


def _ratio(sampler: FaultSampler, part: SinglePart) -> float:
    """Rms seat drive of the top level over the friction of one part; 0 of one that rocks."""
    assert not isinstance(part, (Healthy, Preload))
    if part.friction == 0:
        return math.inf
    if isinstance(part, Backlash):
        drive = sampler.drive.hinges[part.joint - 1]
    elif isinstance(part, StructuralLooseness):
        drive = sampler.drive.slide(part.link, part.direction)
    else:
        return 0.0  # what drives it is not worked out
    return float(drive / part.friction)
