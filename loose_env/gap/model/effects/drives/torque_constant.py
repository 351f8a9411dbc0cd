"""Torque-constant effect: factor between a joint's measured torque and the true one."""

from __future__ import annotations

from typing import ClassVar

from loose_env.gap.model.effect import Readings
from loose_env.gap.model.effects.mjcf.joint_effect import JointEffect
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class TorqueConstant(JointEffect):
    """Factor of a joint's measured torque: the drive's current times a wrong constant."""

    kind = "torque_constant"
    exact_law: ClassVar[bool] = True
    in_model: ClassVar[bool] = False
    null_values: ClassVar[tuple[float, ...] | None] = (1.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Measured over true torque."""
        return (Parameter(name="factor", unit="", low=0.02, high=50.0, scale=0.1),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a fifth less and more."""
        return ((0.8,), (1.25,))

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """Scale the joint's torque."""
        return torque * float(values[0]) if joint == self.where else torque

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Scale the joint's column of measured torque."""
        column = f"torque.{self.where}"
        if column not in readings:
            return readings
        return {**readings, column: float(values[0]) * readings[column]}

    def code(self, values: Array) -> str:
        """Python line: the measured torque of the joint."""
        return (
            f"measured_torque_{self.machine.joint_number(self.where)} = "
            f"{float(values[0])!r} * data.joint({self.where!r}).qfrc_actuator"
        )
