"""Friction effects: viscous, Coulomb, asymmetric, Stribeck, and quadratic drag.

Viscous friction is proportional to speed. Coulomb friction is a constant torque against the motion,
which holds a joint at rest. Stribeck friction is larger near rest than in motion, so that a slow
joint sticks and slips. Quadratic drag is proportional to the speed squared. Asymmetric friction is
a Coulomb friction that differs by direction.
"""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effects.mjcf.joint_effect import (
    START_SPEED,
    JointEffect,
    added_name,
    fitted_rate,
)
from loose_env.gap.model.effects.mjcf.passive_actuators import (
    add_constant,
    add_limited_damper,
    make_it_stick,
)
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class ViscousFriction(JointEffect):
    """Viscous damping added to that of the model; negative down to a total of zero."""

    kind = "viscous_friction"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added damping."""
        per_speed = self.load / self.speed
        return (
            Parameter(
                name="damping",
                unit=f"{self.torque_unit}·s/{self.angle_unit}",
                low=-self._nominal,
                high=self._nominal + 50 * per_speed,
                scale=0.1 * per_speed,
                natural_low=True,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: 5 % and 30 % of typical torque at typical speed, and half the nominal.

        The damping of a model is often set for a stable simulation, ten times the machine's:
        removing half of it shows that, where it matters.
        """
        per_speed = self.load / self.speed
        starts: tuple[tuple[float, ...], ...] = ((0.05 * per_speed,), (0.3 * per_speed,))
        much = 0.5 * self._nominal
        return (*starts, (-much,)) if much > starts[-1][0] else starts

    @property
    def _nominal(self) -> float:
        """Damping of the model."""
        return float(self.machine.model.dof_damping[self._dof])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping, or remove a share of the model's.

        A share keeps the sensitivity of a joint that has no damping at all.
        """
        joint, added = spec.joint(self.where), float(values[0])
        damping = np.array(joint.damping)
        if added < 0:
            damping[0] *= max(1.0 + added / self._nominal, 0.0)
        else:
            damping[0] += added
        joint.damping = damping

    def resistance(self, speed: float, values: Array) -> float:
        """Resistance proportional to the speed."""
        return float(values[0]) * speed

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on speed."""
        return ((self.parameters[0].clipped(fitted_rate(speed, torque)),),)


