"""Viscous friction: a torque against the motion, in proportion to its speed."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, fitted_rate
from loose_env.gap.parameter import Parameter

__all__ = ["ViscousFriction"]

Array = NDArray[np.float64]


class ViscousFriction(JointEffect):
    """Damping beyond that of the model; less than that down to none at all."""

    kind = "viscous_friction"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The damping added."""
        per_speed = self.load / self.speed
        return (
            Parameter(
                name="damping",
                unit=f"{self.torque_unit}·s/{self.angle_unit}",
                low=-self._nominal,
                high=self._nominal + 50 * per_speed,
                scale=0.1 * per_speed,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A twentieth and a third of the typical torque at the typical speed, and much less.

        The damping of a model is often that of a stable simulation, ten times the machine's: half
        of it taken away shows that, where it matters.
        """
        per_speed = self.load / self.speed
        starts: tuple[tuple[float, ...], ...] = ((0.05 * per_speed,), (0.3 * per_speed,))
        much = 0.5 * self._nominal
        return (*starts, (-much,)) if much > starts[-1][0] else starts

    @property
    def _nominal(self) -> float:
        """Damping of the model."""
        return float(self.machine.model.dof_damping[self._dof])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping, or take that share of the model's away.

        As a share, so that a joint without any answers to it, whatever the model's is off by.
        """
        joint, added = spec.joint(self.where), float(values[0])
        damping = np.array(joint.damping)
        if added < 0:
            damping[0] *= max(1.0 + added / self._nominal, 0.0)
        else:
            damping[0] += added
        joint.damping = damping

    def resistance(self, speed: float, values: Array) -> float:
        """In proportion to the speed."""
        return float(values[0]) * speed

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the speed."""
        return ((self.parameters[0].clipped(fitted_rate(speed, torque)),),)
