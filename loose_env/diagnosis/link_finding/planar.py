"""Link finding of the thesis: move joints one by one and compare directions.

Section 4.2.2 gives eight steps. In the tool frame, the direction of looseness at link i turns
when a joint i+1..n moves and stays when a joint 1..i moves. Going outward from the base, the
first joint whose move turns the direction is i+1; if none does, the last link is loose.

The steps alone never say healthy, backlash or last link. They are completed by the thesis's
own means, in this order:

1. *healthy*: the comparative index (6.17 or 6.18) against the nominal healthy arm stays under a
   threshold in the first poses;
2. *last link* (or, going inward, the first): no move turned the direction;
3. *backlash at joint j* (3.4): in every pose the direction is the line along which joint j
   itself moves the tool, and the motion along it is not normal (kurtosis).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.arms import LinearArm
from loose_env.errors import InvalidSetting
from loose_env.statistics import ComparativeIndex, axial_difference, comparative_index
from loose_env.typing import Array

__all__ = [
    "Finding",
    "LinkFindingSettings",
    "Order",
    "Sighting",
    "backlash_joint",
    "judge_turn",
    "looks_healthy",
    "next_joint",
]

Order = Literal["outward", "inward", "bisection"]
Finding = Literal["still", "turned", "unclear"]


@dataclass(frozen=True, kw_only=True)
class LinkFindingSettings:
    """Thresholds and excitation of the method; the thesis prints no thresholds."""

    order: Order = "outward"
    """Order of the joints: from the base out, from the tool in, or halving."""
    joint: int = 1
    """Joint that is excited, from 1."""
    level: int = 3
    """Excitation level, from 1."""
    still: float = 0.35
    """Threshold e_min on abs(z*): below it the direction stayed (step 6)."""
    turned: float = 0.35
    """Threshold e_max on abs(abs(z*) - 1): below it the direction turned (step 7)."""
    retries: int = 1
    """Further moves of one joint when neither threshold decides (step 8)."""
    index: Literal["d", "e"] = "d"
    """Comparative index that is asked about healthy: D (6.18) or E (6.17)."""
    healthy_index: float = 0.01
    """Comparative index up to which the arm looks healthy."""
    healthy_poses: int = 2
    """Poses that must look healthy before the verdict healthy."""
    backlash_angle: float = 20.0
    """Rms angle to a joint's own line up to which play in that joint explains it [deg]."""
    backlash_kurtosis: float = 0.5
    """Excess kurtosis along that line above which the motion is not normal."""

    def __post_init__(self) -> None:
        if self.order not in ("outward", "inward", "bisection"):
            raise InvalidSetting(f"order is 'outward', 'inward' or 'bisection', got {self.order!r}")
        if self.joint < 1 or self.level < 1:
            raise InvalidSetting(f"joint and level count from 1, got {self.joint} and {self.level}")
        for name in ("still", "turned", "healthy_index", "backlash_angle"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise InvalidSetting(f"{name} must be zero or more, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """Direction of looseness in one record, in the plane."""

    pose: Array
    """Pose [rad] (n,)."""
    direction: float
    """Direction of lowest correlation in the tool frame [rad], axial."""
    correlation: float
    """Maximum correlation [1]."""
    kurtosis: float
    """Excess kurtosis along the direction [1]."""
    nominal_direction: float
    """Direction of lowest correlation of the nominal healthy arm [rad], axial."""
    nominal_correlation: float
    """Maximum correlation of the nominal healthy arm [1]."""

    @property
    def index(self) -> ComparativeIndex:
        """Comparative index against the nominal healthy arm (6.15 to 6.18)."""
        return comparative_index(
            self.nominal_correlation, self.nominal_direction, self.correlation, self.direction
        )


def judge_turn(
    before: Sighting, after: Sighting, joint: int, settings: LinkFindingSettings
) -> Finding:
    """Say whether the direction turned when a joint moved (steps 5 to 8).

    The estimate of the joint's axis is z* = (p x p*) / sin(-move) (4.31). In the plane it is
    a number: 0 if the direction stayed, 1 if it turned by the whole move.

    Parameters
    ----------
    before, after : Sighting
        Records in two poses that differ in ``joint`` alone.
    joint : int
        The joint that moved, from 1.
    settings : LinkFindingSettings
        Holds the two thresholds.

    Examples
    --------
    >>> def at(q2, direction):
    ...     return Sighting(
    ...         pose=np.array([0.0, q2]),
    ...         direction=direction,
    ...         correlation=0.5,
    ...         kurtosis=0.0,
    ...         nominal_direction=0.0,
    ...         nominal_correlation=0.5,
    ...     )
    >>> judge_turn(at(0.0, 0.3), at(1.0, 0.3 - 1.0), 2, LinkFindingSettings())
    'turned'
    """
    move = float(after.pose[joint - 1] - before.pose[joint - 1])
    if abs(np.sin(move)) < 1e-6:
        return "unclear"
    cross = np.sin(axial_difference(after.direction, before.direction))
    axis = abs(float(cross / np.sin(-move)))
    if axis < settings.still:
        return "still"
    if abs(axis - 1) < settings.turned:
        return "turned"
    return "unclear"


def next_joint(order: Order, low: int, high: int) -> int:
    """Joint to move next while the loose link lies in low..high.

    A move of joint j that turns the direction says that the link is below j; one that leaves
    it says j or above.

    Examples
    --------
    >>> next_joint("outward", 1, 6), next_joint("inward", 1, 6), next_joint("bisection", 1, 6)
    (2, 6, 4)
    """
    if order == "outward":
        return low + 1
    if order == "inward":
        return high
    return (low + high + 1) // 2


def looks_healthy(sightings: Sequence[Sighting], settings: LinkFindingSettings) -> bool:
    """True if the comparative index is below its threshold in every record."""
    values = [s.index.mag_d if settings.index == "d" else s.index.mag_e for s in sightings]
    return max(values) <= settings.healthy_index


def backlash_joint(
    linear: LinearArm, sightings: Sequence[Sighting], settings: LinkFindingSettings
) -> int | None:
    """Joint whose play explains all sightings, or None.

    The directions must lie along the joint's own line, and the motion along it must not be
    normal.
    """
    if max(s.kurtosis for s in sightings) < settings.backlash_kurtosis:
        return None
    rms = []
    for j in range(linear.arm.n):
        off = []
        for s in sightings:
            line = linear.at(s.pose).kinematic[:, j]
            off.append(axial_difference(s.direction, float(np.arctan2(line[1], line[0]))))
        rms.append(float(np.sqrt(np.mean(np.square(off)))))
    best = int(np.argmin(rms))
    return best + 1 if np.degrees(rms[best]) <= settings.backlash_angle else None
