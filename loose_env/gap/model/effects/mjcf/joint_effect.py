"""Base class JointEffect; unit of a joint's angle, unused element names, least-squares rate."""

from __future__ import annotations

from math import pi
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

START_SPEED = 0.3
"""Stribeck speed from which fits start, over the typical speed."""


class JointEffect(Effect):
    """An effect that can be at every joint."""

    acts_on: ClassVar[str] = "joint"

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every joint."""
        return machine.joints

    @property
    def load(self) -> float:
        """Typical torque [N·m] or force [N] of the joint."""
        return self.machine.load(self.where)

    @property
    def speed(self) -> float:
        """Typical speed of the joint [rad/s or m/s]."""
        return self.machine.speed(self.where)

    @property
    def carried(self) -> float:
        """Inertia that the joint moves without its own rotor [kg·m² or kg]."""
        rotor = float(self.machine.model.dof_armature[self._dof])
        return max(self.machine.inertia(self.where) - rotor, 1e-9)

    @property
    def stribeck_speed(self) -> Parameter:
        """Speed over which a friction falls from its height at rest."""
        return Parameter(
            name="speed",
            unit=f"{self.angle_unit}/s",
            low=1e-3 * self.speed,
            high=2.0 * self.speed,
            scale=0.1 * self.speed,
            log=True,
            centre=START_SPEED * self.speed,
            spread=2.0,
        )

    @property
    def _dof(self) -> int:
        return int(self.machine.model.joint(self.where).dofadr[0])

    @property
    def torque_unit(self) -> str:
        """Unit of the joint's driving force."""
        return "N·m" if self.machine.turns(self.where) else "N"

    @property
    def angle_unit(self) -> str:
        """Unit of the joint's coordinate."""
        return "rad" if self.machine.turns(self.where) else "m"


def angle_unit(joint: mujoco.MjsJoint) -> float:
    """Size of one unit of the spec's angles at a joint [rad]; 1 for a slide."""
    return pi / 180 if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.compiler.degree else 1.0


def added_name(spec: mujoco.MjSpec, where: str, kind: str) -> str:
    """Return an unused name for an element that an effect adds to a model.

    A corrected model that is compared again has elements added before, and an effect may occur
    twice.

    Examples
    --------
    >>> spec = mujoco.MjSpec()
    >>> added_name(spec, "joint2", "backlash")
    'joint2_backlash'
    >>> _ = spec.worldbody.add_joint(name="joint2_backlash")
    >>> added_name(spec, "joint2", "backlash")
    'joint2_backlash_2'
    """
    several = (spec.bodies, spec.joints, spec.sites, spec.actuators)
    taken = {element.name for elements in several for element in elements}
    name, again = f"{where}_{kind}", 2
    while name in taken:
        name, again = f"{where}_{kind}_{again}", again + 1
    return name


def fitted_rate(regressor: Array, torque: Array) -> float:
    """Least-squares coefficient of a regressor (T,) in a torque (T,), with intercept.

    Examples
    --------
    >>> x = np.array([0.0, 1.0, 2.0, 3.0])
    >>> round(fitted_rate(x, 5 + 2 * x), 6)
    2.0
    """
    good = np.isfinite(regressor) & np.isfinite(torque)
    if good.sum() < 3:
        return 0.0
    x = regressor[good] - regressor[good].mean()
    power = float(x @ x)
    return float(x @ (torque[good] - torque[good].mean())) / power if power > 0 else 0.0
