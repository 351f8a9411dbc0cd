"""Effects of mass and gravity: link mass and centre, payload, base tilt, gravity compensation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.gap.model.effect import AdditiveEffect, Effect, Mountings, Parameter, WeightedEffect
from loose_env.gap.model.effects import mjcf
from loose_env.gap.model.nominal_model import NominalModel, link_ends, normal_of, reach_of
from loose_env.typing import Array


def links_with_mass(machine: NominalModel) -> tuple[str, ...]:
    """Names of the links that have mass of their own."""
    return tuple(name for name in machine.links if machine.model.body(name).mass[0] > 0)


class LinkEffect(Effect):
    """An effect of a link."""

    acts_on = "link"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links that have mass."""
        return links_with_mass(machine)

    def in_link(self, vector: Array) -> Array:
        """Turn a vector (3,) from the world into the link's frame, at the model's zero."""
        turn = self.machine.at_zero.body(self.where).xmat.reshape(3, 3)
        return np.asarray(turn.T @ vector)


class LinkMass(LinkEffect):
    """Mass added to a link at its own centre; its inertia grows in proportion."""

    kind = "link_mass"
    null_values = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added mass."""
        own = float(self.machine.model.body(self.where).mass[0])
        return (Parameter.sized("mass", "kg", own, -0.9, 20, starts=(-0.25, 0.25)),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Scale the link's mass and inertia."""
        old = mjcf.inertial_of(self.machine, spec, self.where)
        factor = max(1.0 + float(values[0]) / old.mass, 0.01)
        scaled = mjcf.Inertial(factor * old.mass, old.centre, factor * old.tensor)
        mjcf.set_inertial(self.machine, spec, self.where, scaled)


class LinkCom(AdditiveEffect, LinkEffect):
    """Shift of the centre of mass along the body's axes; mass and inertia stay.

    Of a machine that moves in a plane only the shift in the plane counts; an axis of the body that
    is perpendicular to the plane has no parameter.
    """

    kind = "link_com"

    @cached_property
    def _axes(self) -> tuple[int, ...]:
        """Axes of the body that count."""
        normal = normal_of(self.machine)
        across = np.zeros(3) if normal is None else self.in_link(normal)
        return tuple(k for k in range(3) if abs(across[k]) < 1 - 1e-6)

    @cached_property
    def _length(self) -> float:
        """Length of the link, or a twentieth of the machine's [m]."""
        length = float(np.linalg.norm(np.subtract(*link_ends(self.machine, self.where))))
        return max(length, 0.05 * reach_of(self.machine))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Shift along the body's axes."""
        return tuple(Parameter.sized("xyz"[k], "m", self._length, -1.5, 1.5) for k in self._axes)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a tenth of the link's length along one axis after the other."""
        return tuple(tuple(row) for row in 0.1 * self._length * np.eye(len(self._axes)))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Shift the link's centre."""
        old = mjcf.inertial_of(self.machine, spec, self.where)
        centre = old.centre.copy()
        centre[list(self._axes)] += np.asarray(values, dtype=float)
        mjcf.set_inertial(self.machine, spec, self.where, replace(old, centre=centre))


_FAR_OFF = 0.3  # furthest centre of a payload from the tool, over the reach of the arm
_RADIUS = 0.01  # radius of gyration of the payload, in lengths of the machine
_LIGHT = 0.05
"""Light payload from which fits start, over the mass that the machine moves at a joint."""


