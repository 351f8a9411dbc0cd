"""Link-flexibility effect: a link cut in two parts with a hinge, a spring and a damper."""

from __future__ import annotations

from functools import cached_property
from math import sqrt
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.joint_elasticity import (
    damping_ratio,
    stiffness_between,
    stiffness_starts,
)
from loose_env.gap.model.effects.link_inertia import links_with_mass
from loose_env.gap.model.effects.mjcf.extra_joint import add_extra_joint, joint_inertia
from loose_env.gap.model.effects.mjcf.geometry import frame_about, link_ends, normal_of, reach_of
from loose_env.gap.model.effects.mjcf.inertia import Inertial, inertial_of, set_inertial, steiner
from loose_env.gap.model.effects.mjcf.joint_effect import added_name
from loose_env.gap.model.effects.mjcf.split_body import (
    keep_from_touching,
    move_children,
    move_geoms,
    move_sites,
)
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_SHORTEST = 0.03
"""Shortest link that can bend, in lengths of the machine."""
_ALONG = 0.1
"""Sine of the smallest angle between joint and link at which the joint's axis is one of bending."""
_MIDDLE, _SCATTER, _NEAREST = 0.5, 0.1, 0.25
"""Where along it a link gives way: mean, standard deviation, and nearest to its joint, as shares of
its length."""


