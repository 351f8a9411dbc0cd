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


class ActuatorLag(Effect):
    """What reaches the actuator follows the command with a time constant.

    The same recursion as MuJoCo's ``filterexact``, as which it is written out; there its state
    starts at zero, here at the first command.
    """

    kind = "actuator_lag"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

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
        """A fast drive, a slow one and a very slow one."""
        return ((0.005,), (0.04,), (0.15,))

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Filter the actuator's commands."""
        if values[0] < _SHORTEST or len(time) < 2:
            return controls
        number = self.machine.actuators.index(self.where)
        filtered = controls.copy()
        raw = clamped(self.machine, number, controls[:, number])
        share = 1.0 - np.exp(-(time[1] - time[0]) / float(values[0]))
        # A step's force comes from the state before that step.
        state, _ = lfilter([share], [1.0, share - 1.0], raw, zi=[(1.0 - share) * raw[0]])
        filtered[0, number], filtered[1:, number] = raw[0], state[:-1]
        return filtered

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the actuator MuJoCo's exact filter."""
        if values[0] < _SHORTEST:
            return
        actuator = spec.actuator(self.where)
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm = [float(values[0]), *np.array(actuator.dynprm)[1:]]


def clamped(machine: Machine, number: int, controls: Array) -> Array:
    """Commands (T,) within the actuator's range, as MuJoCo clamps them before it filters them."""
    if not machine.model.actuator_ctrllimited[number]:
        return controls
    low, high = machine.model.actuator_ctrlrange[number]
    return np.asarray(np.clip(controls, low, high))
