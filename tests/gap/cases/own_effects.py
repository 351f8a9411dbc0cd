"""Effects that a user might write: terms on the torque that MJCF has no means for."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from loose_env.gap.model.effects.mjcf.joint_effect import JointEffect
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class OneTerm(JointEffect):
    """A term at one joint, of its own position and speed."""

    in_model = False
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(name="size", unit="", low=-1e4, high=1e4, scale=1.0),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        return ((1.0,),)

    def torque(self, position: Array, speed: Array, values: Array) -> Array:
        found = np.zeros_like(position)
        k = self.machine.joint_number(self.where)
        found[..., k] = float(values[0]) * self.law(position[..., k], speed[..., k])
        return found

    def law(self, angle: Array, speed: Array) -> Array:
        raise NotImplementedError


class CubicSpring(OneTerm):
    kind = "cubic_spring"

    def law(self, angle: Array, speed: Array) -> Array:
        return -(angle**3)

    def torque_code(self, values: Array) -> str:
        k = self.machine.joint_number(self.where)
        return f"torque[{k}] -= {float(values[0])!r} * position[{k}] ** 3"


class LinearSpring(OneTerm):
    kind = "linear_spring"

    def law(self, angle: Array, speed: Array) -> Array:
        return -angle


class Cogging(OneTerm):
    kind = "cogging"

    def law(self, angle: Array, speed: Array) -> Array:
        return np.asarray(np.sin(20 * angle + 0.3) + 0.4 * np.sin(40 * angle))


class Damper(OneTerm):
    kind = "damper"

    def law(self, angle: Array, speed: Array) -> Array:
        return -speed


class SlickFriction(OneTerm):
    kind = "slick_friction"

    def law(self, angle: Array, speed: Array) -> Array:
        return np.asarray(-np.tanh(speed / 0.1))
