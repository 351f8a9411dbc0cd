"""Effects that add a degree of freedom: springs, play and looseness in joints, links and base."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import pi, sqrt

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect, JointEffect, Parameter
from loose_env.gap.model.effects import mjcf
from loose_env.gap.model.effects.inertia import LinkEffect, links_with_mass
from loose_env.gap.model.nominal_model import (
    NominalModel,
    frame_about,
    link_ends,
    named,
    normal_of,
    reach_of,
)
from loose_env.typing import Array

_SLOWEST_HZ = 0.3  # mode of the softest spring that is tried
_START_HZ = (4.0, 12.0, 35.0)  # modes of the springs from which fits start
_LIKELY_DAMPING = 0.05  # damping ratio of a metal drive
_START_DAMPING = 0.4
"""Damping ratio from which fits start: a lightly damped mode rings, and what it rings agrees with
a measurement only within some per cent of the true frequency; a damped one is led there."""
_MOST_JOINTS = 6  # joints of a body


class AddedJoint(Effect):
    """An effect that adds a joint to the model."""

    adds_motion = True

    @property
    def unit(self) -> str:
        """Unit of a stiffness at the joint."""
        return "N·m/rad"

    @property
    def _name(self) -> str:
        """Kind and variant."""
        return f"{self.kind}_{self.variant}" if self.variant else self.kind

    def _insert(self, spec: mujoco.MjSpec, *spring: float) -> mujoco.MjsJoint:
        """Add the joint with a stiffness, a damping and what shapes it; return it."""
        raise NotImplementedError

    @cached_property
    def inertia(self) -> tuple[float, float]:
        """Inertia on the joint [kg·m²] or mass [kg], and its inverse weight with all free."""
        spec = self.machine.fresh()
        return mjcf.joint_inertia(spec, self._insert(spec, 0.0, 0.0).name)


class SpringEffect(AddedJoint):
    """An effect with a joint on a spring and a damper; the limit of a stiff spring is rigid."""

    limit = (("stiffness", "high"),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness, up to the largest stable one, and damping ratio with all else locked."""
        carried, weight = self.inertia
        low = carried * (2 * pi * _SLOWEST_HZ) ** 2
        high = max((mjcf.FASTEST / self.machine.time_step) ** 2 / weight, 10 * low)
        stiffness = Parameter(
            name="stiffness", unit=self.unit, low=low, high=high, scale=sqrt(low * high), log=True
        )
        wanted = (carried * (2 * pi * hz) ** 2 for hz in _START_HZ)
        starts = tuple(dict.fromkeys(stiffness.clipped(min(k, 0.5 * high)) for k in wanted))
        ratio = _ratio(1e-3, 2.0, _LIKELY_DAMPING, _START_DAMPING)
        return replace(stiffness, starts=starts), ratio

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the joint with its spring and damper."""
        stiffness, ratio, *shape = (float(v) for v in values)
        self._insert(spec, stiffness, 2 * ratio * sqrt(stiffness * self.inertia[0]), *shape)


class SplitJoint(JointEffect, AddedJoint):
    """A joint with a compliant drive: an extra joint on the same axis behind it.

    The joint itself is the motor side: its sensors, servo, friction and rotor stay with it. A joint
    without rotor gets one of a fiftieth of the inertia it carries, or the inertia its servo needs
    for a stable simulation.
    """

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return joints that are the last of their body."""
        last = dict(zip(machine.model.jnt_bodyid.tolist(), machine.joints, strict=True))
        return tuple(joint for joint in machine.joints if joint in last.values())

    def _insert(self, spec: mujoco.MjSpec, *spring: float) -> mujoco.MjsJoint:
        """Add the link side; return its joint."""
        machine, number = self.machine, self.number
        mjcf.keep_motor_side(machine, spec, self.where, self.carried)
        return mjcf.add_extra_joint(
            spec.body(machine.body_of(self.where)), mjcf.added_name(spec, self.where, self.kind),
            turns=self.turns, axis=machine.model.jnt_axis[number],
            pos=machine.model.jnt_pos[number], stiffness=spring[0], damping=spring[1],
        )  # fmt: skip

    @cached_property
    def inertia(self) -> tuple[float, float]:
        """Inertia behind the joint [kg·m² or kg], and its inverse weight with all others free."""
        return self.carried, super().inertia[1]

    @property
    def unit(self) -> str:
        """Torque per angle, or force per way."""
        return f"{self.torque_unit}/{self.angle_unit}"


