"""Load-dependent friction effect: dry friction proportional to the drive's torque."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.driven_effect import DrivenEffect
from loose_env.gap.model.effects.mjcf.joint_effect import START_SPEED, JointEffect
from loose_env.gap.model.effects.mjcf.passive_actuators import make_it_stick
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_TRACE = 1e-9
"""Friction loss that a joint gets, so that it has a friction at all, over its typical torque."""
_LEAST = 1e-3
"""Smallest share of a load friction with a Stribeck peak."""


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
    needs_fine_steps: ClassVar[bool] = True
    variants: ClassVar[tuple[str, ...]] = ("", "stribeck", "external")

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        if self.variant == "stribeck":
            self.limit = (("share", "low"),)  # type: ignore[misc]
        else:
            self.null_values = (0.0, 0.0) if self.variant else (0.0,)  # type: ignore[misc]

    @classmethod
    def null_value(cls, parameters: Sequence[str], parameter: str) -> float:
        """Without it the shares are zero; with a peak it vanishes in a limit."""
        return float("nan") if "speed" in parameters else 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction over drive torque, and over the load or with a peak's height and speed."""
        if self.variant != "stribeck":
            names = ("share", "load_share") if self.variant else ("share",)
            return tuple(Parameter(name=n, unit="", low=0.0, high=0.95, scale=0.1) for n in names)
        return (
            Parameter(name="share", unit="", low=_LEAST, high=0.95, scale=0.1, log=True),
            Parameter(
                name="static_ratio", unit="", low=1.0, high=5.0, scale=0.5, centre=1.0, spread=4.0
            ),
            self.stribeck_speed,
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: of a good gear and of a hobby servo's."""
        if not self.variant:
            return ((0.08,), (0.4,))
        if self.variant == "external":
            return ((0.08, 0.08), (0.3, 0.2))
        return ((0.08, 1.5, START_SPEED * self.speed), (0.4, 1.5, START_SPEED * self.speed))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Give the joint a trace of dry friction, whose size follows the load step by step."""
        if values[0] == 0 and self._load_share(values) == 0:
            return
        joint = spec.joint(self.where)
        joint.frictionloss = max(joint.frictionloss, _TRACE * self.load)
        make_it_stick(joint, spec.option.timestep)

    def dry_friction(self, drive: Array, load: Array, speed: Array, values: Array) -> Array:
        """Shares of the torques of drive and load."""
        joint = self.machine.joint_number(self.where)
        found = np.zeros_like(drive)
        own = self._share(speed[..., joint], values) * np.abs(drive[..., joint])
        if self.variant == "external":
            own += values[1] * np.abs(load[..., joint])
        found[..., joint] = own
        return found

    def _load_share(self, values: Array) -> float:
        return float(values[1]) if self.variant == "external" else 0.0

    def _share(self, speed: Array, values: Array) -> Array:
        if self.variant != "stribeck":
            return np.asarray(values[0])
        share, ratio, slow = values
        return np.asarray(share * (1 + (ratio - 1) * np.exp(-((speed / slow) ** 2))))

    def friction_code(self, values: Array) -> str:
        """Python line: the shares of the torques at that speed."""
        joint = self.machine.joint_number(self.where)
        share = repr(float(values[0]))
        if self.variant == "stribeck":
            ratio, slow = float(values[1]), float(values[2])
            share += f" * (1 + {ratio - 1!r} * np.exp(-((speed[{joint}] / {slow!r}) ** 2)))"
        line = f"friction[{joint}] += {share} * abs(drive[{joint}])"
        if self.variant == "external":
            line += f" + {self._load_share(values)!r} * abs(load[{joint}])"
        return line

    def resistance(self, speed: float, values: Array) -> float:
        """Resistance under the joint's typical torque."""
        share = float(self._share(np.asarray(speed), values))
        return (share + self._load_share(values)) * self.load
