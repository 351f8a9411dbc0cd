"""Offset of a joint's encoder: the zero of its reading, and of its servo, lies elsewhere."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.joint_effect import JointEffect, angle_unit
from loose_env.gap.parameter import Parameter

__all__ = ["EncoderOffset"]

Array = NDArray[np.float64]


class EncoderOffset(JointEffect):
    """The joint's coordinate is the true one plus an offset.

    The reading and the servo go by the coordinate; the links, the joint's stops and its spring
    stay where they are.
    """

    kind = "encoder_offset"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset: reading minus truth."""
        if self.machine.turns(self.where):
            return (Parameter(name="offset", unit="rad", low=-1.0, high=1.0, scale=0.02),)
        return (Parameter(name="offset", unit="m", low=-0.3, high=0.3, scale=0.005),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Visible, to either side."""
        scale = self.parameters[0].scale
        return ((-scale,), (scale,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Shift the joint's reference, range and spring."""
        joint = spec.joint(self.where)
        offset = float(values[0]) / angle_unit(joint)
        joint.ref += offset
        joint.springref += offset
        if self.machine.model.jnt_limited[self.machine.joint_number(self.where)]:
            joint.range = np.array(joint.range) + offset
