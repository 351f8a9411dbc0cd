"""First-order lag of an actuator."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from loose_env.gap.effect import Effect
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["ActuatorLag", "clamped"]

Array = NDArray[np.float64]

_SHORTEST = 1e-9  # a lag below this is none [s]
_STABLE = 0.5
"""Lag over the step from which on a Runge-Kutta method of fourth order is surely stable: its limit
is 1 / 2.785."""


class ActuatorLag(Effect):
    """What reaches the actuator follows the command with a time constant.

    Commands are held from step to step, and the filter's answer is exact: its mean moves the arm,
    its value at a step is what sensors show there. MuJoCo's filters, as which it is written out,
    start at zero, not at the first command. A Runge-Kutta method takes ``filter`` along within its
    step; other methods take the value of ``filterexact`` at the beginning of a step for all of it.
    """

    kind = "actuator_lag"
    acts_on: ClassVar[str] = "actuator"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)
    shifts: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every actuator without dynamics of its own."""
        plain = machine.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        return tuple(n for k, n in enumerate(machine.actuators) if n and plain[k])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The time constant."""
        return (Parameter(name="time_constant", unit="s", low=0.0, high=1.0, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """From a fast drive to a very slow one: a servo answers none of them in proportion."""
        return ((0.001,), (0.003,), (0.008,), (0.02,), (0.06,), (0.15,))

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Filter the actuator's commands: means over each step."""
        state, held = self._filtered(time, controls, values)
        if state is None:
            return controls
        lag, step = float(values[0]), time[1] - time[0]
        mean = held + (state - held) * (lag / step) * (1.0 - np.exp(-step / lag))
        return self._with(controls, mean)

    def command_at(self, time: Array, controls: Array, values: Array) -> Array:
        """Filter the actuator's commands: what is there at each step."""
        state, _ = self._filtered(time, controls, values)
        return controls if state is None else self._with(controls, state)

    def _filtered(self, time: Array, controls: Array, values: Array) -> tuple[Array | None, Array]:
        """State of the filter at each step (T,), None without a lag, and the commands held."""
        held = clamped(self.machine, self._number, controls[:, self._number])
        if values[0] < _SHORTEST or len(time) < 2:
            return None, held
        share = 1.0 - np.exp(-(time[1] - time[0]) / float(values[0]))
        after, _ = lfilter([share], [1.0, share - 1.0], held, zi=[(1.0 - share) * held[0]])
        return np.concatenate([held[:1], after[:-1]]), held

    def _with(self, controls: Array, own: Array) -> Array:
        found = controls.copy()
        found[:, self._number] = own
        return found

    @property
    def _number(self) -> int:
        return self.machine.actuators.index(self.where)

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the actuator MuJoCo's filter that suits the integrator."""
        lag, step = float(values[0]), float(spec.option.timestep)
        if lag < _SHORTEST:
            return
        actuator = spec.actuator(self.where)
        if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
            lag = max(lag, _STABLE * step)
        else:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            # the value at a step's beginning is half a step behind its mean
            lag = max(lag - 0.5 * step, 0.1 * lag)
        actuator.dynprm = [lag, *np.array(actuator.dynprm)[1:]]


def clamped(machine: Machine, number: int, controls: Array) -> Array:
    """Commands (T,) within the actuator's range, as MuJoCo clamps them before it filters them."""
    if not machine.model.actuator_ctrllimited[number]:
        return controls
    low, high = machine.model.actuator_ctrlrange[number]
    return np.asarray(np.clip(controls, low, high))
