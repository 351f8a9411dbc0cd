"""Stribeck friction: larger near rest than in motion, so that a slow joint sticks and slips."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.coulomb_friction import make_it_stick
from loose_env.gap.effects.joint_effect import JointEffect, added_name, fitted_rate
from loose_env.gap.effects.passive_drive import add_limited_damper
from loose_env.gap.parameter import Parameter

__all__ = ["StribeckFriction"]

Array = NDArray[np.float64]

_START_SPEED = 0.3
"""Stribeck speed from which fits start, over the typical speed."""
_KNOTS = (0.19, 1.58)
"""Speeds, over the Stribeck speed, at which the pieces of the fall meet."""
_FALLEN = (0.028, 1.0)
"""What has fallen there: the straight lines nearest to 1 - exp(-x²), 0.03 off in the mean."""


class StribeckFriction(JointEffect):
    """Coulomb friction, and near rest more of it.

    Torque in steady motion: Fc + (Fs - Fc) exp(-(v/vs)²), with the Coulomb torque Fc, the static
    torque Fs = ratio · Fc and the Stribeck speed vs. At rest it is MuJoCo's friction loss, which
    truly sticks; two limited dampers give back in motion what the friction falls by, so that the
    fall is made of three straight lines. Bristles (LuGre) would be stiff equations.
    """

    kind = "stribeck_friction"
    sharp: ClassVar[bool] = True

    proportional: ClassVar[int | None] = 0
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("torque", "low"),)

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
                centre=_START_SPEED * self.speed,
                spread=2.0,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A weak and a strong one, each half as strong again at rest."""
        return (
            (0.04 * self.load, 1.6, _START_SPEED * self.speed),
            (0.2 * self.load, 1.6, _START_SPEED * self.speed),
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add friction loss, and drives without input for what is less in motion."""
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
        """The static torque, which is what it has of its own beside a Coulomb friction."""
        torque, ratio, _ = values
        return float(torque * ratio)

    def unseen_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """What the dampers take; they help, so that it is against the friction."""
        torque, ratio, slow = values
        fallen = sum(slope * np.minimum(np.abs(speed) / slow, limit) for slope, limit in _pieces())
        return np.asarray(-(ratio - 1) * torque * fallen * np.sign(speed))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Regress the torque on the direction of motion."""
        moving = np.abs(speed) > 0.05 * np.nanmax(np.abs(speed), initial=0.0)
        rate = fitted_rate(np.sign(speed[moving]), torque[moving])
        if rate <= 0:
            return ()
        return ((self.parameters[0].clipped(rate), 1.6, _START_SPEED * self.speed),)


def _pieces() -> tuple[tuple[float, float], tuple[float, float]]:
    """Slope and end of two ramps from zero whose sum is the fall."""
    first = _FALLEN[0] / _KNOTS[0]
    second = (_FALLEN[1] - _FALLEN[0]) / (_KNOTS[1] - _KNOTS[0])
    return (second, _KNOTS[1]), (first - second, _KNOTS[0])
