"""Gain of a sensor."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect, Readings
from loose_env.gap.effects.sensor_kinds import column_of
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["SensorGain"]

Array = NDArray[np.float64]

_NEGLIGIBLE = 1e-3
"""Error of a gain that no sensor is calibrated to."""


class SensorGain(Effect):
    """A factor on what a sensor shows; servos see the joint itself."""

    kind = "sensor_gain"
    acts_on: ClassVar[str] = "sensor"
    in_model: ClassVar[bool] = False
    nothing: ClassVar[tuple[float, ...] | None] = (1.0,)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every sensor."""
        return tuple(name for name in machine.sensors if name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The factor."""
        return (Parameter(name="gain", unit="", low=0.1, high=10.0, scale=0.05),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A tenth less and more."""
        return ((0.9,), (1.1,))

    def immaterial(self, values: Array) -> bool:
        """Sensors are not calibrated that well."""
        return abs(float(values[0]) - 1.0) < _NEGLIGIBLE

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Scale the sensor's column."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        return {**readings, column: float(values[0]) * readings[column]}

    def code(self, values: Array) -> str:
        """One line: the reading times the gain."""
        return f"data.sensor({self.where!r}).data *= {float(values[0])!r}"