class Payload(WeightedEffect):
    """Payload: a small body at the tool's site, or at the end of the last link.

    Its centre of mass lies there, or in the variant "centre" where the motion says.
    """

    kind = "payload"
    acts_on = "arm"
    variants = ("", "centre")
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0, 0.0, 0.0)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        if self.variant:
            self.proportional = 0  # type: ignore[misc]
        else:
            self.null_values = (0.0,)  # type: ignore[misc]

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return the tool."""
        return ("tool",)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Mass of the payload, and its centre from the tool in the frame of the tool's body."""
        far, starts = _FAR_OFF * reach_of(self.machine), (_LIGHT, 0.3)
        mass = Parameter.sized("mass", "kg", self._moved, 0, 20, scale=0.05, starts=starts)
        axes = "xyz" if self.variant else ""
        return (mass, *(Parameter.sized(name, "m", far, -1, 1) for name in axes))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a light and a heavy one at the tool, or a light one beside it on every side."""
        if not self.variant:
            return super().starts
        sides = (side for row in self._off * np.eye(3) for side in (-row, row))
        return tuple((_LIGHT * self._moved, *side.tolist()) for side in sides)

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """A mass at the tool, and beside it along each axis of each way in which it is mounted.

        Forces add up by mass and moment.
        """
        if not self.variant:
            return ()
        beside = self._off * np.eye(3 * max(len(self.mountings), 1) + 1)[:, 1:]
        return tuple((0.1 * self._moved, *row) for row in beside.tolist())

    @property
    def _moved(self) -> float:
        """Mass moved by the first joint, over the number of joints [kg]."""
        model = self.machine.model
        first = int(model.jnt_bodyid[0])
        return float(model.body_subtreemass[first]) / len(self.machine.joints)

    @property
    def _off(self) -> float:
        """Distance of a centre from the tool at which fits start [m]."""
        return 0.3 * _FAR_OFF * reach_of(self.machine)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add a body to the one that carries the tool."""
        mass, machine = float(values[0]), self.machine
        if mass <= 0:
            return
        centre = np.array(values[1:]) if self.variant else np.zeros(3)
        if machine.tool:
            carrier = spec.site(machine.tool).parent
            place = mjcf.site_pose(machine, spec.site(machine.tool))[0]
        else:
            name, place = _outermost(machine)
            carrier = spec.body(name)
        body = carrier.add_body(name=mjcf.added_name(spec, "tool", self.kind), pos=place)
        tensor = mass * (_RADIUS * reach_of(self.machine)) ** 2 * np.eye(3)
        mjcf.set_inertial(self.machine, spec, body.name, mjcf.Inertial(mass, centre, tensor))


class MountedPayload(Payload):
    """Payload that some runs lack, or that is turned between runs: one mass, a centre each way.

    A model has one of these ways, or none: that of most runs.
    """

    def __init__(
        self, machine: NominalModel, where: str, mountings: Mountings, runs: Sequence[str]
    ) -> None:
        super().__init__(machine, where, "centre")
        self.mountings, self.runs = mountings, tuple(runs)
        # each run has one of these ways or none; machines that change are one in ten
        self.choices = 10.0 * (len(mountings) + 1) ** len(runs)
        self.null_values = (0.0,) * len(self.parameters)  # type: ignore[misc]
        without = len(runs) - sum(map(len, mountings))
        most = max(mountings, key=len)
        self.usual = mountings.index(most) if len(most) > without else None
        self.in_model = self.usual is not None

    @property
    def key(self) -> tuple[str, str, str]:
        """Kind, location, variant and runs."""
        return self.kind, self.where, repr(self.mountings)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Mass, and its centre in each way in which it is mounted."""
        mass, *centre = super().parameters
        ways = ["", *(f"_{k}" for k in range(2, len(self.mountings) + 1))]
        return (mass, *(replace(p, name=p.name + way) for way in ways for p in centre))

    starts = Payload.axes

    def plain(self, values: Array, way: int) -> tuple[Payload, Array]:
        """The payload mounted in one way, with its values."""
        centre = values[1 + 3 * way : 4 + 3 * way]
        return Payload(self.machine, self.where, "centre"), np.array([values[0], *centre])

    def in_run(self, run: str, values: Array) -> tuple[Payload, Array] | None:
        """The payload of a run, if it has one; that of most in a run that was not compared."""
        own = (k for k, runs in enumerate(self.mountings) if run in runs)
        way = next(own, None) if run in self.runs else self.usual
        return None if way is None else self.plain(values, way)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the payload of most runs."""
        if self.usual is not None:
            payload, own = self.plain(values, self.usual)
            payload.edit(spec, own)


