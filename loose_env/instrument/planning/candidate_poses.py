"""Candidate poses within joint ranges, drive torques and collision limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loose_env.arms import Arm, LinearArm
from loose_env.errors import InvalidData
from loose_env.instrument.settings.thresholds import HOLDING_TORQUE
from loose_env.typing import Array

Allowed = Callable[[Array], bool]
"""Says whether a pose may be taken."""

_MOVES = np.radians([-90.0, -60.0, -30.0, 30.0, 60.0, 90.0])
_TRIES = 40
"""Random poses tried for each candidate."""


def pose_range(arm: Arm, margin: float) -> tuple[Array, Array]:
    """Lowest and highest position of every joint, with a margin (n,) each [rad or m].

    Joints that turn farther than half a turn to either side are kept to that.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> pose_range(planar(2), 0.0)[1].round(2).tolist()
    [3.14, 2.62]
    """
    low, high = np.full(arm.n, -np.pi), np.full(arm.n, np.pi)
    for j, limits in enumerate(arm.joint_ranges):
        if limits is None:
            continue
        spare = margin * (limits[1] - limits[0])
        low[j], high[j] = limits[0] + spare, limits[1] - spare
        if not arm.sliding[j] and low[j] < np.pi and high[j] > -np.pi:
            low[j], high[j] = max(low[j], -np.pi), min(high[j], np.pi)
    return low, high


def candidate_poses(
    arm: Arm,
    linear: LinearArm,
    *,
    count: int,
    margin: float,
    rng: np.random.Generator,
    here: Array | None = None,
    allowed: Allowed | None = None,
) -> Array:
    """Candidate poses: the current one, moves of a few joints, and random ones.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm = planar(2)
    >>> rng = np.random.default_rng(0)
    >>> candidate_poses(arm, LinearArm(arm), count=3, margin=0.05, rng=rng).shape
    (3, 2)
    """
    low, high = pose_range(arm, margin)
    limits = np.array(arm.torque_limits)

    def fits(q: Array) -> bool:
        if (q < low - 1e-9).any() or (q > high + 1e-9).any():
            return False
        if (np.abs(linear.at(q).gravity_torque) > HOLDING_TORQUE * limits).any():
            return False
        return allowed is None or allowed(q)

    found: list[Array] = []
    if here is not None:
        if fits(here):
            found.append(here)
        for _ in range(_TRIES * count):
            if len(found) >= count // 2:
                break
            moved = here + rng.choice(_MOVES, size=arm.n) * (rng.random(arm.n) < 0.5)
            moved[arm.sliding] = here[arm.sliding]
            if fits(moved):
                found.append(moved)
    for _ in range(_TRIES * count):
        if len(found) >= count:
            break
        q = low + (high - low) * rng.random(arm.n)
        if fits(q):
            found.append(q)
    if not found:
        raise InvalidData(
            f"arm {arm.name!r}: of {_TRIES * count} poses within the joints' ranges every one "
            f"collides or takes more than {HOLDING_TORQUE:.0%} of a drive's torque to hold; the "
            f"limits are {arm.torque_limits}: check the torque limits and the payload in the "
            "model, or give the pose yourself"
        )
    # Rounded to a hundredth of a degree or of a millimetre: somebody will type it in.
    return (
        np.where(arm.sliding, np.round(found, 5), np.radians(np.round(np.degrees(found), 2))) + 0.0
    )
