"""Stribeck friction: larger near rest than in motion, so that a slow joint sticks and slips."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.coulomb_friction import make_it_stick
from loose_env.gap.effects.joint_effect import JointEffect, added_name, fitted_rate
from loose_env.gap.effects.passive_drive import add_passive_drive
from loose_env.gap.parameter import Parameter

__all__ = ["StribeckFriction"]

Array = NDArray[np.float64]

_BRISTLE_TURN = 0.4
"""Angle by which the bristles' mode may turn in one step [rad]."""
_LEFT_IN_MOTION = 0.01
"""What the bristles give in fast motion, as a share of what they give at rest: none would do, but
makes them stiff equations."""


class StribeckFriction(JointEffect):
    """Coulomb friction, and near rest more of it.

    Torque in steady motion: Fc + (Fs - Fc) exp(-(v/vs)²), with the Coulomb torque Fc, the static
    torque Fs = ratio · Fc and the Stribeck speed vs. The constant part is MuJoCo's friction
    loss, which truly sticks; the rest are the bristles of its LuGre model, as stiff as the step
    allows. They have no damping of their own: the constant part stops what swings on them, and
    implicit integration would let their damping weigh on a joint that slides.
    """

    kind = "stribeck_friction"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coulomb torque, static torque over it, Stribeck speed."""
        return (
            Parameter(
                name="torque",
                unit=self.torque_unit,
                low=1e-4 * self.load,
                high=20 * self.load,
                scale=0.1 * self.load,
                log=True,
            ),
            Parameter(name="static_ratio", unit="", low=1.0, high=5.0, scale=0.5),
            Parameter(
                name="speed",
                unit=f"{self.angle_unit}/s",
                low=1e-3 * self.speed,
                high=2.0 * self.speed,
                scale=0.1 * self.speed,
                log=True,
                centre=0.1 * self.speed,
                spread=2.0,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A weak and a strong one, each half as strong again at rest."""
        return (
            (0.04 * self.load, 1.6, 0.1 * self.speed),
            (0.2 * self.load, 1.6, 0.1 * self.speed),
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss, and a drive without input for what is more near rest."""
        torque, ratio, speed = (float(v) for v in values)
        joint = spec.joint(self.where)
        joint.frictionloss += torque
        make_it_stick(joint, spec.option.timestep)
        inertia = self.machine.inertia(self.where)
        mode = _BRISTLE_TURN / spec.option.timestep
        extra = max(ratio - 1, 1e-6) * torque
        add_passive_drive(
            spec,
            self.where,
            added_name(self.where, self.kind),
            lugre=(inertia * mode**2, 0.0, _LEFT_IN_MOTION * extra, extra, speed),
        )

    def unseen_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """What the bristles take in steady motion."""
        torque, ratio, slow = values
        share = _LEFT_IN_MOTION + (1 - _LEFT_IN_MOTION) * np.exp(-((speed / slow) ** 2))
        return np.asarray((ratio - 1) * torque * share * np.sign(speed))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the direction of motion."""
        moving = np.abs(speed) > 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        rate = fitted_rate(np.sign(speed[moving]), torque[moving])
        if rate <= 0:
            return ()
        return ((self.parameters[0].clipped(rate), 1.6, 0.1 * self.speed),)
