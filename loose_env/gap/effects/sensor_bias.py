"""Bias of a sensor."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect, Readings
from loose_env.gap.effects.sensor_kinds import column_of, reading_scale
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["SensorBias"]

Array = NDArray[np.float64]

_AXES = {1: ("bias",), 3: ("bias_x", "bias_y", "bias_z")}


class SensorBias(Effect):
    """A constant on what a sensor shows, one for each axis; servos see the joint itself."""

    kind = "sensor_bias"
    acts_on: ClassVar[str] = "sensor"
    in_model: ClassVar[bool] = False
    adds_up: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every sensor of one axis or three."""
        dims = machine.model.sensor_dim
        return tuple(n for k, n in enumerate(machine.sensors) if n and int(dims[k]) in _AXES)

    def __init__(self, machine: Machine, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        self._size = int(machine.model.sensor(where).dim[0])
        self.nothing = (0.0,) * self._size  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The constant of each axis."""
        scale, unit = reading_scale(self.machine, self.where)
        return tuple(
            Parameter(name=name, unit=unit, low=-500 * scale, high=500 * scale, scale=scale)
            for name in _AXES[self._size]
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Visible on every axis."""
        scale, _ = reading_scale(self.machine, self.where)
        return ((scale,) * self._size,)

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Add to the sensor's column."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        bias = values[0] if self._size == 1 else np.asarray(values)
        return {**readings, column: readings[column] + bias}

    def code(self, values: Array) -> str:
        """One line: the reading plus the bias."""
        return f"data.sensor({self.where!r}).data += {[float(v) for v in values]}"
