"""A spring across a joint: cables, hoses, balancers."""

from __future__ import annotations

from math import pi
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, angle_unit, fitted_rate
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["JointSpring"]

Array = NDArray[np.float64]


class JointSpring(JointEffect):
    """Torque -k (q - q0), combined exactly with a spring that the joint already has."""

    kind = "joint_spring"
    proportional: ClassVar[int | None] = 0
    nothing: ClassVar[tuple[float, ...] | None] = (0.0, 0.0)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every joint but those with a spring that is not straight."""
        bent = np.any(machine.model.jnt_stiffnesspoly != 0, axis=1)
        return tuple(name for name, b in zip(machine.joints, bent, strict=True) if not b)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness and the coordinate at which the spring rests."""
        low, high = self._range
        width = high - low
        return (
            Parameter(
                name="stiffness",
                unit=f"{self.torque_unit}/{self.angle_unit}",
                low=0.0,
                high=50 * self.load / min(width, pi),
                scale=0.2 * self.load / min(width, pi),
            ),
            Parameter(
                name="reference",
                unit=self.angle_unit,
                low=low - 2 * width,
                high=high + 2 * width,
                scale=0.2 * width,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A third of the typical torque over the range, at rest in its middle."""
        low, high = self._range
        width = high - low
        stiffness = 0.5 * self.load / min(width, pi)
        middle = 0.5 * (low + high)
        return (
            (stiffness, middle),
            (stiffness, low - 0.2 * width),
            (stiffness, high + 0.2 * width),
        )

    @property
    def _range(self) -> tuple[float, float]:
        """Range of the joint [rad or m], or half a turn about its zero."""
        number = self.machine.joint_number(self.where)
        if self.machine.model.jnt_limited[number]:
            low, high = self.machine.model.jnt_range[number]
            return float(low), float(high)
        half = pi / 2 if self.machine.turns(self.where) else 0.5
        return -half, half

    def vanishes(self, low: Array, high: Array) -> bool:
        """By its stiffness alone."""
        return bool(low[0] <= 0 <= high[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Set the joint's stiffness and spring reference to those of both springs together."""
        added, rest = float(values[0]), float(values[1])
        if added == 0:
            return
        joint = spec.joint(self.where)
        unit = angle_unit(joint)
        stiffness = np.array(joint.stiffness)
        both = stiffness[0] + added
        rests = (stiffness[0] * joint.springref * unit + added * rest) / both
        stiffness[0] = both
        joint.stiffness, joint.springref = stiffness, rests / unit

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the angle; where it is zero, the spring rests."""
        stiffness, reference = self.parameters
        rate = fitted_rate(angle, torque)
        if rate <= 0:
            return ()
        rests = float(np.nanmean(angle) - np.nanmean(torque) / rate)
        return ((stiffness.clipped(rate), reference.clipped(rests)),)
