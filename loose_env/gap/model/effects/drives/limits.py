"""Effects that limit a drive: torque saturation, and voltage saturation with back-EMF."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_LOWEST = 0.02
"""Lowest limit that is tried, over the typical torque."""
_HIGHEST = 20.0
"""Highest one of a drive whose model has none."""
_STARTS = (0.4, 0.8, 1.5, 2.5)
"""Limits from which fits start."""
_LEAST_GIVEN = 0.05
"""Lowest limit that is sought in data, over the largest torque given."""
_GRID, _SPEED_GRID = 150, 16
"""Limits, 2 % apart, and no-load speeds that are tried on data."""
_SPEEDS = (1.5, 4.0)
"""No-load speeds from which fits start, over the typical speed."""


class DriveLimit(Effect):
    """A limit of the drive of one joint, its force linear in command, position and speed."""

    acts_on: ClassVar[str] = "actuator"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return drives of a joint without states of their own."""
        affine = machine.affine_actuators
        return tuple(
            n
            for k, n in enumerate(machine.actuators)
            if n and affine[k] and n in machine.actuated_joint
        )

    @property
    def _number(self) -> int:
        return self.machine.actuators.index(self.where)

    @property
    def _joint(self) -> str:
        return self.machine.actuated_joint[self.where]

    @property
    def _gear(self) -> float:
        return abs(float(self.machine.model.actuator_gear[self._number, 0])) or 1.0

    def _limit(self, name: str) -> Parameter:
        """Largest force of the actuator, at most that of the model."""
        model, usual = self.machine.model, self.machine.load(self._joint) / self._gear
        high = _HIGHEST * usual
        if model.actuator_forcelimited[self._number]:
            high = float(np.max(np.abs(model.actuator_forcerange[self._number])))
        unit = "N·m" if self.machine.turns(self._joint) else "N"
        return Parameter(
            name=name, unit=unit, low=min(_LOWEST * usual, 0.5 * high), high=high, scale=usual,
            log=True,
        )  # fmt: skip

    def _starts(self, torques: Sequence[float]) -> tuple[float, ...]:
        """Limits to start from, below that of the model."""
        limit = self.parameters[0]
        return tuple(dict.fromkeys(limit.clipped(min(t, 0.8 * limit.high)) for t in torques))

    def propose_limit(
        self, speed: Array, asked: Array, needed: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Start at the limit that turns what was asked into what was given, by least deviations.

        Without such a limit that is the largest torque given.
        """
        rate, asked, needed = speed * self._gear, asked / self._gear, needed / self._gear
        limit = self.parameters[0]
        most = limit.clipped(float(np.max(np.abs(needed))))
        least = min(max(limit.low, _LEAST_GIVEN * most), most)
        # from the largest on: of limits that explain as much the first is taken
        torques = np.geomspace(most, least, _GRID)
        tried = [(float(t), *more) for more in self._beside() for t in torques]
        off = [np.mean(np.abs(needed - self._limited(asked, rate, each))) for each in tried]
        return (tried[int(np.argmin(off))],)

    def _beside(self) -> tuple[tuple[float, ...], ...]:
        """Values of further parameters that are tried beside each limit."""
        return ((),)

    @abstractmethod
    def _limited(self, force: Array, speed: Array, values: Sequence[float]) -> Array:
        """Force (T,) of the limited actuator, of that without limit and its speed."""

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts around the typical torque."""
        return self._about([share * self.parameters[0].scale for share in _STARTS])

    def _about(self, torques: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Starts at some limits."""
        return tuple((value,) for value in self._starts(torques))

    def _set(self, spec: mujoco.MjSpec, limit: float) -> mujoco.MjsActuator:
        """Set the limit of a spec's actuator."""
        actuator = spec.actuator(self.where)
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-limit, limit]
        return actuator


class TorqueLimit(DriveLimit):
    """Limit of a drive's torque, below that of the model: saturation of its current."""

    kind = "torque_limit"
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("limit", "high"),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Largest force of the actuator; on the joint it is that times its gear."""
        return (self._limit("limit"),)

    def _limited(self, force: Array, speed: Array, values: Sequence[float]) -> Array:
        return np.clip(force, -values[0], values[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Set the actuator's force range."""
        self._set(spec, float(values[0]))


class VoltageLimit(DriveLimit):
    """Limit of a drive's voltage: its largest torque falls with speed, by the back-EMF.

    At standstill the force is at most ``stall_torque``, at speed v at most
    ``stall_torque (1 - v / no_load_speed)`` in the direction of motion, and more against it. A
    voltage that is not at its limit compensates for the back-EMF as the servo's gains do.
    """

    kind = "voltage_limit"
    limit: ClassVar[tuple[tuple[str, str], ...]] = (
        ("stall_torque", "high"),
        ("no_load_speed", "high"),
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Largest force at standstill; speed of the actuator at which none is left."""
        usual = self.machine.speed(self._joint) * self._gear
        unit = "rad/s" if self.machine.turns(self._joint) else "m/s"
        speed = Parameter(
            name="no_load_speed", unit=unit, low=0.2 * usual, high=50 * usual, scale=usual, log=True
        )
        return (self._limit("stall_torque"), speed)

    def _about(self, torques: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Starts at some stall torques and around the typical speed."""
        usual = self.parameters[1].scale
        return tuple((value, s * usual) for value in self._starts(torques) for s in _SPEEDS)

    def _beside(self) -> tuple[tuple[float, ...], ...]:
        speed = self.parameters[1]
        return tuple((float(v),) for v in np.geomspace(speed.high, speed.low, _SPEED_GRID))

    def _limited(self, force: Array, speed: Array, values: Sequence[float]) -> Array:
        stall, free = values
        back = stall / free * speed
        return np.clip(force + back, -stall, stall) - back

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Limit the force without back-EMF, which acts beyond the limit as the actuator's damping.

        With stall torque T and back-EMF b v, clipping a force f to ± T - b v is the same as
        clipping f + b v to ± T and taking b v off again.
        """
        stall, free = float(values[0]), float(values[1])
        actuator = self._set(spec, stall)
        back = stall / free
        bias = np.array(actuator.biasprm)
        if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
            bias[:3] = 0.0
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        bias[2] += back
        actuator.biasprm = bias
        damping = np.array(actuator.damping)
        damping[0] += back
        actuator.damping = damping
