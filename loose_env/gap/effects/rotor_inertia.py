"""Rotor inertia: what a joint's drive carries, the same in every pose."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, fitted_rate
from loose_env.gap.parameter import Parameter

__all__ = ["RotorInertia"]

Array = NDArray[np.float64]


class RotorInertia(JointEffect):
    """Armature beyond that of the model; less than that down to none at all."""

    kind = "rotor_inertia"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The inertia added."""
        moved = self.machine.inertia(self.where)
        return (
            Parameter(
                name="inertia",
                unit="kg·m²" if self.machine.turns(self.where) else "kg",
                low=-float(self.machine.model.dof_armature[self._dof]),
                high=100 * moved,
                scale=0.1 * moved,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A fifth of what the joint moves, and as much again."""
        moved = self.machine.inertia(self.where)
        return ((0.2 * moved,), (1.0 * moved,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's armature."""
        joint = spec.joint(self.where)
        joint.armature = max(joint.armature + float(values[0]), 0.0)

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the acceleration."""
        return ((self.parameters[0].clipped(fitted_rate(acceleration, torque)),),)