def payload_notes(machine: NominalModel) -> list[str]:
    """Describe the payload's location in a model without a tool site; else none."""
    model, tool = machine.model, machine.tool
    if tool:
        link = str(model.body(int(model.body_weldid[model.site(tool).bodyid[0]])).name)
        lacking = "the model has no site at the end of its last link: a payload is tried at "
        if tool == "tool" or link == machine.last_link:
            return []
        return [f'{lacking}{tool} of {link}; add <site name="tool"/> where it hangs']
    name, place = _outermost(machine)
    where = "the far end" if place.any() else "the origin"
    return [
        f"the model has no site at its tool: a payload is tried at {where} of {name}, and its mass "
        'stands for that place; add <site name="tool"/> where it hangs'
    ]


def _outermost(machine: NominalModel) -> tuple[str, Array]:
    """Body that represents the tool, with a position in its frame (3,) [m]."""
    model, last = machine.model, machine.model.body(machine.last_link).id
    fixed = [b for b in range(last + 1, model.nbody) if model.body_weldid[b] == last]
    if fixed:
        return str(model.body(fixed[-1]).name), np.zeros(3)
    return machine.last_link, link_ends(machine, machine.last_link)[1]


class BaseTilt(AdditiveEffect):
    """Base tilt: gravity rotated about horizontal axes, in the base frame.

    Two axes; one where the arm moves in a plane that contains gravity, since a small tilt out of
    that plane changes nothing. A tilt is named after the nearest world axis.
    """

    kind = "base_tilt"
    acts_on = "arm"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return the base, if there is gravity."""
        option, off = machine.model.opt, mujoco.mjtDisableBit.mjDSBL_GRAVITY
        return ("base",) if np.any(option.gravity) and not option.disableflags & off else ()

    @cached_property
    def _axes(self) -> Array:
        """Axes of tilt (K, 3)."""
        down = self.machine.model.opt.gravity / np.linalg.norm(self.machine.model.opt.gravity)
        normal = normal_of(self.machine)
        if normal is not None and abs(normal @ down) < 1e-6:
            return normal[None]
        # The two world axes farthest from gravity, made perpendicular to it and each other.
        first, second = np.eye(3)[np.sort(np.argsort(np.abs(down))[:2])]
        first = first - down * (first @ down)
        first /= np.linalg.norm(first)
        across = np.cross(down, first)
        return np.array([first, np.copysign(1.0, across @ second) * across])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Angle about each axis; fits start at two degrees about every one."""
        names = ("xyz"[int(np.argmax(np.abs(axis)))] for axis in self._axes)
        tilt = Parameter(name="", unit="rad", low=-0.8, high=0.8, scale=0.02, starts=(0.04,))
        return tuple(replace(tilt, name=f"tilt_{name}") for name in names)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Rotate gravity."""
        turn = Rotation.from_rotvec(values @ self._axes)
        # Gravity in the base frame rotates opposite to the base.
        spec.option.gravity = turn.inv().apply(np.array(spec.option.gravity))


_ALL = "all"


class GravityCompensation(LinkEffect):
    """Share of a link's weight that a balancer or the drives carry, beyond that of the model.

    At "all": of every link alike, as software compensates gravity. Negative where the model has a
    compensation that the machine lacks, or more of it than the machine has.
    """

    kind = "gravity_compensation"
    null_values = (0.0,)
    # a quarter, missing or too much, and all of it
    parameters = (Parameter.sized("share", "", 1.0, -1.5, 1.5, starts=(-0.25, 0.25, 1.0)),)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links that have mass, and "all" if there are several; none without gravity."""
        if not BaseTilt.locations(machine):
            return ()
        links = links_with_mass(machine)
        return (*links, _ALL) if len(links) > 1 and _ALL not in links else links

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the gravity compensation of the bodies."""
        links = links_with_mass(self.machine) if self.where == _ALL else (self.where,)
        for link in links:
            spec.body(link).gravcomp += float(values[0])
        if any(spec.body(link).gravcomp < 0 for link in links):
            # MuJoCo compensates no gravity at all unless some body has a positive share
            aside = spec.worldbody.add_body(name=mjcf.added_name(spec, self.where, self.kind))
            aside.gravcomp = 1.0
