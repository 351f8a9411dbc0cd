"""Delay of a sensor."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect, Readings
from loose_env.gap.effects.command_delay import held_delay
from loose_env.gap.effects.sensor_kinds import column_of, of_place_or_speed
from loose_env.gap.machine import Machine, history_for
from loose_env.gap.parameter import Parameter

__all__ = ["SensorDelay", "delayed"]

Array = NDArray[np.float64]

_LONGEST = 0.25
"""Longest delay that is tried [s]."""


class SensorDelay(Effect):
    """A sensor shows what was; servos see the joint itself, as it is.

    Written out as MuJoCo's own sensor delay.
    """

    kind = "sensor_delay"
    acts_on: ClassVar[str] = "sensor"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)
    shifts: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every sensor."""
        return tuple(name for name in machine.sensors if name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The delay."""
        return (Parameter(name="delay", unit="s", low=0.0, high=_LONGEST, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """From a fast bus to that of hobby servos."""
        return ((0.001,), (0.003,), (0.008,), (0.02,), (0.05,), (0.12,))

    @property
    def _jumps(self) -> bool:
        """Whether the reading is no place or speed, nor one that the model delays already."""
        spec_sensor = self.machine.spec.sensor(self.where)
        smooth = of_place_or_speed(self.machine, column_of(self.where))
        return not smooth and float(spec_sensor.delay) == 0.0

    def lateness(self, values: Array) -> tuple[str, float] | None:
        """The delay of an acceleration or a force."""
        return (self.where, float(values[0])) if self._jumps else None

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Shift the column of a place or a speed."""
        column = column_of(self.where)
        if column not in readings or values[0] <= 0 or self._jumps:
            return readings
        vector = int(self.machine.model.sensor(self.where).dim[0]) > 1
        late = delayed(time, readings[column], float(values[0]), axis=-2 if vector else -1)
        return {**readings, column: late}

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the sensor a history and a delay, on top of the delay that it has."""
        if values[0] <= 0:
            return
        sensor, step = spec.sensor(self.where), float(spec.option.timestep)
        own = float(sensor.delay) if sensor.interp else held_delay(float(sensor.delay), step)
        sensor.delay, sensor.interp = own + float(values[0]), 1
        sensor.nsample = max(history_for(sensor.delay, step), int(sensor.nsample))


def delayed(time: Array, values: Array, delay: float, *, axis: int = -1) -> Array:
    """Values as they were, straight lines between samples; before the first one it holds.

    Examples
    --------
    >>> delayed(np.arange(4.0), np.array([0.0, 2.0, 4.0, 6.0]), 0.5)
    array([0., 1., 3., 5.])
    """
    at = np.interp(time - delay, time, np.arange(len(time), dtype=float))
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(time) - 1)
    moved = np.moveaxis(values, axis, -1)
    share = at - low
    return np.moveaxis(moved[..., low] * (1 - share) + moved[..., high] * share, -1, axis)
