"""A pose as numbers of an observation, and back: hinges by sine and cosine, slides in place."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = ["JointPose"]


class JointPose:
    """Two numbers for every joint, each from -1 to 1.

    A hinge is its sine and its cosine. A slide is its position within its range, -1 at the low
    end and 1 at the high end, and a zero.

    Parameters
    ----------
    arm : Arm
        The arm.

    Raises
    ------
    InvalidSetting
        If a joint slides without limits.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> shown = JointPose(scara())
    >>> first, second = shown.numbers(np.array([0.0, 0.0, -0.21, 0.0]))
    >>> first.tolist(), second.tolist()
    ([0.0, 0.0, -1.0, 0.0], [1.0, 1.0, 0.0, 1.0])
    >>> shown.pose(first, second).tolist()
    [0.0, 0.0, -0.21, 0.0]
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.slides = np.flatnonzero(arm.sliding)
        """Joints that slide."""
        limits = np.array([(0.0, 0.0) if r is None else r for r in arm.joint_ranges])
        self.middle = limits.mean(axis=1)
        """Middle of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        self.width = limits[:, 1] - limits[:, 0]
        """Width of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        for j in self.slides:
            if not self.width[j] > 0:
                raise InvalidSetting(
                    f"joint {arm.joints[j]!r} of arm {arm.name!r} slides and has the range "
                    f"{arm.joint_ranges[j]}; its moves and its place in an observation are "
                    "shares of a range: give (low, high) in metres"
                )

    @property
    def elements(self) -> Iterator[tuple[str, str]]:
        """Name and unit of every number, in the order of the observation."""
        for part, of_slide, unit in (
            ("sin_pose", "position", "of range"),
            ("cos_pose", "unused", "1"),
        ):
            for joint, slides in zip(self.arm.joints, self.arm.sliding, strict=True):
                yield (f"{part}.{joint}_{of_slide}", unit) if slides else (f"{part}.{joint}", "1")

    def numbers(self, pose: Array) -> tuple[Array, Array]:
        """Turn a pose [rad or m] (n,) into the first and the second numbers (n,), (n,)."""
        first, second, k = np.sin(pose), np.cos(pose), self.slides
        if len(k):
            first[k] = 2 * (pose[k] - self.middle[k]) / self.width[k]
            second[k] = 0.0
        return first, second

    def pose(self, first: Array, second: Array) -> Array:
        """Turn numbers (..., n) back into poses (..., n) [rad or m].

        A hinge may be off by whole turns: it is given as near the middle of its range as can be.
        """
        found = np.arctan2(first, second)
        found = found + 2 * np.pi * np.round((self.middle - found) / (2 * np.pi))
        k = self.slides
        found[..., k] = self.middle[k] + 0.5 * self.width[k] * first[..., k]
        return np.asarray(found)
