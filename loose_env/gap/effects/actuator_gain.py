"""Gain of an actuator: the force of the whole drive, or the command alone."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["ActuatorGain"]

Array = NDArray[np.float64]

_GAINS = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE)
_BIASES = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)


class ActuatorGain(Effect):
    """A factor on what an actuator does.

    Variant "" scales its force, limits included, as another motor constant does. Variant
    "command" scales what is commanded only; without a feedback term both are the same. Variant
    "servo" scales the force and leaves its limits, as another setting of a servo does: by far more
    than motors differ.
    """

    kind = "actuator_gain"
    acts_on: ClassVar[str] = "actuator"
    variants: ClassVar[tuple[str, ...]] = ("", "command", "servo")
    nothing: ClassVar[tuple[float, ...] | None] = (1.0,)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every actuator whose force is linear in command, position and speed."""
        model = machine.model
        linear = np.isin(model.actuator_gaintype, [int(g) for g in _GAINS])
        linear &= np.isin(model.actuator_biastype, [int(b) for b in _BIASES])
        return tuple(n for k, n in enumerate(machine.actuators) if n and linear[k])

    @classmethod
    def forms(cls, machine: Machine, where: str) -> tuple[str, ...]:
        """All where there is feedback and a limit."""
        number = machine.model.actuator(where).id
        if not np.any(machine.model.actuator_biasprm[number] != 0):
            return cls.variants[:1]
        return cls.variants if machine.model.actuator_forcelimited[number] else cls.variants[:2]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The factor."""
        if self.variant == "servo":
            return (Parameter(name="gain", unit="", low=1e-3, high=20.0, scale=1.0, log=True),)
        return (Parameter(name="gain", unit="", low=0.02, high=20.0, scale=0.1),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A tenth of a command is visible; a force has to change more behind feedback."""
        if self.variant == "servo":
            return ((0.01,), (0.03,), (0.1,), (0.3,))
        return ((0.9,), (1.1,)) if self.variant else ((0.8,), (1.25,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Scale the actuator's parameters."""
        actuator, gain = spec.actuator(self.where), float(values[0])
        actuator.gainprm = gain * np.array(actuator.gainprm)
        if self.variant != "command":
            actuator.biasprm = gain * np.array(actuator.biasprm)
        if not self.variant:
            actuator.forcerange = gain * np.array(actuator.forcerange)

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """A stronger drive shows less torque for the same.

        Not where it is one of several at the joint: a torque alone does not say what each gave.
        """
        machine = self.machine
        if self.variant == "command" or machine.actuated_joint.get(self.where) != joint:
            return torque
        if np.count_nonzero(machine.gears(joint)) != 1 or joint in machine.with_changing_gears:
            return torque
        return torque / float(values[0])
