"""Effects of actuators: gain, first-order lag, and command delay."""

from __future__ import annotations

from math import ceil
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lfilter

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel, history_for
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class ActuatorGain(Effect):
    """Factor on the gain of an actuator.

    Variant "" scales its force, limits included, as another motor constant does. Variant "command"
    scales the command only; without a feedback term both are the same. Variant "servo" scales the
    force and leaves its limits, as other servo gains do: by far more than motors differ.
    """

    kind = "actuator_gain"
    exact_law: ClassVar[bool] = True
    acts_on: ClassVar[str] = "actuator"
    variants: ClassVar[tuple[str, ...]] = ("", "command", "servo")
    null_values: ClassVar[tuple[float, ...] | None] = (1.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return actuators whose force is linear in command, position and speed."""
        affine = machine.affine_actuators
        return tuple(n for k, n in enumerate(machine.actuators) if n and affine[k])

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return all variants where there is feedback and a limit."""
        number = machine.model.actuator(where).id
        if not np.any(machine.model.actuator_biasprm[number] != 0):
            return cls.variants[:1]
        return cls.variants if machine.model.actuator_forcelimited[number] else cls.variants[:2]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Scale factor."""
        if self.variant == "servo":
            return (Parameter(name="gain", unit="", low=1e-3, high=20.0, scale=1.0, log=True),)
        return (Parameter(name="gain", unit="", low=0.02, high=20.0, scale=0.1),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a tenth of a command is visible; with feedback forces have to vary more."""
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
        """Convert torque to measured torque: a stronger drive shows less for the same.

        Not where it is one of several at the joint: a joint torque alone does not give each one's
        share.
        """
        machine = self.machine
        if self.variant == "command" or machine.actuated_joint.get(self.where) != joint:
            return torque
        if np.count_nonzero(machine.gears(joint)) != 1 or joint in machine.pose_dependent_joints:
            return torque
        return torque / float(values[0])


_SHORTEST = 1e-9  # a lag below this is zero [s]
_STABLE = 0.5
"""Lag over the step from which on a Runge-Kutta method of fourth order is surely stable: its limit
is 1 / 2.785."""


class ActuatorLag(Effect):
    """First-order lag: commands pass a low-pass with a time constant.

    Commands are held from step to step, and the filter's response is exact: its mean moves the arm,
    its value at a step is visible in sensors there. MuJoCo's filters, used in the exported file,
    start at zero, not at the first command. A Runge-Kutta method integrates ``filter`` within its
    step; other methods use the value of ``filterexact`` at the beginning of a step for all of it.
    """

    kind = "actuator_lag"
    acts_on: ClassVar[str] = "actuator"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)
    is_time_shift: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return actuators without dynamics of their own."""
        plain = machine.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        return tuple(n for k, n in enumerate(machine.actuators) if n and plain[k])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Time constant."""
        return (Parameter(name="time_constant", unit="s", low=0.0, high=1.0, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts from a fast drive to a very slow one: a servo's response is not linear."""
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
        """Filter the actuator's commands: instantaneous values at each step."""
        state, _ = self._filtered(time, controls, values)
        return controls if state is None else self._with(controls, state)

    def _filtered(self, time: Array, controls: Array, values: Array) -> tuple[Array | None, Array]:
        """State of the filter at each step (T,), None without a lag; held commands."""
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
        """Export as MuJoCo's filter that suits the integrator."""
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


def clamped(machine: NominalModel, number: int, controls: Array) -> Array:
    """Clamp commands (T,) to the actuator's range, as MuJoCo does before filtering."""
    if not machine.model.actuator_ctrllimited[number]:
        return controls
    low, high = machine.model.actuator_ctrlrange[number]
    return np.asarray(np.clip(controls, low, high))


_LONGEST = 0.25
"""Longest delay that is tried [s]."""
_LINEAR = 1  # MuJoCo's interpolation order


class CommandDelay(Effect):
    """Delay of the commands, at one actuator or ("all") at all of them.

    A command is held from its step to the next. Held commands delayed by a fraction of a step
    change within it; their mean over the step is a linear interpolation between the two. MuJoCo's
    own delay, used in the exported file, does the same from one step upward.
    """

    kind = "command_delay"
    acts_on: ClassVar[str] = "actuator"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)
    is_time_shift: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every actuator, and "all" if there are several."""
        named = tuple(name for name in machine.actuators if name)
        return (*named, "all") if len(machine.actuators) > 1 else named

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Delay."""
        return (Parameter(name="delay", unit="s", low=0.0, high=_LONGEST, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts from a fast bus to hobby servos: a servo's response is not linear."""
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
        """Export as a history and a delay of the actuators, on top of existing ones."""
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
    """Delay [s] with linear interpolation, equivalent to an actuator's own delay."""
    own, step = float(actuator.delay), float(option.timestep)
    if own > 0 and actuator.interp:
        return own
    if option.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        return held_delay(own, step)
    # The history is also read within the step: interpolated on average half a step later, held
    # commands at its beginning, middle and end with weights 1, 4 and 1 sixths.
    stages = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))
    return sum(share * held_delay(own - at * step, step) for at, share in stages) + 0.5 * step


def held_delay(delay: float, step: float) -> float:
    """Delay of a history that holds its samples [s]: whole steps, rounded up.

    Examples
    --------
    >>> held_delay(0.0101, 0.002)
    0.012
    """
    return max(ceil(delay / step - 1e-9), 0) * step
