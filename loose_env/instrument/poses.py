"""Poses to shake in: in which loads reverse, and places throw the tool apart from one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument import knocks
from loose_env.instrument.arm import ROCKS, PoseModel, SuspectArm
from loose_env.instrument.controllers import Controller
from loose_env.instrument.signals import Multisine, peaks
from loose_env.typing import Array

CANDIDATES = 60
"""Random poses looked at."""
_COARSE = 24
"""Directions of each seat that a choice of poses looks at."""
_DRAWS = 40
"""Draws per candidate before the room is said to be too small."""
_APART = 0.5
"""Squared sine between two places' throws, summed over the poses, from which they are apart [1]."""
REVERSES = 1.0
"""Load's smaller peak over friction from which a place parts, and is tested [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A pose, what the signal does in it, and how it tests every hypothesis."""

    pose: Array
    model: PoseModel
    peak: Array
    """Peak acceleration of each joint at full level (n,) [rad/s², m/s²]."""
    reversing: Array
    """How far each hypothesis' load reverses, over friction (H,)."""
    throws: Array
    """Covariance of the tool's acceleration by each (H, 3, 3), trace 1."""


def candidate(arm: SuspectArm, pose: Array, signal: Multisine, controller: Controller) -> Candidate:
    """Foresee a pose with the physics that judges the record."""
    model = arm.at(pose)
    room = np.minimum(pose - arm.low, arm.high - pose)
    peak = peaks(
        signal, controller, model, arm.joints, arm.torque_limit, travel=np.maximum(room, 0)
    )
    moved = signal.accelerations(peak, 250)
    loads = knocks.loads_of(model, moved, np.zeros(arm.n))
    grid = knocks.sphere(_COARSE)
    return Candidate(
        pose=pose,
        model=model,
        peak=peak,
        reversing=knocks.reversing(loads, grid, arm.slides),
        throws=knocks.thrown(loads, grid),
    )


def owners(n: int, directions: int = _COARSE) -> Array:
    """Place of each hypothesis (H,): seats 0 to n - 1, teeth n to 2 n - 1, the base 2 n."""
    return np.concatenate(
        [np.repeat(np.arange(n), directions), n + np.arange(n), np.full(ROCKS, 2 * n)]
    )


def choose_poses(
    arm: SuspectArm,
    signal: Multisine,
    controller: Controller,
    count: int,
    rng: np.random.Generator,
    *,
    low: Array,
    high: Array,
    wanted: Sequence[int] = (),
) -> list[Candidate]:
    """Greedy choice of poses that test what is not tested yet and tell the places apart.

    Parameters
    ----------
    low, high : ndarray
        Room of the poses (n,) [rad, m].
    wanted : sequence of int
        Places that count alone, as `owners` numbers them; by default all but the base, which every
        pose loads.

    Raises
    ------
    InvalidSetting
        If no pose in the room is free of collisions.
    """
    pool: list[Candidate] = []
    for _ in range(CANDIDATES * _DRAWS):
        pose = rng.uniform(low, high)
        if arm.ground.clear(pose) and not arm.collisions.touch(pose):
            pool.append(candidate(arm, pose, signal, controller))
            if len(pool) == CANDIDATES:
                break
    if not pool:
        raise InvalidSetting(
            "no pose in the room is free of collisions and above the ground; widen --low and --high"
        )
    owner = owners(arm.n)
    counts = np.isin(owner, list(wanted) or range(2 * arm.n))
    weight = counts / np.bincount(owner)[owner]  # each place counts once
    arms = owner < 2 * arm.n  # a rocking base is told from the arm's places, not they from it
    same = owner[:, None] == owner[None, arms]
    apart = np.zeros(same.shape)
    tested = np.zeros(len(owner))
    thrown = [c.throws.reshape(len(owner), 9) for c in pool]
    unlike = [1 - each @ each[arms].T for each in thrown]
    chosen: list[Candidate] = []
    left = list(range(len(pool)))
    while left and len(chosen) < count:
        gains = []
        for k in left:
            tells = np.minimum(np.where(same, 9.0, apart + unlike[k]).min(1), _APART) / _APART
            tests = np.minimum(np.maximum(tested, pool[k].reversing), REVERSES) / REVERSES
            gains.append(float(weight @ (tells + tests)))
        best = left.pop(int(np.argmax(gains)))
        chosen.append(pool[best])
        apart += unlike[best]
        tested = np.maximum(tested, pool[best].reversing)
    return chosen


def tested_share(reversing: Array, n: int, directions: int = _COARSE) -> Array:
    """Share of each place's directions whose load reverses in some pose (2 n + 1,), from (R, H)."""
    owner = owners(n, directions)
    able = (reversing.max(0) >= REVERSES).astype(float)
    return np.bincount(owner, weights=able) / np.bincount(owner)


def is_tested_share(share: float) -> bool:
    """True if a place's loads reverse in all directions that count."""
    return share >= _ALL_DIRECTIONS


_ALL_DIRECTIONS = 0.95
"""Share of a seat's directions whose load must reverse for it to count as tested whole [1]."""
