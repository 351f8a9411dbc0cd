"""Effects of drives: gain, lag, delay of commands, dead zone; limits of torque, voltage, speed."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import mujoco
import numpy as np
from scipy.signal import lfilter

from loose_env.gap.model.effect import DrivenEffect, Effect, JointEffect, Parameter
from loose_env.gap.model.nominal_model import NominalModel, history_for, named
from loose_env.typing import Array

_SHORTEST = 1e-9  # shift of commands below which it is none [s]


class ShiftedCommand(Effect):
    """An effect that shifts the commands of one drive, or of "all", in time."""

    acts_on = "actuator"
    null_values = (0.0,)
    is_time_shift = True

    @property
    def _numbers(self) -> list[int]:
        names = enumerate(self.machine.actuators)
        return [k for k, name in names if self.where in (name, "all")]

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Shift the commands: means over each step."""
        found = controls.copy()
        if values[0] >= _SHORTEST and len(time) > 1:
            for k in self._numbers:
                found[:, k] = self.passed(k, time, controls[:, k], float(values[0]))
        return found

    def passed(self, number: int, time: Array, held: Array, shift: float) -> Array:
        """Mean over each step (T,) of a drive's commands, each held."""
        raise NotImplementedError


class ActuatorGain(Effect):
    """Factor on the gain of an actuator.

    Variant "" scales its force, limits included, as another motor constant does. Variant "command"
    scales the command only; without a feedback term both are the same. Variant "servo" scales the
    force and leaves its limits, as other servo gains do: by far more than motors differ.
    """

    kind = "actuator_gain"
    acts_on = "actuator"
    exact_law = True
    variants = ("", "command", "servo")
    null_values = (1.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return actuators whose force is linear in command, position and speed."""
        return named(machine.actuators, machine.affine_actuators)

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return all variants where there is feedback and a limit."""
        number = machine.model.actuator(where).id
        if not np.any(machine.model.actuator_biasprm[number] != 0):
            return cls.variants[:1]
        return cls.variants if machine.model.actuator_forcelimited[number] else cls.variants[:2]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Scale factor: a tenth of a command is visible, forces have to vary more."""
        if self.variant == "servo":
            starts: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
            return (Parameter.sized("gain", "", 1, 1e-3, 20, scale=1, starts=starts, log=True),)
        starts = (0.9, 1.1) if self.variant else (0.8, 1.25)
        return (Parameter.sized("gain", "", 1.0, 0.02, 20, starts=starts),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Scale the actuator's parameters."""
        actuator, gain = spec.actuator(self.where), float(values[0])
        actuator.gainprm = gain * np.array(actuator.gainprm)
        if self.variant != "command":
            actuator.biasprm = gain * np.array(actuator.biasprm)
        if not self.variant:
            actuator.forcerange = gain * np.array(actuator.forcerange)

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """Convert torque to measured torque: a stronger motor, alone at its joint, shows less."""
        # gains of a servo and of its command do not change what a current means
        machine = self.machine
        own = not self.variant and machine.actuated_joint.get(self.where) == joint
        gears = machine.moments[machine.joint_number(joint)]
        alone = own and np.count_nonzero(gears) == 1
        return torque / float(values[0]) if alone else torque


_STABLE = 0.5
"""Lag over the step from which on a Runge-Kutta method of fourth order is surely stable: its limit
is 1 / 2.785."""


class ActuatorLag(ShiftedCommand):
    """First-order lag: commands pass a low-pass with a time constant.

    Commands are held from step to step, and the mean of the filter's response over each is exact.
    MuJoCo's filters, used in the exported file, start at zero, not at the first command. A
    Runge-Kutta method integrates ``filter`` within its step; other methods use the value of
    ``filterexact`` at the beginning of a step for all of it.
    """

    kind = "actuator_lag"
    # from a fast drive to a very slow one: a servo's response is not linear
    _starts = (0.1, 0.3, 0.8, 2.0, 6.0, 15.0)
    parameters = (Parameter.sized("time_constant", "s", 0.01, 0, 100, scale=1, starts=_starts),)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return actuators without dynamics of their own."""
        plain = machine.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        return named(machine.actuators, plain)

    def passed(self, number: int, time: Array, held: Array, shift: float) -> Array:
        """Filter the actuator's commands."""
        model, step = self.machine.model, time[1] - time[0]
        if model.actuator_ctrllimited[number]:  # as MuJoCo clamps before filtering
            held = np.clip(held, *model.actuator_ctrlrange[number])
        share = 1.0 - np.exp(-step / shift)
        after, _ = lfilter([share], [1.0, share - 1.0], held, zi=[(1.0 - share) * held[0]])
        state = np.concatenate([held[:1], after[:-1]])
        return np.asarray(held + (state - held) * (shift / step) * share)

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


DELAY = Parameter(
    name="delay", unit="s", low=0.0, high=0.25, scale=0.01,
    starts=(0.001, 0.003, 0.008, 0.02, 0.05, 0.12),
)  # fmt: skip
"""Delay, from a fast bus to hobby servos: a servo is not linear."""


class CommandDelay(ShiftedCommand):
    """Delay of the commands, at one actuator or ("all") at all of them.

    A command is held from its step to the next. Held commands delayed by a fraction of a step
    change within it; their mean over the step is a linear interpolation between the two. MuJoCo's
    own delay, used in the exported file, does the same from one step upward.
    """

    kind = "command_delay"
    parameters = (DELAY,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every actuator, and "all" if there are several."""
        return (*machine.actuators, "all") if len(machine.actuators) > 1 else machine.actuators

    def passed(self, number: int, time: Array, held: Array, shift: float) -> Array:
        """Shift the commands; before the first sample the first one holds."""
        return np.asarray(np.interp(time - shift, time, held))

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Export as a history and a delay of the actuators, on top of existing ones."""
        if values[0] <= 0:
            return
        for number in self._numbers:
            actuator = spec.actuators[number]
            delay = _as_line(actuator, spec.option) + float(values[0])
            delay_by(actuator, delay, spec.option.timestep)


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


def delay_by(late: mujoco.MjsActuator | mujoco.MjsSensor, delay: float, step: float) -> None:
    """Delay an actuator or a sensor [s], with linear interpolation in its history."""
    late.delay, late.interp = delay, 1
    late.nsample = max(history_for(delay, step), int(late.nsample))


def held_delay(delay: float, step: float) -> float:
    """Delay of a history that holds its samples [s]: whole steps, rounded up."""
    return max(ceil(delay / step - 1e-9), 0) * step


class CommandInterpolation(Effect):
    """Commands that reach the drives along straight lines, where a model holds each one.

    Many controllers interpolate between the set points that a log shows.
    """

    kind = "command_interpolation"
    acts_on = "arm"
    proportional = 0
    in_model = False
    null_values = (0.0,)
    # of the way from a held command to the straight line
    parameters = (Parameter(name="share", unit="", low=0.0, high=1.0, starts=(1.0,)),)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return all drives together."""
        return ("all",) if machine.actuators else ()

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Draw lines between the steps of the commands: means over each step."""
        steps = np.flatnonzero(np.any(np.diff(controls, axis=0) != 0, axis=1)) + 1
        at = np.concatenate([[0], steps, [len(time) - 1]])
        middle = time + 0.5 * (time[-1] - time[0]) / max(len(time) - 1, 1)
        lines = np.array([np.interp(middle, time[at], column[at]) for column in controls.T]).T
        return np.asarray(controls + values[0] * (lines - controls))


_LOWEST = 0.02  # lowest limit that is tried, over the typical torque
_HIGHEST = 20.0  # highest one of a drive whose model has none
_LEAST_GIVEN = 0.05  # lowest limit that is sought in data, over the largest torque given
_GRID, _SPEED_GRID = 150, 16  # limits, 2 % apart, and no-load speeds that are tried on data


class JointDriveEffect(JointEffect):
    """An effect of the drive of one joint, its force linear in command, position and speed."""

    acts_on = "actuator"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return drives of a joint without states of their own."""
        return tuple(n for n in ActuatorGain.locations(machine) if n in machine.actuated_joint)

    @property
    def joint(self) -> str:
        """Joint that it drives."""
        return self.machine.actuated_joint[self.where]

    @property
    def _number(self) -> int:
        """Index of the drive."""
        return self.machine.actuators.index(self.where)

    @property
    def gear(self) -> float:
        """Torque on the joint per force of the drive, with its sign."""
        return float(self.machine.model.actuator_gear[self._number, 0]) or 1.0


class SpeedLimit(JointDriveEffect):
    """Limit of the speed of a drive's set point, which follows the command no faster.

    Hobby servos and drives with a profile of their own have it.
    """

    kind = "speed_limit"
    limit = (("speed", "high"),)
    exact_law = True
    in_model = False

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return drives that hold a position."""
        servos = {machine.actuators[number] for number in machine.servos.values()}
        return tuple(name for name in super().locations(machine) if name in servos)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Largest speed of the set point: the largest speeds that were reached are near it."""
        usual = self.speed * abs(self.gear)
        unit, starts = f"{self.angle_unit}/s", (0.5, 0.8, 1.0, 1.3)
        return (
            Parameter.sized("speed", unit, usual, 0.05, 50, scale=1.0, starts=starts, log=True),
        )

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Let the set point follow the command: means over each step."""
        found = controls.copy()
        if len(time) > 1:
            most = float(values[0] * (time[1] - time[0]))
            state, way = float(controls[0, self._number]), []
            for asked in controls[:, self._number].tolist():
                step = min(max(asked - state, -most), most)
                way.append(state + 0.5 * step)
                state += step
            found[:, self._number] = way
        return found

    def feedback_code(self, values: Array) -> str:
        """Python lines: the set point of the step before, moved towards the command."""
        own, most = f"command[{self._number}]", f"{float(values[0])!r} * model.opt.timestep"
        return "\n".join(
            [
                'held = globals().setdefault("held", {})  # set points of the step before',
                f"at = held.setdefault({self.where!r}, {own})",
                f"{own} = held[{self.where!r}] = at + np.clip({own} - at, -{most}, {most})",
            ]
        )


class DriveLimit(JointDriveEffect):
    """A limit of the force of a drive, which may fall with speed."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Largest force of the actuator, at most that of the model; times its gear on the joint."""
        model, usual = self.machine.model, self.load / abs(self.gear)
        high = _HIGHEST * usual
        if model.actuator_forcelimited[self._number]:
            high = float(np.max(np.abs(model.actuator_forcerange[self._number])))
        limit = Parameter(
            name=self.limit[0][0], unit=self.torque_unit,
            low=min(_LOWEST * usual, 0.5 * high), high=high, scale=usual, log=True,
        )  # fmt: skip
        starts = (limit.clipped(min(s * usual, 0.8 * high)) for s in (0.4, 0.8, 1.5, 2.5))
        return (replace(limit, starts=tuple(dict.fromkeys(starts))),)

    def propose_limit(
        self, speed: Array, asked: Array, needed: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Start at the limit that turns what was asked into what was given, by least deviations."""
        gear = abs(self.gear)
        rate, asked, needed = speed * gear, asked / gear, needed / gear
        limit, *more = self.parameters
        most = limit.clipped(float(np.max(np.abs(needed))))
        least = min(max(limit.low, _LEAST_GIVEN * most), most)
        # from the largest on: of limits that explain as much the first is taken
        torques = np.geomspace(most, least, _GRID).tolist()
        speeds = [[v] for p in more for v in np.geomspace(p.high, p.low, _SPEED_GRID).tolist()]
        tried = [(t, *speed) for speed in speeds or [[]] for t in torques]
        off = [np.mean(np.abs(needed - _limited(asked, rate, *each))) for each in tried]
        return (tried[int(np.argmin(off))],)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Set the actuator's force range."""
        actuator, limit = spec.actuator(self.where), float(values[0])
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-limit, limit]


def _limited(force: Array, speed: Array, stall: float, free: float = np.inf) -> Array:
    """Force (T,) of a limited actuator, of that without limit and its speed."""
    back = stall / free * speed
    return np.asarray(np.clip(force + back, -stall, stall) - back)


class TorqueLimit(DriveLimit):
    """Limit of a drive's torque, below that of the model: saturation of its current."""

    kind = "torque_limit"
    limit = (("limit", "high"),)


class VoltageLimit(DriveLimit):
    """Limit of a drive's voltage: its largest torque falls with speed, by the back-EMF.

    At standstill the force is at most ``stall_torque``, at speed v at most
    ``stall_torque (1 - v / no_load_speed)`` in the direction of motion, and more against it. A
    voltage that is not at its limit compensates for the back-EMF as the servo's gains do.
    """

    kind = "voltage_limit"
    limit = (("stall_torque", "high"), ("no_load_speed", "high"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Largest force at standstill; speed of the actuator at which none is left."""
        usual, unit, starts = self.speed * abs(self.gear), f"{self.angle_unit}/s", (1.5, 4.0)
        free = Parameter.sized(
            "no_load_speed", unit, usual, 0.2, 50, scale=1, starts=starts, log=True
        )
        return (*super().parameters, free)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Limit the force without back-EMF, which acts beyond the limit as the actuator's damping.

        With stall torque T and back-EMF b v, clipping a force f to ± T - b v is the same as
        clipping f + b v to ± T and taking b v off again.
        """
        super().edit(spec, values)
        actuator, back = spec.actuator(self.where), float(values[0] / values[1])
        bias, damping = np.array(actuator.biasprm), np.array(actuator.damping)
        if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
            bias[:3] = 0.0
        bias[2] += back
        damping[0] += back
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm, actuator.damping = bias, damping


class DeadZone(DrivenEffect, JointDriveEffect):
    """Dead zone: an error of less than ``width`` gives no torque, a larger one that beyond it.

    Of a position servo the error of position, of a motor without feedback the command.
    """

    kind = "dead_zone"
    null_values = (0.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return drives of a joint with a position feedback, or with none."""
        model = machine.model
        gain, _, rate = model.actuator_gainprm[:, :3].T
        offset, stiffness, damping = model.actuator_biasprm[:, :3].T
        servo = (gain != 0) & np.isclose(stiffness, -gain) & (offset == 0)
        there = named(machine.actuators, servo | (stiffness == 0) & (damping == 0) & (rate == 0))
        return tuple(name for name in super().locations(machine) if name in there)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        model, number = machine.model, self._number
        self._servo = bool(model.actuator_biasprm[number, 1] != 0)
        limited = model.actuator_ctrllimited[number]
        self._limits = model.actuator_ctrlrange[number].tolist() if limited else None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Half width of the dead zone."""
        gain = abs(float(self.machine.model.actuator_gainprm[self._number, 0])) or 1.0
        usual = self.load / (abs(self.gear) * gain)
        unit = self.angle_unit if self._servo else ""
        # errors of a thirtieth, a fifth and half of the typical torque
        return (Parameter.sized("width", unit, usual, 0, 5, starts=(0.03, 0.2, 0.5)),)

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Move the command towards the position by the dead zone, at most onto it."""
        found, width = command.copy(), values[0]
        own = found[..., self._number]
        if self._limits:
            own = np.clip(own, *self._limits)
        at = self.gear * position[..., self.number] if self._servo else np.zeros_like(own)
        found[..., self._number] = own - np.clip(own - at, -width, width)
        return found

    def feedback_code(self, values: Array) -> str:
        """Python lines: the command less the part of the error in the dead zone."""
        own, width = f"command[{self._number}]", float(values[0])
        at = f"{self.gear!r} * position[{self.number}]" if self._servo else "0.0"
        lines = [f"# dead zone of {self.where}"]
        if self._limits:
            lines.append(f"{own} = np.clip({own}, {self._limits[0]!r}, {self._limits[1]!r})")
        return "\n".join([*lines, f"{own} -= np.clip({own} - {at}, {-width!r}, {width!r})"])
