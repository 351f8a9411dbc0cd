"""Coulomb friction: a constant torque against the motion, which holds a joint at rest."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, fitted_rate
from loose_env.gap.parameter import Parameter

__all__ = ["CoulombFriction", "make_it_stick"]

Array = NDArray[np.float64]

_STIFF = 0.9999  # MuJoCo's largest constraint impedance


class CoulombFriction(JointEffect):
    """Friction beyond that of the model; less than that down to none at all.

    MuJoCo's own friction creeps: with its default impedance, 0.9, a joint that is held against
    10 rad/s² drifts at about 0.01 rad/s. The stiffest impedance makes that 1e-6 rad/s at a step
    of 1 ms.
    """

    kind = "coulomb_friction"
    sharp: ClassVar[bool] = True
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The torque added."""
        nominal = float(self.machine.model.dof_frictionloss[self._dof])
        return (
            Parameter(
                name="torque",
                unit=self.torque_unit,
                low=-nominal,
                high=nominal + 20 * self.load,
                scale=0.1 * self.load,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A thirtieth and a fifth of the typical torque."""
        return ((0.03 * self.load,), (0.2 * self.load,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's friction loss."""
        if values[0] == 0:
            return
        joint = spec.joint(self.where)
        joint.frictionloss = max(joint.frictionloss + float(values[0]), 0.0)
        make_it_stick(joint, spec.option.timestep)

    def resistance(self, speed: float, values: Array) -> float:
        """The torque, at any speed."""
        return float(values[0])

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the direction of motion, rest left out."""
        moving = np.abs(speed) > 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        rate = fitted_rate(np.sign(speed[moving]), torque[moving])
        return ((self.parameters[0].clipped(rate),),)


def make_it_stick(joint: mujoco.MjsJoint, step: float) -> None:
    """Make a joint's friction as stiff as a step [s] allows."""
    joint.solimp_friction = [_STIFF, _STIFF, 0.001, 0.5, 2]
    joint.solref_friction = [2 * step, 1.0]
