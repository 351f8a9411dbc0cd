"""Effects at a joint: frictions, drag, rotor inertia, torque ripple (cogging), and springs."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, hypot, pi
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lombscargle

from loose_env.gap.model.effect import DrivenEffect, JointEffect, Parameter, WeightedEffect
from loose_env.gap.model.effects import mjcf
from loose_env.gap.model.nominal_model import NominalModel, named
from loose_env.typing import Array


class _Resistance(JointEffect):
    """A force against the motion by a power of the speed, added to that of the model."""

    null_values = (0.0,)
    name: ClassVar[str]
    """Name of the parameter."""
    power: ClassVar[int]
    """Power of the speed."""
    most: ClassVar[float] = 50.0
    """Largest value added, over the one that gives the typical torque at the typical speed."""
    shares: ClassVar[tuple[float, ...]] = (0.05, 0.3)
    """Values from which fits start, over that one."""

    @property
    def nominal(self) -> float:
        """Value of the model."""
        return 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added value; negative down to a total of zero."""
        angle, usual = self.angle_unit, self.load / self.speed**self.power
        unit = self.torque_unit + ("", f"·s/{angle}", f"·s²/{angle}²")[self.power]
        added = Parameter.sized(self.name, unit, usual, 0, self.most, starts=self.shares)
        return (replace(added, low=0.0 - self.nominal, high=self.nominal + added.high),)


class ViscousFriction(_Resistance):
    """Viscous damping added to that of the model; negative down to a total of zero."""

    kind = "viscous_friction"
    name, power = "damping", 1

    @property
    def nominal(self) -> float:
        """Damping of the model."""
        return float(self.machine.model.dof_damping[self.number])

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: 5 % and 30 % of typical torque at typical speed, and half the nominal."""
        # a model's damping is often set for a stable simulation, ten times the machine's
        starts, much = super().starts, 0.5 * self.nominal
        return (*starts, (-much,)) if much > starts[-1][0] else starts

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping, or remove a share of the model's, which may have none."""
        joint, added = spec.joint(self.where), float(values[0])
        damping = np.array(joint.damping)
        damping[0] *= max(1.0 + added / self.nominal, 0.0) if added < 0 else 1.0
        damping[0] += max(added, 0.0)
        joint.damping = damping


class CoulombFriction(_Resistance):
    """Coulomb friction added to that of the model; negative down to a total of zero.

    MuJoCo's own friction creeps: with its default impedance, 0.9, a joint that is held against 10
    rad/s² drifts at about 0.01 rad/s. The stiffest impedance makes that 1e-6 rad/s at a step of 1
    ms.
    """

    kind = "coulomb_friction"
    name, power, most, shares = "torque", 0, 20.0, (0.03, 0.2)

    @property
    def nominal(self) -> float:
        """Friction of the model."""
        return float(self.machine.model.dof_frictionloss[self.number])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's friction loss."""
        if values[0] != 0:
            mjcf.add_friction(spec, self.where, float(values[0]))