class CoulombFriction(JointEffect):
    """Coulomb friction added to that of the model; negative down to a total of zero.

    MuJoCo's own friction creeps: with its default impedance, 0.9, a joint that is held against 10
    rad/s² drifts at about 0.01 rad/s. The stiffest impedance makes that 1e-6 rad/s at a step of 1
    ms.
    """

    kind = "coulomb_friction"
    needs_fine_steps: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added torque."""
        nominal = float(self.machine.model.dof_frictionloss[self._dof])
        return (
            Parameter(
                name="torque",
                unit=self.torque_unit,
                low=-nominal,
                high=nominal + 20 * self.load,
                scale=0.1 * self.load,
                natural_low=True,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a thirtieth and a fifth of the typical torque."""
        return ((0.03 * self.load,), (0.2 * self.load,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's friction loss."""
        if values[0] == 0:
            return
        joint = spec.joint(self.where)
        joint.frictionloss = max(joint.frictionloss + float(values[0]), 0.0)
        make_it_stick(joint, spec.option.timestep)

    def resistance(self, speed: float, values: Array) -> float:
        """Constant resistance, at any speed."""
        return float(values[0])

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on direction of motion, without rest."""
        moving = np.abs(speed) > 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        rate = fitted_rate(np.sign(speed[moving]), torque[moving])
        return ((self.parameters[0].clipped(rate),),)


class AsymmetricFriction(JointEffect):
    """Coulomb friction that differs by direction: a gear, a seal or a screw under preload.

    Equal to a Coulomb friction of the mean of both directions and a constant torque of half their
    difference, at rest as well.
    """

    kind = "asymmetric_friction"
    extends: ClassVar[str] = "coulomb_friction"
    needs_fine_steps: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction in the positive and in the negative direction."""
        return tuple(
            Parameter(
                name=name,
                unit=self.torque_unit,
                low=0.0,
                high=20 * self.load,
                scale=0.1 * self.load,
            )
            for name in ("forward", "backward")
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a weak and a strong one, each larger in either direction."""
        weak, strong = 0.03 * self.load, 0.2 * self.load
        return tuple(
            sides for size in (weak, strong) for sides in ((size, 0.3 * size), (0.3 * size, size))
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss and a constant torque."""
        forward, backward = float(values[0]), float(values[1])
        if forward + backward <= 0:
            return
        joint = spec.joint(self.where)
        joint.frictionloss += 0.5 * (forward + backward)
        make_it_stick(joint, spec.option.timestep)
        name = added_name(spec, self.where, self.kind)
        add_constant(spec, self.where, name, 0.5 * (backward - forward))

    def resistance(self, speed: float, values: Array) -> float:
        """Mean of both directions."""
        return 0.5 * float(values[0] + values[1])

    def passive_actuator_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """Torque against the constant one."""
        return np.full_like(angle, 0.5 * float(values[0] - values[1]))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by the mean torque in either direction, without rest."""
        least = 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        ahead, back = torque[speed > least], torque[speed < -least]
        if not (np.isfinite(ahead).any() and np.isfinite(back).any()):
            return ()
        sides = self.parameters
        return ((sides[0].clipped(np.nanmean(ahead)), sides[1].clipped(-np.nanmean(back))),)


_KNOTS = (0.19, 1.58)
"""Speeds, over the Stribeck speed, at which the pieces of the fall meet."""
_FALLEN = (0.028, 1.0)
"""What has fallen there: the straight lines nearest to 1 - exp(-x²), 0.03 off in the mean."""


class StribeckFriction(JointEffect):
    """Stribeck friction: Coulomb friction, larger near rest.

    Torque in steady motion: Fc + (Fs - Fc) exp(-(v/vs)²), with the Coulomb torque Fc, the static
    torque Fs = ratio · Fc and the Stribeck speed vs. At rest it is MuJoCo's friction loss, which
    truly sticks; two limited dampers compensate in motion for the decrease, which is piecewise
    linear with three segments. A bristle model (LuGre) would be a stiff equation.
    """

    kind = "stribeck_friction"
    extends: ClassVar[str] = "coulomb_friction"
    needs_fine_steps: ClassVar[bool] = True

    proportional: ClassVar[int | None] = 0
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("torque", "low"),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coulomb torque, ratio of static torque to it, Stribeck speed."""
        return (
            Parameter(
                name="torque",
                unit=self.torque_unit,
                low=1e-4 * self.load,
                high=20 * self.load,
                scale=0.1 * self.load,
                log=True,
            ),
            Parameter(name="static_ratio", unit="", low=1.0, high=5.0, scale=0.5, natural_low=True),
            self.stribeck_speed,
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a weak and a strong one, each half as strong again at rest."""
        return (
            (0.04 * self.load, 1.6, START_SPEED * self.speed),
            (0.2 * self.load, 1.6, START_SPEED * self.speed),
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss, and actuators without input for the decrease in motion."""
        torque, ratio, speed = (float(v) for v in values)
        joint = spec.joint(self.where)
        joint.frictionloss += ratio * torque
        make_it_stick(joint, spec.option.timestep)
        for number, (slope, limit) in enumerate(_pieces()):
            add_limited_damper(
                spec,
                self.where,
                added_name(spec, self.where, f"{self.kind}_{number}"),
                damping=-max(ratio - 1, 1e-6) * torque * slope / speed,
                limit=max(ratio - 1, 1e-6) * torque * abs(slope) * limit,
            )

    def resistance(self, speed: float, values: Array) -> float:
        """Static torque: the part that it has beside a Coulomb friction."""
        torque, ratio, _ = values
        return float(torque * ratio)

    def passive_actuator_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """Torque of the dampers against the friction."""
        torque, ratio, slow = values
        fallen = sum(slope * np.minimum(np.abs(speed) / slow, limit) for slope, limit in _pieces())
        return np.asarray(-(ratio - 1) * torque * fallen * np.sign(speed))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on direction of motion."""
        moving = np.abs(speed) > 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        rate = fitted_rate(np.sign(speed[moving]), torque[moving])
        if rate <= 0:
            return ()
        return ((self.parameters[0].clipped(rate), 1.6, START_SPEED * self.speed),)


def _pieces() -> tuple[tuple[float, float], tuple[float, float]]:
    """Slope and end of two ramps from zero whose sum is the decrease."""
    first = _FALLEN[0] / _KNOTS[0]
    second = (_FALLEN[1] - _FALLEN[0]) / (_KNOTS[1] - _KNOTS[0])
    return (second, _KNOTS[1]), (first - second, _KNOTS[0])


class QuadraticDrag(JointEffect):
    """Quadratic drag -c v |v|: second coefficient of MuJoCo's damping polynomial."""

    kind = "quadratic_drag"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Drag coefficient."""
        per_square = self.load / self.speed**2
        return (
            Parameter(
                name="drag",
                unit=f"{self.torque_unit}·s²/{self.angle_unit}²",
                low=0.0,
                high=50 * per_square,
                scale=0.1 * per_square,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: 5 % and 30 % of the typical torque at the typical speed."""
        per_square = self.load / self.speed**2
        return ((0.05 * per_square,), (0.3 * per_square,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's damping polynomial."""
        joint = spec.joint(self.where)
        damping = np.array(joint.damping)
        damping[1] += float(values[0])
        joint.damping = damping

    def resistance(self, speed: float, values: Array) -> float:
        """Resistance proportional to the speed squared."""
        return float(values[0]) * speed**2

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on v |v|."""
        return ((self.parameters[0].clipped(fitted_rate(speed * np.abs(speed), torque)),),)
