"""Effects of elasticity: compliant joint, spring across a joint, and compliant base.

A compliant drive is a spring and a damper between motor side and link side of a joint. Springs
across a joint are cables, hoses, balancers. A base on rubber feet, or not bolted down, rocks.
"""

from __future__ import annotations

from functools import cached_property
from math import pi, sqrt
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.extra_joint import (
    FASTEST,
    add_extra_joint,
    joint_inertia,
    keep_motor_side,
    last_joints,
)
from loose_env.gap.model.effects.mjcf.geometry import normal_of, reach_of
from loose_env.gap.model.effects.mjcf.joint_effect import (
    JointEffect,
    added_name,
    angle_unit,
    fitted_rate,
)
from loose_env.gap.model.effects.mjcf.split_body import insert_first
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_SLOWEST_HZ = 0.3
"""Mode of the softest spring that is tried."""
_START_HZ = (4.0, 12.0, 35.0)
"""Modes of the springs from which fits start."""
_LIKELY_DAMPING = 0.05
"""Damping ratio of a metal drive, give or take a factor of four."""
_START_DAMPING = 0.4
"""Damping ratio from which fits start: a lightly damped mode rings, and what it rings agrees with
a measurement only within some per cent of the true frequency; a damped one is led there."""


class SplitJoint(JointEffect):
    """A joint with a compliant drive: an extra joint on the same axis behind it.

    The joint itself is the motor side: its sensors, servo, friction and rotor stay with it. A joint
    without rotor gets one of a fiftieth of the inertia it carries, or the inertia its servo needs
    for a stable simulation.
    """

    adds_motion = True
    needs_fine_steps = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return joints that are the last of their body."""
        return last_joints(machine)

    def _split(
        self, spec: mujoco.MjSpec, *, stiffness: float = 0.0, damping: float = 0.0
    ) -> mujoco.MjsJoint:
        """Add the link side; return its joint."""
        number = self.machine.joint_number(self.where)
        keep_motor_side(self.machine, spec, self.where, self.carried)
        return add_extra_joint(
            spec.body(self.machine.body_of(self.where)),
            added_name(spec, self.where, self.kind),
            turns=self.machine.turns(self.where),
            axis=self.machine.model.jnt_axis[number],
            pos=self.machine.model.jnt_pos[number],
            stiffness=stiffness,
            damping=damping,
        )

    @cached_property
    def weight(self) -> float:
        """Inverse of the inertia on the link side [1/(kg·m²) or 1/kg], all others free."""
        spec = self.machine.fresh()
        name = self._split(spec).name
        model = spec.compile()
        return float(model.dof_invweight0[model.joint(name).dofadr[0]])


class JointCompliance(SplitJoint):
    """Joint compliance: spring and damper; the limit of a stiff spring is rigid."""

    kind = "joint_compliance"
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("stiffness", "high"),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness, and the damping ratio of the link on the spring, motor locked."""
        unit = f"{self.torque_unit}/{self.angle_unit}"
        return (
            stiffness_between(self.carried, self.weight, self.machine.time_step, unit),
            damping_ratio(),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: modes of a compliant, a medium and a stiff drive."""
        return stiffness_starts(self.carried, self.parameters[0])

    def propose_stiffness(self, stiffness: float) -> tuple[tuple[float, ...], ...]:
        """Start there with a likely damping, beside the other starts."""
        return ((self.parameters[0].clipped(stiffness), _LIKELY_DAMPING), *self.inverse_starts)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the spring behind the joint."""
        stiffness, ratio = float(values[0]), float(values[1])
        self._split(spec, stiffness=stiffness, damping=2 * ratio * sqrt(stiffness * self.carried))


def stiffness_between(carried: float, weight: float, step: float, unit: str) -> Parameter:
    """Stiffness of an added spring, up to the largest stable at the step [s]."""
    low = carried * (2 * pi * _SLOWEST_HZ) ** 2
    high = max((FASTEST / step) ** 2 / weight, 10 * low)
    return Parameter(
        name="stiffness", unit=unit, low=low, high=high, scale=sqrt(low * high), log=True
    )


def damping_ratio() -> Parameter:
    """Damping ratio of an added spring: a nuisance, with a prior of 0.05 within 4x."""
    return Parameter(
        name="damping_ratio", unit="", low=1e-3, high=2.0, scale=_LIKELY_DAMPING, log=True,
        centre=_LIKELY_DAMPING, spread=1.4,
    )  # fmt: skip


def stiffness_starts(carried: float, stiffness: Parameter) -> tuple[tuple[float, float], ...]:
    """Springs with modes from slow to fast, at most half the largest stiffness."""
    wanted = (carried * (2 * pi * hz) ** 2 for hz in _START_HZ)
    kept = dict.fromkeys(stiffness.clipped(min(k, 0.5 * stiffness.high)) for k in wanted)
    return tuple((k, _START_DAMPING) for k in kept)


class JointSpring(JointEffect):
    """Joint spring -k (q - q0), combined exactly with the joint's existing spring."""

    kind = "joint_spring"
    proportional: ClassVar[int | None] = 0
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return joints without a nonlinear spring."""
        bent = np.any(machine.model.jnt_stiffnesspoly != 0, axis=1)
        return tuple(name for name, b in zip(machine.joints, bent, strict=True) if not b)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness and equilibrium coordinate of the spring."""
        low, high = self._range
        width = high - low
        return (
            Parameter(
                name="stiffness",
                unit=f"{self.torque_unit}/{self.angle_unit}",
                low=0.0,
                high=50 * self.load / min(width, pi),
                scale=0.2 * self.load / min(width, pi),
            ),
            Parameter(
                name="reference",
                unit=self.angle_unit,
                low=low - 2 * width,
                high=high + 2 * width,
                scale=0.2 * width,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a third of the typical torque over the range, equilibrium in its middle."""
        low, high = self._range
        width = high - low
        stiffness = 0.5 * self.load / min(width, pi)
        middle = 0.5 * (low + high)
        return (
            (stiffness, middle),
            (stiffness, low - 0.2 * width),
            (stiffness, high + 0.2 * width),
        )

    @property
    def _range(self) -> tuple[float, float]:
        """Range of the joint [rad or m], or half a turn about its zero."""
        number = self.machine.joint_number(self.where)
        if self.machine.model.jnt_limited[number]:
            low, high = self.machine.model.jnt_range[number]
            return float(low), float(high)
        half = pi / 2 if self.machine.turns(self.where) else 0.5
        return -half, half

    def interval_includes_null(self, low: Array, high: Array) -> bool:
        """Return whether the stiffness interval includes zero."""
        return bool(low[0] <= 0 <= high[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Set the joint's stiffness and spring reference to those of both springs."""
        added, rest = float(values[0]), float(values[1])
        if added == 0:
            return
        joint = spec.joint(self.where)
        unit = angle_unit(joint)
        stiffness = np.array(joint.stiffness)
        both = stiffness[0] + added
        rests = (stiffness[0] * joint.springref * unit + added * rest) / both
        stiffness[0] = both
        joint.stiffness, joint.springref = stiffness, rests / unit

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on angle; its zero is the equilibrium."""
        stiffness, reference = self.parameters
        rate = fitted_rate(angle, torque)
        if rate <= 0:
            return ()
        rests = float(np.nanmean(angle) - np.nanmean(torque) / rate)
        return ((stiffness.clipped(rate), reference.clipped(rests)),)


_SAME = 0.999
"""Cosine between two axes from which they are parallel."""
_APART = 0.02
"""Distance of parallel axes that makes them two, in lengths of the machine."""
_MOST_JOINTS = 5
"""Joints of the first link beside which there is room for another: a body has six at most."""


class BaseCompliance(Effect):
    """Base compliance: the base rocks on a spring and a damper about one axis of the world.

    The hinge passes through the foot of the base: the origin of the body that is fixed to the
    world, or of the world itself. Its axis is the variant; in a machine that moves in a plane only
    the one across it is tried. About the axis of the first joint itself a base yields as that
    joint does: such a variant is left out.
    """

    kind = "base_compliance"
    acts_on: ClassVar[str] = "arm"
    adds_motion: ClassVar[bool] = True
    needs_fine_steps: ClassVar[bool] = True
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("stiffness", "high"),)
    variants: ClassVar[tuple[str, ...]] = ("x", "y", "z")

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return the base, if its first link has room for another joint and is not the only one.

        Under a single joint a base that gives way is not told from a compliant drive.
        """
        first = int(machine.model.jnt_bodyid[0])
        room = machine.model.body_jntnum[first] <= _MOST_JOINTS and len(machine.joints) > 1
        return ("base",) if room and cls._axes(machine) else ()

    @classmethod
    def variants_at(cls, machine: NominalModel, where: str) -> tuple[str, ...]:
        """Return all axes in space, one in a plane, without that of the first joint."""
        return cls._axes(machine)

    @classmethod
    def _axes(cls, machine: NominalModel) -> tuple[str, ...]:
        normal = normal_of(machine)
        axes = cls.variants if normal is None else (cls.variants[int(np.argmax(np.abs(normal)))],)
        data = mujoco.MjData(machine.model)
        mujoco.mj_kinematics(machine.model, data)
        if machine.model.jnt_type[0] != mujoco.mjtJoint.mjJNT_HINGE:
            return axes
        away = data.xanchor[0] - _foot(machine, data)
        kept = []
        for axis in axes:
            along = _axis(machine, axis)
            parallel = abs(along @ data.xaxis[0]) > _SAME
            apart = float(np.linalg.norm(away - along * (away @ along)))
            if not parallel or apart > _APART * reach_of(machine):
                kept.append(axis)
        return tuple(kept)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness, and the damping ratio of the arm on it with its joints locked."""
        carried, weight = self._hinge_inertia
        step = self.machine.time_step
        return (stiffness_between(carried, weight, step, "N·m/rad"), damping_ratio())

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: modes from slow to fast."""
        return stiffness_starts(self._hinge_inertia[0], self.parameters[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Insert the hinge before the first joint."""
        stiffness, ratio = float(values[0]), float(values[1])
        self._rock(spec, stiffness, 2 * ratio * sqrt(stiffness * self._hinge_inertia[0]))

    def _rock(self, spec: mujoco.MjSpec, stiffness: float, damping: float) -> str:
        """Insert the hinge; return its name."""
        model = self.machine.model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        first, pivot = int(model.jnt_bodyid[0]), _foot(self.machine, data)
        turn = data.xmat[first].reshape(3, 3)
        name = added_name(spec, "base", f"{self.kind}_{self.variant}")
        body = spec.body(model.body(first).name)
        add_extra_joint(
            body,
            name,
            turns=True,
            axis=turn.T @ _axis(self.machine, self.variant),
            pos=turn.T @ (pivot - data.xpos[first]),
            stiffness=stiffness,
            damping=damping,
        )
        insert_first(spec, body, name)
        return name

    @cached_property
    def _hinge_inertia(self) -> tuple[float, float]:
        """Inertia on the hinge [kg·m²], and its inverse weight with all joints free."""
        spec = self.machine.fresh()
        name = self._rock(spec, 0.0, 0.0)
        return joint_inertia(spec, name)


def _foot(machine: NominalModel, data: mujoco.MjData) -> Array:
    """Foot of the base (3,) in the world [m]: of what is fixed to it, or the world's origin."""
    first = int(machine.model.jnt_bodyid[0])
    foot = int(machine.model.body_rootid[first])
    return np.array(data.xpos[foot]) if foot != first else np.zeros(3)


def _axis(machine: NominalModel, variant: str) -> Array:
    """Axis of a variant (3,) in the world: exactly across the plane of a planar machine."""
    normal = normal_of(machine)
    return np.eye(3)["xyz".index(variant)] if normal is None else normal