class LinkFlexibility(Effect):
    """A flexible link: two parts with a hinge, a spring and a damper between them.

    The near part keeps the body's name and its joint; the far part, a body of its own, carries
    everything beyond the hinge: bodies, sites, geoms. Mass, centre and inertia of the straight link
    stay. The location of the hinge along the link is fitted too, since the stiffness depends on it.
    Variant "": it bends about its joint's axis, in a machine that moves in a plane within that
    plane; variant "across": about the axis perpendicular to that and the link.
    """

    kind = "link_flexibility"
    acts_on: ClassVar[str] = "link"
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("stiffness", "high"),)
    adds_motion: ClassVar[bool] = True
    needs_fine_steps: ClassVar[bool] = True
    variants: ClassVar[tuple[str, ...]] = ("", "across")

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links with mass that are not too short."""
        shortest = _SHORTEST * reach_of(machine)
        lengths = {
            link: float(np.linalg.norm(np.subtract(*link_ends(machine, link))))
            for link in links_with_mass(machine)
        }
        return tuple(link for link, length in lengths.items() if length > shortest)

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return both variants in space, one in a plane."""
        return cls.variants if normal_of(machine) is None else cls.variants[:1]

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        start, end = link_ends(machine, where)
        self._start, self._length = start, float(np.linalg.norm(end - start))
        self._along = (end - start) / self._length
        normal = normal_of(machine)
        if normal is not None:
            data = mujoco.MjData(machine.model)
            mujoco.mj_kinematics(machine.model, data)
            axis = data.body(where).xmat.reshape(3, 3).T @ normal
        else:
            axis = machine.model.jnt_axis[machine.joint_number(machine.first_joint(where))]
        axis = axis - self._along * (axis @ self._along)
        if np.linalg.norm(axis) < _ALONG:
            axis = frame_about(self._along)[1]
        axis = axis / np.linalg.norm(axis)
        self._axis = np.cross(self._along, axis) if self.variant else axis

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness, damping ratio with the near part locked, and location of the hinge."""
        carried, weight = self._hinge_inertia
        step = self.machine.time_step
        place = Parameter(
            name="position", unit="", low=_NEAREST, high=1 - _NEAREST, scale=_SCATTER,
            centre=_MIDDLE, spread=1.0,
        )  # fmt: skip
        return (stiffness_between(carried, weight, step, "N·m/rad"), damping_ratio(), place)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: modes from slow to fast."""
        springs = stiffness_starts(self._hinge_inertia[0], self.parameters[0])
        return tuple((*spring, _MIDDLE) for spring in springs)

    @property
    def uncertain_mass(self) -> float:
        """Mass of the link: no real link is a uniform bar that bends at one location."""
        return float(self.machine.model.body(self.where).mass[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Cut the link and insert the spring."""
        stiffness, ratio, place = (float(v) for v in values)
        damping = 2 * ratio * sqrt(stiffness * self._hinge_inertia[0])
        self._cut(spec, stiffness, damping, place)

    def _cut(self, spec: mujoco.MjSpec, stiffness: float, damping: float, share: float) -> str:
        """Cut the link; return the name of the far part and of its hinge."""
        kind = f"{self.kind}_{self.variant}" if self.variant else self.kind
        name = added_name(spec, self.where, kind)
        whole = inertial_of(self.machine, spec, self.where)
        start, end = self._start, self._start + self._length * self._along
        near, far = parts(whole, start, end, share)
        old, here = spec.body(self.where), start + share * (end - start)
        new = old.add_body(name=name, pos=here)
        move_children(self.machine, spec, old, new, self._along)
        move_sites(self.machine, spec, old, new, self._along)
        move_geoms(spec, old, new, self._along)
        set_inertial(self.machine, spec, self.where, near)
        place = far.centre - here
        set_inertial(self.machine, spec, name, Inertial(far.mass, place, far.tensor))
        add_extra_joint(
            new,
            name,
            turns=True,
            axis=self._axis,
            pos=np.zeros(3),
            stiffness=stiffness,
            damping=damping,
        )
        keep_from_touching(spec, old, new)
        return name

    @cached_property
    def _hinge_inertia(self) -> tuple[float, float]:
        """Inertia on the hinge [kg·m²], and its inverse weight with all joints free."""
        spec = self.machine.fresh()
        name = self._cut(spec, 0.0, 0.0, _MIDDLE)
        return joint_inertia(spec, name)


def parts(
    whole: Inertial, start: Array, end: Array, share: float = _MIDDLE
) -> tuple[Inertial, Inertial]:
    """Split a body into two that together have the same mass, centre and inertia.

    They are the pieces of a bar whose mass per length rises or falls linearly, so that its centre
    lies where the link's does. Their centres are as far apart as those pieces' are, or less where
    the link's inertia does not allow that.

    Examples
    --------
    A uniform bar of one metre, cut in the middle:

    >>> bar = Inertial(12.0, np.array([0.5, 0.0, 0.0]), np.diag([0.1, 1.05, 1.05]))
    >>> near, far = parts(bar, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    >>> near.mass, near.centre.tolist(), np.diag(near.tensor).round(3).tolist()
    (6.0, [0.25, 0.0, 0.0], [0.05, 0.15, 0.15])
    """
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    mass, apart, spread = _cut_bar(float((whole.centre - start) @ along) / length, share)
    lever = apart * length * along
    reduced = mass * (1 - mass) * whole.mass
    left = whole.tensor - steiner(reduced, lever)
    while not _solid(left):
        lever = 0.9 * lever
        if np.linalg.norm(lever) < 1e-6 * length:
            lever = np.zeros(3)
        left = whole.tensor - steiner(reduced, lever)
        if not lever.any():
            break
    near = _piece(left, along, mass, spread)
    if not (_solid(near) and _solid(left - near)):
        near = mass * left
    return (
        Inertial(mass * whole.mass, whole.centre - (1 - mass) * lever, near),
        Inertial((1 - mass) * whole.mass, whole.centre + mass * lever, left - near),
    )


def _cut_bar(centre: float, share: float) -> tuple[float, float, float]:
    """Cut a bar of unit length and mass.

    Its mass per length is 1 + fall (1 - 2 x), nowhere below zero.
    """
    fall = float(np.clip(6 * (0.5 - centre), -1.0, 1.0))
    near, whole = (
        np.array(
            [
                x + fall * (x - x**2),
                x**2 / 2 + fall * (x**2 / 2 - 2 * x**3 / 3),
                x**3 / 3 + fall * (x**3 / 3 - x**4 / 2),
            ]
        )
        for x in (share, 1.0)
    )
    far = whole - near
    own = [float(m[2] - m[1] ** 2 / m[0]) for m in (near, far)]
    return float(near[0]), float(far[1] / far[0] - near[1] / near[0]), own[0] / sum(own)


def _piece(tensor: Array, along: Array, mass: float, spread: float) -> Array:
    """Inertia (3, 3) of one of two pieces of a bar, from their joint inertia.

    It has its share of the mass spread lengthwise, and of that across in proportion to its mass.
    """
    moments = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    lengthwise = np.outer(along, along)
    scale = np.sqrt(mass) * (np.eye(3) - lengthwise) + np.sqrt(spread) * lengthwise
    own = scale @ moments @ scale
    return np.asarray(np.trace(own) * np.eye(3) - own)


def _solid(tensor: Array) -> bool:
    """Return whether an inertia (3, 3) is physically possible."""
    low, middle, high = np.linalg.eigvalsh(tensor)
    return bool(low > 1e-3 * high and high < (low + middle) * (1 - 1e-9))
