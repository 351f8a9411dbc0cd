"""Delay between a command and the actuator."""

from __future__ import annotations

from math import ceil
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.machine import Machine, history_for
from loose_env.gap.parameter import Parameter

__all__ = ["CommandDelay", "held_delay"]

Array = NDArray[np.float64]

_LONGEST = 0.25
"""Longest delay that is tried [s]."""
_LINEAR = 1  # MuJoCo's interpolation order


class CommandDelay(Effect):
    """Commands arrive late, at one actuator or ("all") at all of them.

    A command is held from its step to the next. Held commands that come late by a part of a step
    change within it; what counts is their mean over the step, which is a straight line between
    the two. MuJoCo's own delay, as which it is written out, does the same from one step upward.
    """

    kind = "command_delay"
    acts_on: ClassVar[str] = "actuator"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)
    shifts: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every actuator, and all of them if there are several."""
        named = tuple(name for name in machine.actuators if name)
        return (*named, "all") if len(machine.actuators) > 1 else named

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The delay."""
        return (Parameter(name="delay", unit="s", low=0.0, high=_LONGEST, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """From a fast bus to that of hobby servos: a servo answers none of them in proportion."""
        return ((0.001,), (0.003,), (0.008,), (0.02,), (0.05,), (0.12,))

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Shift the commands; before the first sample the first one holds."""
        delay = float(values[0])
        if delay <= 0:
            return controls
        late = controls.copy()
        for number in self._numbers:
            late[:, number] = np.interp(time - delay, time, controls[:, number])
        return late

    def command_at(self, time: Array, controls: Array, values: Array) -> Array:
        """Shift the commands, each held until the next."""
        delay = float(values[0])
        if delay <= 0 or len(time) < 2:
            return controls
        late = controls.copy()
        back = np.floor(np.arange(len(time)) - delay / (time[1] - time[0]) + 1e-9)
        late[:, self._numbers] = controls[np.maximum(back, 0).astype(int)][:, self._numbers]
        return late

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the actuators a history and a delay, on top of the delay that they have."""
        if values[0] <= 0:
            return
        for number in self._numbers:
            actuator = spec.actuators[number]
            delay = _as_line(actuator, spec.option) + float(values[0])
            actuator.delay, actuator.interp = delay, _LINEAR
            needed = history_for(delay, spec.option.timestep)
            actuator.nsample = max(needed, int(actuator.nsample))

    @property
    def _numbers(self) -> list[int]:
        actuators = self.machine.actuators
        if self.where == "all":
            return list(range(len(actuators)))
        return [actuators.index(self.where)]


def _as_line(actuator: mujoco.MjsActuator, option: mujoco.MjOption) -> float:
    """Delay [s] with straight lines between commands that does what an actuator's own does."""
    own, step = float(actuator.delay), float(option.timestep)
    if own > 0 and actuator.interp:
        return own
    if option.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        return held_delay(own, step)
    # It reads the history within the step too: lines on average half a step later, held commands
    # as they are at its beginning, middle and end, which weigh 1, 4 and 1 sixths.
    stages = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))
    return sum(share * held_delay(own - at * step, step) for at, share in stages) + 0.5 * step


def held_delay(delay: float, step: float) -> float:
    """How late a history shows what it holds from sample to sample [s]: whole steps, rounded up.

    Examples
    --------
    >>> held_delay(0.0101, 0.002)
    0.012
    """
    return max(ceil(delay / step - 1e-9), 0) * step
