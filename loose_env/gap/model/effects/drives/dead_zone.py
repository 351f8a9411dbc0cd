"""Dead-zone effect: a servo's position error or a motor's command without torque if small."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from loose_env.gap.model.driven_effect import DrivenEffect
from loose_env.gap.model.effects.drives.limits import TorqueLimit
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class DeadZone(DrivenEffect):
    """Dead zone: an error of less than ``width`` gives no torque, a larger one that beyond it.

    Of a position servo the error of position, of a motor without feedback the command.
    """

    kind = "dead_zone"
    acts_on: ClassVar[str] = "actuator"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return drives of a joint with a position feedback, or with none."""
        model = machine.model
        kept = []
        for name in TorqueLimit.locations(machine):
            number = machine.actuators.index(name)
            gain, _, rate = model.actuator_gainprm[number, :3]
            offset, stiffness, damping = model.actuator_biasprm[number, :3]
            servo = gain != 0 and np.isclose(stiffness, -gain) and offset == 0
            if servo or (stiffness == 0 and damping == 0 and rate == 0):
                kept.append(name)
        return tuple(kept)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        model = machine.model
        self._number = machine.actuators.index(where)
        self._joint = machine.joint_number(machine.actuated_joint[where])
        self._gear = float(model.actuator_gear[self._number, 0])
        self._servo = bool(model.actuator_biasprm[self._number, 1] != 0)
        self._limits = model.actuator_ctrlrange[self._number].astype(float)
        self._limited = bool(model.actuator_ctrllimited[self._number])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Half width of the dead zone."""
        model = self.machine.model
        gain = abs(float(model.actuator_gainprm[self._number, 0])) or 1.0
        usual = self.machine.load(self.machine.joints[self._joint]) / (abs(self._gear) * gain)
        unit = "rad" if self.machine.turns(self.machine.joints[self._joint]) else "m"
        unit = unit if self._servo else ""
        return (Parameter(name="width", unit=unit, low=0.0, high=5 * usual, scale=0.1 * usual),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: errors of a thirtieth, a fifth and half of the typical torque."""
        scale = self.parameters[0].scale
        return ((0.3 * scale,), (2 * scale,), (5 * scale,))

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Move the command towards the position by the dead zone, at most onto it."""
        found, width = command.copy(), values[0]
        own = found[..., self._number]
        if self._limited:
            own = np.clip(own, *self._limits)
        at = self._gear * position[..., self._joint] if self._servo else np.zeros_like(own)
        found[..., self._number] = own - np.clip(own - at, -width, width)
        return found

    def feedback_code(self, values: Array) -> str:
        """Python lines: the command less the part of the error in the dead zone."""
        number, width = self._number, float(values[0])
        at = f"{self._gear!r} * position[{self._joint}]" if self._servo else "0.0"
        error = f"command[{number}] - {at}"
        limited = ""
        if self._limited:
            low, high = (float(v) for v in self._limits)
            limited = f"command[{number}] = np.clip(command[{number}], {low!r}, {high!r})\n"
        named = f"# dead zone of {self.where}\n"
        return f"{named}{limited}command[{number}] -= np.clip({error}, {-width!r}, {width!r})"
