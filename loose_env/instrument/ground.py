"""Poses that keep the arm above what it stands on, where the model knows no ground."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm

__all__ = ["Ground"]

Array = NDArray[np.float64]

_BELOW = 0.005
"""How far below the ground a point may be by rounding of the model [m]."""
_STEP = 0.1
"""Largest move of a joint between two looks on a way [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """A plane across gravity that links and tool stay above."""

    arm: Arm
    """The arm."""
    height: float
    """Of the plane, against gravity from the model's origin [m]; -inf for no ground."""

    @classmethod
    def of(cls, arm: Arm, height: float | None = None) -> Ground:
        """Take a given height [m], or the model's origin for an arm that stands.

        An arm that hangs, its second joint below its first, gets no ground by itself, nor one
        without gravity.

        Examples
        --------
        >>> import numpy as np
        >>> from loose_env.arms import six_axis
        >>> ground = Ground.of(six_axis())
        >>> ground.clear(np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0]))
        True
        """
        if height is not None:
            return cls(arm=arm, height=float(height))
        if not np.any(arm.model.opt.gravity):
            return cls(arm=arm, height=-np.inf)
        bare = cls(arm=arm, height=-np.inf)
        points, first = bare._heights(arm.model.qpos0[arm.pose_addresses])
        if points[0] < first - _BELOW:
            return bare  # the second joint is below the first
        return cls(arm=arm, height=min(0.0, first))

    def clear(self, pose: Array) -> bool:
        """Whether links beyond the first and the tool are above it."""
        if np.isneginf(self.height):
            return True
        return bool((self._heights(pose)[0] >= self.height - _BELOW).all())

    def clear_between(self, start: Array, end: Array) -> bool:
        """Whether the arm stays above it on the straight way in joint space between two poses.

        An arm that stands below it is let out, and not in again.
        """
        if np.isneginf(self.height):
            return True
        steps = max(1, int(np.ceil(np.abs(end - start).max() / _STEP)))
        clear = [self.clear(start + (end - start) * k / steps) for k in range(steps + 1)]
        return all(clear[clear.index(True) :]) if any(clear) else False

    def _heights(self, pose: Array) -> tuple[Array, float]:
        """Heights of the links beyond the first and the tool, and of the first [m]."""
        model = self.arm.model
        data = mujoco.MjData(model)
        data.qpos[self.arm.pose_addresses] = pose
        mujoco.mj_kinematics(model, data)
        up = -model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
        first, *others = [data.body(name).xpos for name in self.arm.seat_bodies]
        points = np.array([*others, data.site(self.arm.tool).xpos])
        return points @ up, float(first @ up)