class JointCompliance(SplitJoint, SpringEffect):
    """Joint compliance: spring and damper, the damping ratio with the motor locked."""

    kind = "joint_compliance"


_DRAG_RATE = 2.0  # how fast oil stops a link that floats in the gap [1/s]
_FASTEST = 1.2
"""Largest angle by which a mode on a stop may turn in a step, at the model's zero [rad]: more than
that of an added spring, since a stop is damped."""
_LEAST_LOAD = 0.05  # least usual load of a joint, as a share of that of the most loaded one
_STARTS = (0.02, 0.06, 0.15, 0.3, 0.7, 3.0)
"""Gaps from which fits start, as shares of a hundredth of a radian or of the reach."""
_TRAVEL_S = 0.5  # time in which a slide travels a typical distance at its typical speed [s]
_SOFTER = (1.0, 0.3, 0.1)
"""Stiffnesses of stops from which fits start, over the usual one: on soft stops a wrong gap or
friction is told from none, and a fit finds the right ones from further off."""
_DAMPING = 0.3  # damping ratio of a mode on a stop


class Backlash(SplitJoint):
    """Backlash: an extra joint between stops, which are spring-dampers."""

    kind = "backlash"
    has_stops = True
    limit = (("gap", "low"), ("stiffness", "high"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Clearance, stiffness of the stops, and damping ratio on them."""
        # a lone slide has no reach, but it travels
        length = 1.0 if self.turns else max(reach_of(self.machine), _TRAVEL_S * self.speed)
        gap = Parameter.sized(
            "gap", self.angle_unit, 0.01 * length, 1e-3, 50, scale=1, starts=_STARTS, log=True
        )
        return (gap, *_stops(self.inertia[1], self.machine.time_step, self.unit))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: clearances of 0.01° to 2°; a wrong one fits no better than none."""
        starts = super().starts
        return tuple((gap, soft * k, ratio) for soft in _SOFTER for gap, k, ratio in starts)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the clearance behind the joint."""
        joint = self._insert(spec, 0.0, _DRAG_RATE * self.carried)
        # a small load is raised to that of slight shaking
        load = max(self.load, _LEAST_LOAD * float(np.max(self.machine.load_scales)))
        mjcf.set_stops(joint, *map(float, values), weight=self.inertia[1], load=load)


def _stops(weight: float, step: float, unit: str) -> tuple[Parameter, Parameter]:
    """Stiffness of stops, about a quarter of the largest stable one at the step [s]; damping."""
    high = (_FASTEST / step) ** 2 / weight
    return (
        Parameter.sized("stiffness", unit, high, 1e-3, 1, scale=0.25, starts=(0.25,), log=True),
        _ratio(0.02, 1.0, _DAMPING, _DAMPING),
    )


def _ratio(low: float, high: float, scale: float, start: float) -> Parameter:
    """Damping ratio of a mode."""
    return Parameter.sized("damping_ratio", "", 1, low, high, scale=scale, starts=[start], log=True)


_SAME = 0.999  # cosine between two axes from which they are parallel
_APART = 0.02  # distance of parallel axes that makes them two, in lengths of the machine


class BaseCompliance(SpringEffect):
    """Base compliance: the base rocks on a spring and a damper about one axis of the world.

    The hinge passes through the foot of the base: the origin of the body that is fixed to the
    world, or of the world itself. Its axis is the variant; in a machine that moves in a plane only
    the one across it is tried. About the axis of the first joint itself a base yields as that
    joint does: such a variant is left out.
    """

    kind = "base_compliance"
    acts_on = "arm"
    variants = ("x", "y", "z")

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return the base, if its first link has room for another joint and is not the only one."""
        # under a single joint it is not told from a compliant drive
        first = int(machine.model.jnt_bodyid[0])
        room = machine.model.body_jntnum[first] < _MOST_JOINTS and len(machine.joints) > 1
        return ("base",) if room and cls.variants_at(machine, "base") else ()

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return all axes in space, one in a plane, without that of the first joint."""
        normal, data = normal_of(machine), machine.at_zero
        axes = cls.variants if normal is None else (cls.variants[int(np.argmax(np.abs(normal)))],)
        if machine.model.jnt_type[0] != mujoco.mjtJoint.mjJNT_HINGE:
            return axes
        away = data.xanchor[0] - _foot(machine)
        along = np.array([_axis(machine, axis) for axis in axes])
        apart = np.linalg.norm(away - along * (along @ away)[:, None], axis=1)
        parallel = np.abs(along @ data.xaxis[0]) > _SAME
        return named(axes, ~parallel | (apart > _APART * reach_of(machine)))

    def _insert(self, spec: mujoco.MjSpec, *spring: float) -> mujoco.MjsJoint:
        """Insert the hinge before the first joint."""
        model, data = self.machine.model, self.machine.at_zero
        first = int(model.jnt_bodyid[0])
        turn = data.xmat[first].reshape(3, 3)
        body = spec.body(model.body(first).name)
        hinge = mjcf.add_extra_joint(
            body, mjcf.added_name(spec, "base", self._name), turns=True,
            axis=turn.T @ _axis(self.machine, self.variant),
            pos=turn.T @ (_foot(self.machine) - data.xpos[first]), stiffness=spring[0],
            damping=spring[1],
        )  # fmt: skip
        mjcf.insert_first(spec, body, hinge.name)
        return hinge


def _foot(machine: NominalModel) -> Array:
    """Foot of the base (3,) in the world [m]: of what is fixed to it, or the world's origin."""
    first = int(machine.model.jnt_bodyid[0])
    foot = int(machine.model.body_rootid[first])
    return np.array(machine.at_zero.xpos[foot]) if foot != first else np.zeros(3)


def _axis(machine: NominalModel, variant: str) -> Array:
    """Axis of a variant (3,) in the world: exactly across the plane of a planar machine."""
    normal = normal_of(machine)
    return np.eye(3)["xyz".index(variant)] if normal is None else normal


class _MovedLink(LinkEffect, AddedJoint):
    """A link with one more joint behind its own."""

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links with room for another joint, and two more in a corrected model."""
        most, model = _MOST_JOINTS - 3, machine.model
        return tuple(n for n in machine.links if model.body(n).jntnum[0] <= most)

    def keep_driven_side(self, spec: mujoco.MjSpec, *, turns: bool) -> None:
        """Keep inertia on the drive's side of joints whose motion may be like the added one's."""
        machine = self.machine
        body = machine.model.body(self.where).id
        alike = (machine.model.jnt_bodyid == body) & (machine.hinges == turns)
        for k in np.flatnonzero(alike):
            mjcf.keep_motor_side(machine, spec, machine.joints[k], float(machine.inertias[k]))


_GRAVITY = 9.81  # usual load of a seat, over the mass on it [m/s²]
_GAPS = (1e-4, 6e-4)  # gaps of a seat from which fits start, as shares of the reach


class StructuralLooseness(_MovedLink):
    """Structural looseness: a slide behind the link's joint, with stops and friction.

    Its direction is fixed in the link. In a machine that moves in a plane it lies in that plane, at
    ``angle`` from the body's axis nearest to it; in space ``azimuth`` counts about the body's z
    axis from its x axis, and ``elevation`` from the plane of both.
    """

    kind = "structural_looseness"
    limit = (("friction", "high"),)
    has_stops = True

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        normal = normal_of(machine)
        self._plane = None if normal is None else frame_about(self.in_link(normal))[1:]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Direction, clearance, friction, stiffness of the stops, damping ratio on them."""
        names = ("angle",) if self._plane is not None else ("azimuth", "elevation")
        length, force, turn = reach_of(self.machine), 1.0 / self._mean_weight, 2 * pi
        return (
            *(Parameter(name=n, unit="rad", low=-turn, high=turn, scale=0.5) for n in names),
            Parameter.sized("gap", "m", length, 1e-5, 0.05, scale=1e-3, log=True),
            Parameter.sized("friction", "N", force, 1e-3, 100, scale=1.0, log=True),
            *_stops(self._mean_weight, self.machine.time_step, "N/m"),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: directions all round, a small and a larger clearance, little friction."""
        length = reach_of(self.machine)
        friction, stiffness, ratio = (p.scale for p in self.parameters[-3:])
        rests = [(share * length, 0.3 * friction, stiffness, ratio) for share in _GAPS]
        if self._plane is not None:
            return tuple((turn, *rest) for rest in rests for turn in (0.0, pi / 3, 2 * pi / 3))
        tilt = 0.55  # of the six axes of an icosahedron, one of them moved to z
        axes = (*((2 * pi * k / 5, tilt) for k in range(5)), (0.0, pi / 2))
        return tuple((*axis, *rest) for rest in rests for axis in axes)

    def direction(self, values: Array) -> Array:
        """Unit vector (3,) of the slide, in the body's frame."""
        if self._plane is not None:
            return np.asarray(np.array([np.cos(values[0]), np.sin(values[0])]) @ self._plane)
        azimuth, up = values[:2]
        flat = np.cos(up)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(up)])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the slide behind the link's joints."""
        direction = self.direction(values)
        gap, friction, stiffness, ratio = (float(v) for v in values[-4:])
        joint = self._slide(spec, direction, friction)
        mjcf.make_it_stick(joint, spec.option.timestep)
        weight = self._weight(direction)
        stiffness *= self._mean_weight / weight  # the same contact mode in every direction
        mjcf.set_stops(joint, gap, stiffness, ratio, weight=weight, load=_GRAVITY / weight)

    def _slide(
        self, spec: mujoco.MjSpec, direction: Array, friction: float = 0.0
    ) -> mujoco.MjsJoint:
        """Add the slide, and keep inertia on the drive's side of others, which may lie along it."""
        self.keep_driven_side(spec, turns=False)
        return mjcf.add_extra_joint(
            spec.body(self.where), mjcf.added_name(spec, self.where, self.kind), turns=False,
            axis=direction, pos=np.zeros(3), friction=friction,
        )  # fmt: skip

    def _weight(self, direction: Array) -> float:
        """Inverse of the mass on the slide [1/kg], all joints free."""
        spec = self.machine.fresh()
        return mjcf.joint_inertia(spec, self._slide(spec, direction).name)[1]

    @cached_property
    def _mean_weight(self) -> float:
        axes = np.eye(3) if self._plane is None else self._plane
        return float(np.exp(np.mean([np.log(self._weight(axis)) for axis in axes])))


_SHORTEST = 0.03  # shortest link that can bend, in lengths of the machine
_ALONG = 0.1
"""Sine of the smallest angle between joint and link at which the joint's axis is one of bending."""
_PIVOTS, _MIDDLE, _SCATTER = (0.1, 0.6), 0.3, 0.1
"""Where along it a link gives way: range, mean and scatter, as shares of its length."""


class LinkFlexibility(_MovedLink, SpringEffect):
    """A flexible link: it turns on a spring and a damper about a pivot along it.

    The pseudo-rigid-body model of a cantilever, whose pivot lies at 0.15 of its length under a load
    at its end, and further out as the load turns it. The location of the pivot is fitted too, since
    the stiffness depends on it. Variant "": it bends about its joint's axis, in a machine that
    moves in a plane within that plane; variant "across": about the axis perpendicular to that and
    the link.

    References
    ----------
    Howell, Compliant Mechanisms (2001), chapter 5.
    """

    kind = "link_flexibility"
    variants = ("", "across")

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links with mass and room for another joint that are not too short."""
        shortest, heavy = _SHORTEST * reach_of(machine), links_with_mass(machine)
        there = [link for link in super().locations(machine) if link in heavy]
        lengths = [np.linalg.norm(np.subtract(*link_ends(machine, link))) for link in there]
        return named(there, np.array(lengths) > shortest)

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return both variants in space, one in a plane."""
        return cls.variants if normal_of(machine) is None else cls.variants[:1]

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        self._start, end = link_ends(machine, where)
        self._way = end - self._start
        along, normal = self._way / float(np.linalg.norm(self._way)), normal_of(machine)
        own = machine.model.jnt_axis[int(machine.model.body(where).jntadr[0])]
        axis = own if normal is None else self.in_link(normal)
        axis = axis - along * (axis @ along)
        if np.linalg.norm(axis) < _ALONG:
            axis = frame_about(along)[1]
        axis = axis / np.linalg.norm(axis)
        self._axis = np.cross(along, axis) if self.variant else axis

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness, damping ratio with the joint locked, and location of the pivot."""
        low, high = _PIVOTS
        place = Parameter.sized("position", "", 1, low, high, scale=_SCATTER, starts=[_MIDDLE])
        return (*super().parameters, place)

    def _insert(self, spec: mujoco.MjSpec, *spring: float) -> mujoco.MjsJoint:
        """Add the pivot behind the link's joints, at a share of its length."""
        stiffness, damping, share = spring if len(spring) > 2 else (*spring, _MIDDLE)
        self.keep_driven_side(spec, turns=True)
        return mjcf.add_extra_joint(
            spec.body(self.where), mjcf.added_name(spec, self.where, self._name), turns=True,
            axis=self._axis, pos=self._start + share * self._way,
            stiffness=stiffness, damping=damping,
        )  # fmt: skip