class QuadraticDrag(_Resistance):
    """Quadratic drag -c v |v|: second coefficient of MuJoCo's damping polynomial."""

    kind = "quadratic_drag"
    name, power = "drag", 2

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping polynomial."""
        joint = spec.joint(self.where)
        damping = np.array(joint.damping)
        damping[1] += float(values[0])
        joint.damping = damping


class RotorInertia(JointEffect):
    """Rotor inertia added to that of the model; negative down to a total of zero."""

    kind = "rotor_inertia"
    exact_law = True
    null_values = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added inertia; ten times what the joint moves is usual: the gear's ratio squared."""
        unit, low = "kg·m²" if self.turns else "kg", self.machine.model.dof_armature[self.number]
        added = Parameter.sized("inertia", unit, self.moved, 0, 100, starts=(0.2, 1.0))
        return (replace(added, low=-float(low), usual=10 * self.moved),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's armature."""
        joint = spec.joint(self.where)
        joint.armature = max(joint.armature + float(values[0]), 0.0)


class AsymmetricFriction(JointEffect):
    """Coulomb friction that differs by direction: a gear, a seal or a screw under preload.

    Equal to a Coulomb friction of the mean of both directions and a constant torque of half their
    difference, at rest as well.
    """

    kind = "asymmetric_friction"
    extends = "coulomb_friction"
    null_values = (0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction in the positive and in the negative direction."""
        unit, load = self.torque_unit, self.load
        return tuple(Parameter.sized(n, unit, load, 0, 20) for n in ("forward", "backward"))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a weak and a strong one, each larger in either direction."""
        sizes = (0.03 * self.load, 0.2 * self.load)
        return tuple(s for size in sizes for s in ((size, 0.3 * size), (0.3 * size, size)))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss and a constant torque."""
        forward, backward = float(values[0]), float(values[1])
        if forward + backward > 0:
            mjcf.add_friction(spec, self.where, 0.5 * (forward + backward))
            name = mjcf.added_name(spec, self.where, self.kind)
            mjcf.add_constant(spec, self.where, name, 0.5 * (backward - forward))


_KNOTS = (0.19, 1.58)  # speeds, over the Stribeck speed, at which the pieces of the fall meet
_FALLEN = (0.028, 1.0)
"""What has fallen there: the straight lines nearest to 1 - exp(-x²), 0.03 off in the mean."""
_SLOPES = (_FALLEN[0] / _KNOTS[0], (_FALLEN[1] - _FALLEN[0]) / (_KNOTS[1] - _KNOTS[0]))
_PIECES = (_SLOPES[1], _KNOTS[1]), (_SLOPES[0] - _SLOPES[1], _KNOTS[0])
"""Slope and end of two ramps from zero whose sum is the decrease."""


def _peak(speed: float, unit: str, ratio: float) -> tuple[Parameter, Parameter]:
    """Height of a friction at rest over that in motion, and the speed over which it falls."""
    return (
        Parameter(name="static_ratio", unit="", low=1.0, high=5.0, scale=0.5, starts=(ratio,)),
        Parameter.sized("speed", f"{unit}/s", speed, 1e-3, 2.0, starts=(0.3,), log=True),
    )


class StribeckFriction(JointEffect):
    """Stribeck friction: Coulomb friction, larger near rest.

    Torque in steady motion: Fc + (Fs - Fc) exp(-(v/vs)²), with the Coulomb torque Fc, the static
    torque Fs = ratio · Fc and the Stribeck speed vs. At rest it is MuJoCo's friction loss, which
    truly sticks; two limited dampers compensate in motion for the decrease, which is piecewise
    linear with three segments. A bristle model (LuGre) would be a stiff equation.
    """

    kind = "stribeck_friction"
    extends = "coulomb_friction"
    proportional = 0
    limit = (("torque", "low"),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coulomb torque, ratio of static torque to it, Stribeck speed."""
        unit, starts = self.torque_unit, (0.04, 0.2)
        torque = Parameter.sized("torque", unit, self.load, 1e-4, 20, starts=starts, log=True)
        return (torque, *_peak(self.speed, self.angle_unit, 1.6))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss, and actuators without input for the decrease in motion."""
        torque, ratio, speed = (float(v) for v in values)
        mjcf.add_friction(spec, self.where, ratio * torque)
        fall = max(ratio - 1, 1e-6) * torque
        for number, (slope, end) in enumerate(_PIECES):
            name = mjcf.added_name(spec, self.where, f"{self.kind}_{number}")
            bias, limit = (0.0, 0.0, fall * slope / speed), fall * abs(slope) * end
            mjcf.add_passive(spec, self.where, name, bias=bias, limit=limit)


_TRACE = 1e-9
"""Friction loss that a joint gets, so that it has a friction at all, over its typical torque."""
_LEAST = 1e-3  # smallest share of a load friction with a Stribeck peak


class LoadFriction(DrivenEffect, JointEffect):
    """Friction proportional to the drive's torque on the joint, as of teeth under load.

    Dry friction ``share · |drive torque|``, beside that of the joint itself. Variants:

    - "stribeck": ``share · |drive torque| · (1 + (static_ratio - 1) exp(-(v / speed)²))``,
    - "external": ``share · |drive torque| + load_share · |load|``, the load being the torque of
      gravity and inertial coupling, which stages and bearings behind the gear carry.

    A share of s is a gear efficiency of 1 - s when the drive moves the load.

    References
    ----------
    Duclusaud et al., Extended friction models for the physics simulation of servo actuators
    (2025): models M3 to M5, with one Stribeck peak.
    """

    kind = "load_friction"
    variants = ("", "stribeck", "external")
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        if self.variant == "stribeck":
            self.null_values, self.limit = None, (("share", "low"),)  # type: ignore[misc]
        elif not self.variant:
            self.null_values = (0.0,)  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction over drive torque, and over the load or with a peak's height and speed."""
        peaked = self.variant == "stribeck"
        low, starts = _LEAST if peaked else 0.0, (0.08, 0.4)
        share = Parameter.sized("share", "", 1.0, low, 0.95, starts=starts, log=peaked)
        if peaked:
            return (share, *_peak(self.speed, self.angle_unit, 1.5))
        return (share, replace(share, name="load_share"))[: 2 if self.variant else 1]

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: of a good gear and of a hobby servo's."""
        return ((0.08, 0.08), (0.3, 0.2)) if self.variant == "external" else super().starts

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the joint a trace of dry friction, whose size follows the load step by step."""
        if values[0] == 0 and not (self.variant == "external" and values[1]):
            return
        self.export(spec, values)
        joint = spec.joint(self.where)
        joint.frictionloss = max(joint.frictionloss, _TRACE * self.load)

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Make the joint stick: all of the friction comes with the code, step by step."""
        if np.any(values[: 2 if self.variant == "external" else 1]):
            mjcf.make_it_stick(spec.joint(self.where), spec.option.timestep)

    def dry_friction(self, drive: Array, load: Array, speed: Array, values: Array) -> Array:
        """Shares of the torques of drive and load."""
        joint, share = self.number, values[0]
        if self.variant == "stribeck":
            _, ratio, slow = values
            share = share * (1 + (ratio - 1) * np.exp(-((speed[..., joint] / slow) ** 2)))
        found = np.zeros_like(drive)
        found[..., joint] = share * np.abs(drive[..., joint])
        if self.variant == "external":
            found[..., joint] += values[1] * np.abs(load[..., joint])
        return found

    def friction_code(self, values: Array) -> str:
        """Python line: the shares of the torques at that speed."""
        joint, (share, *more) = self.number, map(float, values)
        own = f"{share!r} * abs(drive[{joint}])"
        if self.variant == "stribeck":
            fallen = f"np.exp(-((speed[{joint}] / {more[1]!r}) ** 2))"
            own = f"{share!r} * (1 + {more[0] - 1:.6g} * {fallen}) * abs(drive[{joint}])"
        elif self.variant == "external":
            own += f" + {more[0]!r} * abs(load[{joint}])"
        return f"friction[{joint}] += {own}"


_MOST_PERIODS = 400.0  # periods per turn that are tried at most
_TRIED = 4000  # numbers of periods in the search, at most
_PROPOSED = 3  # peaks that become starts


class TorqueRipple(JointEffect):
    """Torque ripple: a sine of the joint's position, per turn or per metre.

    A sin(N q + phase) on a hinge of N periods per turn, A sin(2π N q + phase) on a slide of N
    periods per metre.
    """

    kind = "torque_ripple"
    proportional = 0
    needs_data_starts = True
    null_values = (0.0, 1.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude, periods per turn or per metre, phase; only `propose` covers all periods."""
        one, unit = 1.0 / self._rate, "1/turn" if self.turns else "1/m"
        few = (2.0, 6.0) if self.turns else (20.0, 60.0)
        periods = Parameter.sized("periods", unit, one, 0.5, 2 * self._most, scale=1.0)
        return (
            Parameter.sized("amplitude", self.torque_unit, self.load, 0, 10, starts=(0.1,)),
            replace(periods, high=2 * self._most, starts=few),
            Parameter.sized("phase", "rad", 1.0, -2 * pi, 2 * pi, scale=0.5, starts=(0.0, pi / 2)),
        )

    @property
    def _most(self) -> float:
        return _MOST_PERIODS if self.turns else 1 / 1e-3

    @property
    def _rate(self) -> float:
        """Phase per unit of position of one period per turn or per metre [1, rad/m]."""
        return 1.0 if self.turns else 2 * pi

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add an actuator without input, with the ripple as its cogging."""
        name = mjcf.added_name(spec, self.where, self.kind)
        amplitude, periods, phase = (float(v) for v in values)
        mjcf.add_passive(spec, self.where, name, cogging=(amplitude, self._rate * periods, phase))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose the strongest peaks, none beside another, of a periodogram (Lomb, Scargle).

        Its grid, of phase per unit of position, has the resolution of the range of motion.
        """
        q, force = angle, -torque
        width = max(float(np.ptp(q)), 1e-9) if len(q) >= 10 else 1e-9
        spacing = 0.25 * 2 * pi / width
        lowest = max(0.5, pi / width)
        highest = min(self._rate * self._most, lowest + _TRIED * spacing)
        if highest <= lowest:
            return ()
        grid = np.arange(lowest, highest, spacing)
        power = lombscargle(q, force - force.mean(), grid, floating_mean=True)
        found: list[tuple[float, ...]] = []
        amplitude, periods, _ = self.parameters
        while len(found) < _PROPOSED and np.any(power > 0):
            best = float(grid[int(np.argmax(power))])
            power[np.abs(grid - best) < 2 * pi / width] = 0.0
            waves = np.stack([np.sin(best * q), np.cos(best * q), np.ones(len(q))], axis=1)
            sine, cosine, _ = np.linalg.lstsq(waves, force, rcond=None)[0]
            size, count = amplitude.clipped(hypot(sine, cosine)), periods.clipped(best / self._rate)
            found.append((size, count, atan2(cosine, sine)))
        return tuple(found)


class JointSpring(WeightedEffect, JointEffect):
    """Joint spring -k (q - q0), combined exactly with the joint's existing spring."""

    kind = "joint_spring"
    null_values = (0.0, 0.0)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return joints without a nonlinear spring."""
        return named(machine.joints, np.all(machine.model.jnt_stiffnesspoly == 0, axis=1))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Stiffness and equilibrium coordinate of the spring, in the joint's range or beside it."""
        low, high = self._range
        width, unit = high - low, f"{self.torque_unit}/{self.angle_unit}"
        usual = self.load / min(width, pi)
        rests = (0.5 * (low + high), low - 0.2 * width, high + 0.2 * width)
        return (
            Parameter.sized("stiffness", unit, usual, 0, 50, scale=0.2, starts=(0.5,)),
            Parameter(
                name="reference", unit=self.angle_unit, low=low - 2 * width, high=high + 2 * width,
                scale=0.2 * width, starts=rests,
            ),
        )  # fmt: skip

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """A spring that rests at zero, and one beside it: torques add up by stiffness."""
        low, high = self._range
        usual = 0.5 * self.load / min(high - low, pi)
        return ((usual, 0.0), (usual, 0.5 * (high - low)))

    @property
    def _range(self) -> tuple[float, float]:
        """Range of the joint [rad or m], or half a turn about its zero."""
        number = self.number
        if self.machine.model.jnt_limited[number]:
            low, high = self.machine.model.jnt_range[number]
            return float(low), float(high)
        half = pi / 2 if self.turns else 0.5
        return -half, half

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Set the joint's stiffness and spring reference to those of both springs."""
        added, rest = float(values[0]), float(values[1])
        if added != 0:
            joint = spec.joint(self.where)
            stiffness, unit = np.array(joint.stiffness), mjcf.angle_unit(joint)
            moment = stiffness[0] * joint.springref * unit + added * rest
            stiffness[0] += added
            joint.stiffness, joint.springref = stiffness, moment / stiffness[0] / unit


class TorqueOffset(JointEffect):
    """Constant torque at a joint: the zero of a torque sensor, or a preload."""

    kind = "torque_offset"
    exact_law = True
    null_values = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Torque in the joint's direction that the model lacks."""
        own, unit = self.load, self.torque_unit
        return (Parameter.sized("torque", unit, own, -20, 20, starts=(-0.1, 0.1)),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add an actuator without input that gives the torque."""
        if values[0] != 0:
            name = mjcf.added_name(spec, self.where, self.kind)
            mjcf.add_constant(spec, self.where, name, -float(values[0]))


class FrictionBehindSlack(JointEffect):
    """Dry friction of an element that is coupled with slack and an elastic way.

    The force is zero within the slack, grows over the elastic way, and slides at its bound: a
    friction damper with play in its joints. The model gets a light part that a spring with slack
    couples to the joint, and that friction holds.
    """

    kind = "friction_behind_slack"
    proportional = 0
    needs_data_starts = True
    null_values = (0.0, 1.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction, slack, and elastic way; the way is of the order of that in a second."""
        way = Parameter.sized(
            "slack", self.angle_unit, self.speed, 1e-5, 10, scale=1.0, starts=(0.3,), log=True
        )
        return (
            Parameter.sized("torque", self.torque_unit, self.load, 0, 20, starts=(0.2,)),
            way,
            replace(way, name="elastic", starts=(0.1 * self.speed,)),
        )

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Start at slacks from a hundredth to a third of the way, on stiff and soft elements."""
        way = float(np.ptp(angle))
        return tuple(
            (0.2 * self.load, slack * way, stretch * slack * way)
            for slack in np.geomspace(0.01, 0.33, 8)
            for stretch in (0.15, 0.5, 1.2)
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Couple a light part to the link, whose joint says how far it lags behind."""
        friction, slack, elastic = map(float, values)
        if friction > 0:
            model, number = self.machine.model, self.number
            mjcf.add_slipping_part(
                spec, self.machine.body_of(self.where), self.where,
                mjcf.added_name(spec, self.where, self.kind), turns=self.turns,
                axis=model.jnt_axis[number], pos=model.jnt_pos[number],
                friction=friction, slack=slack, stiffness=friction / elastic,
            )  # fmt: skip

    def torque_along(self, position: Array, speed: Array, values: Array) -> Array:
        """Force along a path (T, joints)."""
        joint, (friction, slack, elastic) = self.number, values
        anchor, found = float(position[0, joint]), np.zeros_like(position)
        for k, x in enumerate(position[:, joint]):
            stretch = abs(x - anchor) - slack / 2
            if stretch > elastic:
                anchor = x - np.sign(x - anchor) * (slack / 2 + elastic)
                stretch = elastic
            found[k, joint] = -friction * (np.sign(x - anchor) * max(stretch, 0.0) / elastic)
        return found
