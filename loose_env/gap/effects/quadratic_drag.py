"""Quadratic drag: a torque against the motion, in proportion to its speed squared."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, fitted_rate
from loose_env.gap.parameter import Parameter

__all__ = ["QuadraticDrag"]

Array = NDArray[np.float64]


class QuadraticDrag(JointEffect):
    """Torque -c v |v|: the second coefficient of MuJoCo's damping polynomial."""

    kind = "quadratic_drag"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        per_square = self.load / self.speed**2
        return (
            Parameter(
                name="drag",
                unit=f"{self.torque_unit}·s²/{self.angle_unit}²",
                low=0.0,
                high=50 * per_square,
                scale=0.1 * per_square,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A twentieth and a third of the typical torque at the typical speed."""
        per_square = self.load / self.speed**2
        return ((0.05 * per_square,), (0.3 * per_square,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping polynomial."""
        joint = spec.joint(self.where)
        damping = np.array(joint.damping)
        damping[1] += float(values[0])
        joint.damping = damping

    def resistance(self, speed: float, values: Array) -> float:
        """In proportion to the speed squared."""
        return float(values[0]) * speed**2

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on v |v|."""
        return ((self.parameters[0].clipped(fitted_rate(speed * np.abs(speed), torque)),),)
