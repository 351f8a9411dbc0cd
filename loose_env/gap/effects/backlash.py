"""Backlash: the link side of a joint is free within a gap."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effects.extra_joint import FASTEST, set_stops
from loose_env.gap.effects.geometry import reach_of
from loose_env.gap.effects.joint_compliance import SplitJoint
from loose_env.gap.parameter import Parameter

__all__ = ["Backlash", "stop_stiffness"]

Array = NDArray[np.float64]

_DRAG_RATE = 2.0
"""How fast oil stops a link that floats in the gap [1/s]."""


class Backlash(SplitJoint):
    """An extra joint between stops, which are springs with dampers."""

    kind = "backlash"
    limit: ClassVar[tuple[str, str] | None] = ("gap", "low")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Gap, and stiffness of the stops."""
        length = 1.0 if self.machine.turns(self.where) else reach_of(self.machine)
        return (
            Parameter(
                name="gap",
                unit=self.angle_unit,
                low=1e-5 * length,
                high=0.5 * length,
                scale=0.01 * length,
                log=True,
            ),
            stop_stiffness(self.weight, self.step, f"{self.torque_unit}/{self.angle_unit}"),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A small and a large gap with stiff stops."""
        gap, stiffness = self.parameters
        assert stiffness.centre is not None
        return tuple((share * gap.scale, stiffness.centre) for share in (0.3, 3.0))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Put the gap behind the joint."""
        joint = self._split(spec, damping=_DRAG_RATE * self.carried)
        set_stops(joint, 0.5 * float(values[0]), float(values[1]), self.weight)


def stop_stiffness(weight: float, step: float, unit: str) -> Parameter:
    """Stiffness of stops: a nuisance, about a quarter of the most that the step [s] can follow."""
    high = (FASTEST / step) ** 2 / weight
    return Parameter(
        name="stiffness", unit=unit, low=1e-3 * high, high=high, scale=0.25 * high, log=True,
        centre=0.25 * high, spread=1.5,
    )  # fmt: skip
