"""Backlash effect: clearance with stops between drive and link side; shared stop parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effects.joint_elasticity import SplitJoint
from loose_env.gap.model.effects.mjcf.extra_joint import set_stops
from loose_env.gap.model.effects.mjcf.geometry import reach_of
from loose_env.gap.model.effects.mjcf.passive_actuators import make_it_stick
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_DRAG_RATE = 2.0
"""How fast oil stops a link that floats in the gap [1/s]."""
_FASTEST = 1.2
"""Largest angle by which a mode on a stop may turn in a step, at the model's zero [rad]: more than
that of an added spring, since a stop is damped."""
_LEAST_LOAD = 0.05
"""Least usual load of a joint, as a share of that of the most loaded one."""
_STARTS = (0.02, 0.06, 0.15, 0.3, 0.7, 3.0)
"""Gaps from which fits start, as shares of a hundredth of a radian or of the reach."""
_CLOSE_STARTS = tuple(0.02 * 1.5**k for k in range(14))
"""The same where the motion of the motor is given: then a gap too wide by a third fits worse than
none."""
_TRAVEL_S = 0.5
"""Time in which a slide travels a typical distance at its typical speed [s]."""
_RUBBING_STARTS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""The same for play in front of a friction, where a wide gap is common."""
SOFTER = (1.0, 0.3, 0.1)
"""Stiffnesses of stops from which fits start, over the usual one: on soft stops a wrong gap or
friction is told from none, and a fit finds the right ones from further off."""
_DAMPING = 0.3
"""Damping ratio of a mode on a stop, give or take a factor of two."""


class Backlash(SplitJoint):
    """Backlash: an extra joint between stops, which are spring-dampers.

    Variant "rubbing": what lies beyond the play is held by dry friction, as in a damper or a brake
    with slack. Either explains little alone: friction at the motor side acts in the gap as well,
    and play in front of a free link hardly shows in a torque. It is the friction of a tendon over
    both joints, whose length is the position of the link.
    """

    kind = "backlash"
    has_stops = True
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("gap", "low"), ("stiffness", "high"))
    variants: ClassVar[tuple[str, ...]] = ("", "rubbing")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Clearance, stiffness of the stops, damping ratio on them, friction beyond the play."""
        if not self.variant:
            return self._play
        friction = Parameter(
            name="friction", unit=self.torque_unit, low=1e-3 * self.load, high=20 * self.load,
            scale=0.3 * self.load, log=True,
        )  # fmt: skip
        return (*self._play, friction)

    @property
    def _play(self) -> tuple[Parameter, ...]:
        length = 1.0
        if not self.machine.turns(self.where):
            # a lone slide has no reach, but it travels
            length = max(reach_of(self.machine), _TRAVEL_S * self.speed)
        return (
            Parameter(
                name="gap",
                unit=self.angle_unit,
                low=1e-5 * length,
                high=0.5 * length,
                scale=0.01 * length,
                log=True,
            ),
            *stops(self.weight, self.machine.time_step, f"{self.torque_unit}/{self.angle_unit}"),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: clearances of 0.01° to 2°; a wrong one fits no better than none."""
        return self._starts(_STARTS)

    @property
    def inverse_starts(self) -> tuple[tuple[float, ...], ...]:
        """The same range in smaller steps."""
        return self._starts(_CLOSE_STARTS)

    def _starts(self, shares: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        gap, stiffness, ratio = self._play
        if self.variant:
            return tuple(
                (share * gap.scale, stiffness.scale, ratio.scale, size * self.load)
                for share in _RUBBING_STARTS
                for size in (0.3, 1.0)
            )
        return tuple(
            (share * gap.scale, softer * stiffness.scale, ratio.scale)
            for softer in SOFTER
            for share in shares
        )

    def resistance(self, speed: float, values: Array) -> float:
        """Friction beyond the play."""
        return float(values[3]) if self.variant else 0.0

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the clearance behind the joint."""
        joint = self._split(spec, damping=_DRAG_RATE * self.carried)
        gap, stiffness, ratio, *friction = (float(v) for v in values)
        if friction:
            tendon = spec.add_tendon(
                name=f"{joint.name}_{self.variant}", frictionloss=friction[0], limited=False
            )
            tendon.wrap_joint(self.where, 1.0)
            tendon.wrap_joint(joint.name, 1.0)
            make_it_stick(tendon, spec.option.timestep)
        set_stops(
            joint,
            0.5 * gap,
            stiffness=stiffness,
            ratio=ratio,
            weight=self.weight,
            load=self._load,
        )

    @property
    def _load(self) -> float:
        """Typical load of the joint; a small one is raised to that of slight shaking."""
        largest = float(np.max(self.machine.load_scales))
        return max(self.machine.load(self.where), _LEAST_LOAD * largest)


def stops(weight: float, step: float, unit: str) -> tuple[Parameter, Parameter]:
    """Stiffness of stops and damping ratio of the mode on them, both nuisances.

    The stiffness is about a quarter of the largest that is stable at the step [s].
    """
    high = (_FASTEST / step) ** 2 / weight
    return (
        Parameter(
            name="stiffness", unit=unit, low=1e-3 * high, high=high, scale=0.25 * high, log=True,
            centre=0.25 * high, spread=1.5,
        ),
        Parameter(
            name="damping_ratio", unit="", low=0.02, high=1.0, scale=_DAMPING, log=True,
            centre=_DAMPING, spread=0.7,
        ),
    )  # fmt: skip
