"""What a model can lack: one physical effect at one place, with bounded parameters.

An effect acts in up to four ways, each a method that a subclass overrides: `Effect.edit` changes
the MuJoCo spec, `Effect.command` what reaches the actuators, `Effect.torque` adds to what acts on
the joints, `Effect.read` changes what the sensors show.
A new effect is one small class in one file:

    class MotorConstant(Effect):
        kind = "motor_constant"
        acts_on = "actuator"

        @classmethod
        def places(cls, machine):
            return machine.actuators

        @property
        def parameters(self):
            return (Parameter(name="factor", unit="", low=0.2, high=5.0, scale=1.0, log=True),)

        @property
        def starts(self):
            return ((0.8,), (1.25,))

        nothing = (1.0,)

        def edit(self, spec, values):
            ...

How accelerometers shook beyond the model, and in which pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.errors import UnknownName
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

__all__ = ["Effect", "Readings", "ResidualAccelerations"]


_AT_BOUND = 1.02
"""Ratio of an interval's end to a parameter's bound at which it reaches it."""

Readings = dict[str, Array]
"""Column without axis -> readings (..., T) of a scalar, (..., T, 3) of a vector."""


class Effect:
    """One effect at one place.

    Parameters
    ----------
    machine : Machine
        The nominal model and its figures.
    where : str
        One of `places`.

    Raises
    ------
    UnknownName
        If it cannot be there.
    """

    kind: ClassVar[str] = ""
    """Identifier, as in the result file."""
    acts_on: ClassVar[str] = ""
    """What its places name: "joint", "link", "actuator" or "sensor"; "arm" where they stand for all
    of it. A name alone does not tell, for a joint and its motor may share it. "": see `part`."""
    in_model: ClassVar[bool] = True
    """Whether plain MJCF expresses it; otherwise `code` and `torque_code` say how it is applied."""
    nothing: ClassVar[tuple[float, ...] | None] = None
    """Values at which the effect vanishes; None where it does so only in a limit."""
    proportional: ClassVar[int | None] = None
    """Number of the only parameter that what it changes is about proportional to; None if all of
    them scale it, or none does."""
    adds_up: ClassVar[bool] = False
    """Whether its parameters are small steps along axes, of which what they change adds up: then
    screening looks at each by itself and works out how much of every one is best."""
    searches: ClassVar[bool] = False
    """Whether `starts` cannot cover what it may be, so that `propose` has to find it in data."""
    limit: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Parameters, and which of their bounds, "low" or "high", are together nearest to no effect at
    all, where `nothing` is None."""
    adds_motion: ClassVar[bool] = False
    """Whether the edit adds a degree of freedom, which no inverse comparison can show."""
    sharp: ClassVar[bool] = False
    """Whether it asks for finer steps than a smooth model: a stiff spring, a joint that sticks."""
    has_stops: ClassVar[bool] = False
    """Whether parts of it strike each other: what follows a blow, no simulation repeats exactly.
    Parameters named `gap`, `stiffness` and `damping_ratio`, if any, are those of the stops."""
    shifts: ClassVar[bool] = False
    """Whether it shifts signals in time by its only parameter: accelerations answer that in
    proportion over a fraction of a millisecond only, positions over many."""
    variants: ClassVar[tuple[str, ...]] = ("",)
    """Forms of the same kind, the usual one first; the result file does not tell them apart."""

    def __init__(self, machine: Machine, where: str, variant: str | None = None) -> None:
        if where not in self.places(machine):
            raise UnknownName(
                f"{self.kind} cannot be at {where!r}; its places are {list(self.places(machine))}"
            )
        forms = self.forms(machine, where)
        if variant is None:
            variant = forms[0]
        if variant not in forms:
            raise UnknownName(
                f"{self.kind} at {where!r} has no variant {variant!r}; it has {list(forms)}"
            )
        self.machine, self.where, self.variant = machine, where, variant

    def __repr__(self) -> str:
        """Kind, place, and the variant where there are several."""
        return f"{self.kind}@{self.where}" + (f" ({self.variant})" if self.variant else "")

    @property
    def key(self) -> tuple[str, str, str]:
        """Kind, place and variant."""
        return self.kind, self.where, self.variant

    @property
    def part(self) -> str:
        """What its place names: "joint", "link", "actuator", "sensor", or "arm" for all of it.

        As `acts_on` says; without, by what it does and by the names of the model.
        """
        if self.acts_on:
            return self.acts_on
        machine = self.machine
        known = {
            "joint": machine.joints,
            "link": machine.links,
            "actuator": machine.actuators,
            "sensor": machine.sensors,
        }
        likely = "actuator" if type(self).command is not Effect.command else "joint"
        order = ("sensor" if not self.moves else likely, *known)
        return next((part for part in order if self.where in known[part]), "arm")

    @property
    def drives(self) -> bool:
        """Whether it acts on what actuators do.

        None of them is on in a free run, and of an inverse run only the torque is known.
        """
        return self.part == "actuator" or type(self).command is not Effect.command

    @property
    def moves(self) -> bool:
        """Whether it acts on the motion, not on the readings alone."""
        own = type(self)
        acting = ((own.edit, Effect.edit), (own.command, Effect.command))
        return any(a is not b for a, b in (*acting, (own.torque, Effect.torque)))

    @classmethod
    def forms(cls, machine: Machine, where: str) -> tuple[str, ...]:
        """Those of `variants` that make a difference at a place; never empty."""
        return cls.variants

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Where it can be: names of the model, or "tool", "base", "all"."""
        raise NotImplementedError

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is to be found out."""
        raise NotImplementedError

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Values from which fits begin, each clearly visible."""
        raise NotImplementedError

    @property
    def close_starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts for inverse runs, where those of an effect may have to lie closer together."""
        return self.starts

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Change the spec in place; names that the recording uses must stay valid."""

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Change the spec of the model that is written out, which has no `command` and no `read`.

        As `edit`, unless MJCF has means of its own for what those two do.
        """
        self.edit(spec, values)

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """What reaches the actuators.

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

    def command_at(self, time: Array, controls: Array, values: Array) -> Array:
        """What is at the actuators at each step itself, for what sensors read there.

        A step is simulated with the mean over it, as of `command`; where a held command changes
        within the step, an acceleration at its beginning is that of the command before.
        """
        return self.command(time, controls, values)

    def lateness(self, values: Array) -> tuple[str, float] | None:
        """Sensor that shows what was, and by how much [s]; None for what `read` can shift.

        A reading that jumps with commands, such as an acceleration, cannot be drawn out of its
        samples: it is worked out from the motion of then.
        """
        return None

    def torque(self, position: Array, speed: Array, values: Array) -> Array:
        """What acts on the joints besides what the model has, in their direction.

        A smooth function of the state, the same forwards and backwards. A simulation holds its
        mean over each step, which limits how steep it may be: at a stiffness of 0.01 inertia /
        step² the joint swings 0.04 % too fast, at 0.1 inertia / step² 0.4 %, and at 2 the
        simulation breaks; damping is off by 0.04 % at 0.1 inertia / step, by 0.5 % at 0.3, and
        breaks at 2. Friction that holds at rest is too steep: it is a joint's `frictionloss`,
        set in `edit`.

        Parameters
        ----------
        position, speed : ndarray (..., joints)
            Of all joints of the machine, in the order of `Machine.joints` [rad, m], [rad/s, m/s].
        values : ndarray (P,)
            Of the parameters.

        Returns
        -------
        ndarray (..., joints)
            [N·m, N]; zero where it does not act.
        """
        return np.zeros_like(position)

    def torque_code(self, values: Array) -> str:
        """Python lines that add `torque` to a simulation of the written model; "" if nothing.

        They add to ``torque`` by ``position`` and ``speed``, arrays by joint (joints,) that the
        lines of `loose_env.gap.output.export_mjcf.correction_code` have laid out by then.
        """
        return ""

    def at_limit(self, values: Array) -> Array:
        """Values with the parameters of `limit` at their bounds (P,)."""
        found, ends = np.array(values, dtype=float), dict(self.limit)
        for k, parameter in enumerate(self.parameters):
            if parameter.name in ends:
                found[k] = parameter.low if ends[parameter.name] == "low" else parameter.high
        return found

    def vanishes(self, low: Array, high: Array) -> bool:
        """Whether it may be nothing at all, by the intervals of its parameters (P,).

        It may if nothing lies within all of them, or if they reach the limit in which it does
        nothing, such as that of a stiff spring. Play without a gap is none, however soft the stops.
        """
        if self.nothing is None:
            ends = dict(self.limit)
            reached = {
                p.name: a <= _AT_BOUND * p.low if ends[p.name] == "low" else b >= p.high / _AT_BOUND
                for p, a, b in zip(self.parameters, low, high, strict=True)
                if p.name in ends
            }
            if self.has_stops and "gap" in reached:
                return bool(reached["gap"])
            return bool(reached) and all(reached.values())
        return bool(np.all((low <= np.array(self.nothing)) & (np.array(self.nothing) <= high)))

    def immaterial(self, values: Array) -> bool:
        """Whether it is too small to matter to anybody, however surely it is seen (P,)."""
        return False

    def resistance(self, speed: float, values: Array) -> float:
        """Torque or force [N·m or N] against a steady motion at a speed [rad/s or m/s].

        Zero for what is no friction.
        """
        return 0.0

    def displaced_mass(self, values: Array) -> float:
        """Mass that it adds, or moves by the length of its link [kg]; zero for most."""
        return 0.0

    @property
    def doubtful_mass(self) -> float:
        """Mass of which its law takes for granted how it lies along a link [kg]; zero for most."""
        return 0.0

    def unseen_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """What the joint needs for a motion (T,) [N·m or N] that inverse dynamics leave out.

        Zero but for effects whose edit adds a drive without input: MuJoCo's inverse dynamics of
        the edited model know dampers, springs and dry friction, but no actuators.
        """
        return np.zeros_like(angle)

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """What is shown as a drive's torque in an inverse comparison, where a joint needs it (T,).

        Drives tell their torque by their current: a drive that gives more for it shows less.
        """
        return torque

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """What the sensors show, in place of what an ideal one would; never changes its input."""
        return readings

    def code(self, values: Array) -> str:
        """Python lines that apply to a simulation what MJCF cannot express; "" if nothing."""
        return ""

    def propose_along(self, residual: ResidualAccelerations) -> tuple[tuple[float, ...], ...]:
        """Starts by what accelerometers show beyond the model; none where nothing can be said."""
        return ()

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Starts from data, in place of `starts`; empty where the data propose nothing.

        Parameters
        ----------
        angle, speed, acceleration : ndarray (T,)
            Motion of the effect's joint [rad, rad/s, rad/s² or m, m/s, m/s²].
        torque : ndarray (T,)
            What the joint needed beyond the nominal model for that motion [N·m or N].
        """
        return ()


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualAccelerations:
    """Measured less predicted accelerations."""

    joints: tuple[str, ...]
    """Names of the joints."""
    poses: Array
    """Their measured positions (K, joints) [rad, m]."""
    sites: tuple[str, ...]
    """Site of the accelerometer (K,)."""
    accelerations: Array
    """In the frame of the site (K, 3) [m/s²]."""
