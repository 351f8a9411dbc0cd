"""Effect, a physical effect at one location on spec, command, torque or reading; Parameter.

An effect acts in up to four ways, each a method that a subclass overrides: `Effect.edit` changes
the MuJoCo spec, `Effect.command` the commands of the actuators, `Effect.torque` adds to the torque
on the joints, `Effect.read` changes the sensor values. ``docs/gap.md`` has examples.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_AT_BOUND = 1.02  # ratio of an interval's end to a parameter's bound at which it reaches it

Mountings = tuple[tuple[str, ...], ...]
"""Names of the runs of each way in which something is mounted."""
Readings = dict[str, Array]
"""Column without axis -> readings (..., T) of a scalar, (..., T, 3) of a vector."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A bounded scalar parameter.

    A fit works on a dimensionless free number: the value over its scale, or where ``log`` is set,
    the logarithm of the value over the scale.

    Examples
    --------
    >>> stiffness = Parameter(
    ...     name="stiffness", unit="N·m/rad", low=10, high=1e6, scale=100, log=True
    ... )
    >>> round(stiffness.free(1000.0), 3), round(stiffness.value(stiffness.free(1000.0)), 6)
    (2.303, 1000.0)
    """

    name: str
    """Name, as in the result file."""
    unit: str
    """Unit of the value, "" for a ratio."""
    low: float
    """Smallest value allowed."""
    high: float
    """Largest value allowed."""
    scale: float = 1.0
    """A change of the value that matters; positive."""
    log: bool = False
    """Whether the scale is logarithmic; needs a positive ``low``."""
    usual: float | None = None
    """Size of a change that would not surprise; None: ten times the scale."""
    starts: tuple[float, ...] = ()
    """Values from which fits start, each clearly visible."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not self.low < self.high or self.scale <= 0 or (self.log and self.low <= 0):
            raise InvalidSetting(
                f"parameter {self.name!r} needs low < high, scale > 0, and low > 0 if it is "
                f"logarithmic; got {self.low:g} to {self.high:g}, scale {self.scale:g}"
            )

    @classmethod
    def sized(
        cls,
        name: str,
        unit: str,
        size: float,
        low: float,
        high: float,
        *,
        scale: float = 0.1,
        starts: Iterable[float] = (),
        log: bool = False,
    ) -> Parameter:
        """Parameter whose bounds, scale and starts are given over a typical size."""
        return cls(
            name=name, unit=unit, low=low * size, high=high * size, scale=scale * size, log=log,
            starts=tuple(start * size for start in starts),
        )  # fmt: skip

    def free(self, value: float) -> float:
        """Convert a value to a free number."""
        return float(np.log(value / self.scale)) if self.log else value / self.scale

    def value(self, free: float) -> float:
        """Convert a free number to a value, within the bounds."""
        raw = self.scale * np.exp(np.clip(free, -50, 50)) if self.log else self.scale * free
        return self.clipped(float(raw))

    def clipped(self, value: float) -> float:
        """Clip a value to the bounds."""
        return float(np.clip(value, self.low, self.high))

    @property
    def unsurprising(self) -> float:
        """Size of a change that would not surprise."""
        return 10 * self.scale if self.usual is None else self.usual

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the free number."""
        return self.free(self.low), self.free(self.high)


def free_of(parameters: tuple[Parameter, ...], values: Array) -> Array:
    """Convert values (P,) to free numbers."""
    return np.array([p.free(float(v)) for p, v in zip(parameters, values, strict=True)])


def values_of(parameters: tuple[Parameter, ...], free: Array) -> Array:
    """Convert free numbers (P,) to values."""
    return np.array([p.value(float(f)) for p, f in zip(parameters, free, strict=True)])


class Effect:
    """One physical effect at one location.

    Parameters
    ----------
    machine : NominalModel
        The nominal model and its parameters.
    where : str
        One of `locations`.

    Raises
    ------
    UnknownName
        If it cannot be there.
    """

    kind: ClassVar[str] = ""
    """Identifier, as in the result file."""
    acts_on: ClassVar[str] = ""
    """What its locations name: "joint", "link", "actuator" or "sensor"; "arm" where they stand for
    all of it. A name alone does not tell, for a joint and its motor may share it. "": see `part`.
    """
    in_model: bool = True
    """Whether plain MJCF expresses it; otherwise `code` and `torque_code` say how it is applied."""
    null_values: ClassVar[tuple[float, ...] | None] = None
    """Values at which the effect vanishes; None where it does so only in a limit."""
    proportional: ClassVar[int | None] = None
    """Index of the only parameter that its change is about proportional to; None if all of them
    scale it, or none does."""
    is_additive: ClassVar[bool] = False
    """Whether its parameters are small steps along axes, whose changes add up: then screening
    evaluates each by itself and computes the best coefficient of every one."""
    needs_data_starts: ClassVar[bool] = False
    """Whether `starts` cannot cover its range, so that `propose` has to find starts in data."""
    limit: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Parameters, and their bounds, "low" or "high", that together define the limit of no
    effect, where `null_values` is None."""
    adds_motion: ClassVar[bool] = False
    """Whether the edit adds a degree of freedom, which is invisible in an inverse comparison."""
    extends: ClassVar[str] = ""
    """Kind that it is, with more parameters: dry friction is asymmetric, or falls with speed."""
    exact_law: ClassVar[bool] = False
    """Whether it is what it is called to the last digit, as an inertia, where a friction has a law
    that a machine obeys within some per cent."""
    has_stops: ClassVar[bool] = False
    """Whether it has parts with stops: after an impact no simulation is reproducible. Parameters
    named `gap`, `stiffness` and `damping_ratio`, if any, are those of the stops."""
    is_read_off: ClassVar[bool] = False
    """Whether readings show it by themselves, so that no force or motion is searched for it."""
    is_time_shift: ClassVar[bool] = False
    """Whether it shifts signals in time by its only parameter: accelerations are linear in it
    over a fraction of a millisecond only, positions over many."""
    mountings: Mountings = ()
    """Runs of each way in which it is mounted, where runs differ; none where all have it alike."""
    choices: float = 1.0
    """Among how many such ways, as likely, its own was chosen."""
    variants: ClassVar[tuple[str, ...]] = ("",)
    """Variants of the same kind, the default one first; the result file does not distinguish
    them."""

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        locations = self.locations(machine)
        if where not in locations:
            raise UnknownName(
                f"{self.kind} cannot be at {where!r}; its locations are {list(locations)}"
            )
        forms = self.variants_at(machine, where)
        variant = forms[0] if variant is None else variant
        if variant not in forms:
            raise UnknownName(
                f"{self.kind} at {where!r} has no variant {variant!r}; it has {list(forms)}"
            )
        self.machine, self.where, self.variant = machine, where, variant

    def __repr__(self) -> str:
        """Format kind, location, and the variant where there are several."""
        return f"{self.kind}@{self.where}" + (f" ({self.variant})" if self.variant else "")

    @property
    def key(self) -> tuple[str, str, str]:
        """Kind, location and variant."""
        return self.kind, self.where, self.variant

    @property
    def part(self) -> str:
        """Element type of its location: "joint", "link", "actuator", "sensor", or "arm".

        As in `acts_on`; without, inferred from its methods and from the names of the model.
        """
        if self.acts_on:
            return self.acts_on
        likely = "actuator" if self.overrides("command") else "joint"
        order = ("sensor" if not self.moves else likely, "joint", "link", "actuator", "sensor")
        known = (part for part in order if self.where in getattr(self.machine, f"{part}s"))
        return next(known, "arm")

    @property
    def drives(self) -> bool:
        """True if it changes the actuators; a friction acts beside them.

        None of them is active in a free run, and of an inverse run only the torque is known.
        """
        return self.part == "actuator" or self.overrides("command", "feedback")

    @property
    def moves(self) -> bool:
        """True if it changes the motion, not the readings alone."""
        return self.overrides("edit", "command", "torque", "feedback", "dry_friction")

    def overrides(self, *names: str) -> bool:
        """Return whether the class has any of some methods of its own."""
        return any(getattr(type(self), name) is not getattr(Effect, name) for name in names)

    def in_run(self, run: str, values: Array) -> tuple[Effect, Array] | None:
        """The effect of one run, if it has one; all have the same but where `mountings` differ."""
        return self, values

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return the `variants` that are distinct at a location; never empty."""
        return cls.variants

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return possible locations: names of the model, or "tool", "base", "all"."""
        raise NotImplementedError

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters to be fitted."""
        raise NotImplementedError

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting values of fits: all combinations of those of the parameters."""
        return tuple(product(*(p.starts for p in self.parameters)))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose starts from a joint's motion and the torque that is missing along it (T,) each.

        Beside `starts`, or in their place where these cannot cover the range.
        """
        return ()

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Change the spec in place; names that the recording uses must stay valid."""

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Change the spec of the exported model, which has no `command` and no `read`.

        As `edit`, unless MJCF has elements of its own for the function of those two.
        """
        self.edit(spec, values)

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Compute the commands that reach the actuators.

        Parameters
        ----------
        time : ndarray (T,)
            Simulation steps [s], evenly spaced.
        controls : ndarray (T, actuators)
            Commands at these steps.
        values : ndarray (P,)
            Of the parameters.
        """
        return controls

    def torque(self, position: Array, speed: Array, values: Array) -> Array:
        """Compute joint torques beyond those of the model, in the joints' direction.

        A smooth function of the state, the same in forward and inverse dynamics. A simulation holds
        it over each step, which limits how steep it may be: at a stiffness of 0.01 inertia / step²
        the frequency is off by 0.04 %, at 0.1 inertia / step² by 0.4 %, and at 4 the simulation is
        unstable; a damping of 0.1 inertia / step is off by 0.2 % under a Runge-Kutta method (5 %
        under others), of 0.3 by 2 %, and is unstable at 2. Friction that holds at rest is too
        steep: it is a joint's `frictionloss`, set in `edit`.

        Parameters
        ----------
        position, speed : ndarray (..., joints)
            Of all joints of the machine, in the order of `NominalModel.joints` [rad, m], [rad/s,
            m/s].
        values : ndarray (P,)
            Of the parameters.

        Returns
        -------
        ndarray (..., joints)
            [N·m, N]; zero where it does not act.
        """
        return np.zeros_like(position)

    def torque_along(self, position: Array, speed: Array, values: Array) -> Array:
        """Joint torques along a whole path (T, joints), where they depend on the way to a state.

        A simulation has them by the edit, which a force balance then leaves out.
        """
        return self.torque(position, speed, values)

    def torque_code(self, values: Array) -> str:
        """Python lines that add `torque` to a simulation of the written model; "" if none.

        They add to ``torque`` by ``position`` and ``speed``, arrays by joint (joints,) that the
        lines of `loose_env.gap.output.corrected_model.correction_code` have defined by then.
        """
        return ""

    @classmethod
    def null_value(cls, parameters: Sequence[str], parameter: str) -> float:
        """Value of a parameter without the effect; NaN if it vanishes only in a limit."""
        if cls.is_additive:
            return 0.0
        if cls.null_values is None or len(cls.null_values) < len(parameters):
            return float("nan")
        return cls.null_values[list(parameters).index(parameter)]

    def interval_includes_null(self, low: Array, high: Array) -> bool:
        """Return whether the parameter intervals (P,) include zero effect.

        They do if the null value lies within all of them, or if they reach the limit of no effect,
        such as that of a stiff spring. Play without clearance is no effect, however compliant the
        stops.
        """
        if self.null_values is None:
            ends = dict(self.limit)
            reached = {
                p.name: a <= _AT_BOUND * p.low if ends[p.name] == "low" else b >= p.high / _AT_BOUND
                for p, a, b in zip(self.parameters, low, high, strict=True)
                if p.name in ends
            }
            by_gap = self.has_stops and "gap" in reached
            return bool(reached) and bool(reached["gap"] if by_gap else all(reached.values()))
        null = np.array(self.null_values)
        included = (low <= null) & (null <= high)
        # what shapes an effect of no size does not matter
        sized = self.proportional is not None and not self.axes
        return bool(included[self.proportional] if sized else included.all())

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """Convert a joint's torque to the measured drive torque in inverse runs (T,).

        Drives measure their torque by their current: a drive with more torque per current shows
        less.
        """
        return torque

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Convert ideal sensor values to those with the effect; never changes its input."""
        return readings

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Compute the commands that reach the actuators in some states.

        A simulation holds them over each step, at its middle.
        """
        return command

    def feedback_code(self, values: Array) -> str:
        """Python lines that change ``command`` (actuators,) before each step; "" if none.

        They read ``position`` and ``speed`` (joints,).
        """
        return ""

    def dry_friction(self, drive: Array, load: Array, speed: Array, values: Array) -> Array:
        """Compute dry friction beyond the joints' friction loss; it holds a joint at rest."""
        return np.zeros_like(drive)

    def friction_code(self, values: Array) -> str:
        """Python lines that add `dry_friction` to ``friction``; "" if none.

        They read ``drive``, ``load`` and ``speed`` (joints,).
        """
        return ""

    def code(self, values: Array) -> str:
        """Python lines that apply effects which MJCF cannot express; "" if none."""
        return ""

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Values whose changes add up, for screening to combine by `combined`; none for most."""
        if not self.is_additive or self.null_values is None or len(self.parameters) < 2:
            return ()
        none = np.array(self.null_values)
        sizes = np.max(np.array(self.starts) - none, axis=0)
        return tuple(tuple(float(v) for v in none + row) for row in np.diag(sizes))

    def combined(self, shares: Array) -> tuple[float, ...]:
        """Values that change what its `axes` do together, each times its share.

        Parameters
        ----------
        shares : ndarray (K,)
            Share of each of the axes.
        """
        none = np.array(self.null_values)
        return tuple((none + shares @ (np.array(self.axes) - none)).tolist())

    def shares_of(self, values: Array) -> Array:
        """Shares (K,) of the axes that `combined` turns into some values."""
        none = np.array(self.null_values)
        return np.asarray((values - none) / np.diag(np.array(self.axes) - none))


class AdditiveEffect(Effect):
    """An effect whose parameters are small steps along axes, from zero."""

    is_additive: ClassVar[bool] = True

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        self.null_values = (0.0,) * len(self.parameters)  # type: ignore[misc]


class WeightedEffect(Effect):
    """An effect whose forces add up by its first parameter, each where it acts.

    Masses beside a tool, or springs at rest at several angles. The first of its axes acts at zero,
    each other one beside it along one coordinate.
    """

    def combined(self, shares: Array) -> tuple[float, ...]:
        """Size and place of the weighted axes; nothing where the size would be negative."""
        axes = np.array(self.axes)
        sizes = shares * axes[:, 0]
        size = float(sizes.sum())
        if size <= 0.0:
            return (0.0,) * len(self.parameters)
        return (size, *(sizes @ axes[:, 1:] / size).tolist())

    def shares_of(self, values: Array) -> Array:
        """Shares of the axes: moments by those beside zero, the rest of the size at it."""
        axes = np.array(self.axes)
        beside = values[0] * values[1:] / (axes[0, 0] * np.diag(axes[1:, 1:]))
        return np.append(values[0] / axes[0, 0] - beside.sum(), beside)


class DrivenEffect(Effect):
    """An effect that depends on commands or drive torques, applied step by step.

    MJCF has no elements for such effects: a simulation is stepped from Python, which sets them
    before each step, and so does the code in the result.
    """

    in_model: bool = False


class JointEffect(Effect):
    """An effect that can be at every joint."""

    acts_on: ClassVar[str] = "joint"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every joint."""
        return machine.joints

    @property
    def joint(self) -> str:
        """Name of the joint."""
        return self.where

    @property
    def number(self) -> int:
        """Index of the joint, and of its degree of freedom."""
        return self.machine.joint_number(self.joint)

    @property
    def load(self) -> float:
        """Typical torque [N·m] or force [N] of the joint."""
        return float(self.machine.load_scales[self.number])

    @property
    def speed(self) -> float:
        """Typical speed of the joint [rad/s or m/s]."""
        return float(self.machine.speed_scales[self.number])

    @property
    def moved(self) -> float:
        """Inertia on the joint, with its rotor [kg·m² or kg]."""
        return float(self.machine.inertias[self.number])

    @property
    def carried(self) -> float:
        """Inertia that the joint moves without its own rotor [kg·m² or kg]."""
        return max(self.moved - float(self.machine.model.dof_armature[self.number]), 1e-9)

    @property
    def turns(self) -> bool:
        """Whether the joint is a hinge; else a slide."""
        return self.machine.turns(self.joint)

    @property
    def torque_unit(self) -> str:
        """Unit of the joint's driving force."""
        return "N·m" if self.turns else "N"

    @property
    def angle_unit(self) -> str:
        """Unit of the joint's coordinate."""
        return "rad" if self.turns else "m"
