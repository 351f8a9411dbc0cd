"""Rotor inertia, the same in every pose, and torque ripple.

Torque ripple is periodic in the joint's angle, from cogging or gear teeth.
"""

from __future__ import annotations

from math import atan2, hypot, pi
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lombscargle

from loose_env.gap.model.effects.mjcf.joint_effect import JointEffect, added_name, fitted_rate
from loose_env.gap.model.effects.mjcf.passive_actuators import add_cogging
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

__all__ = ["RotorInertia", "TorqueRipple"]


class RotorInertia(JointEffect):
    """Rotor inertia added to that of the model; negative down to a total of zero."""

    kind = "rotor_inertia"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added inertia."""
        moved = self.machine.inertia(self.where)
        return (
            Parameter(
                name="inertia",
                unit="kg·m²" if self.machine.turns(self.where) else "kg",
                low=-float(self.machine.model.dof_armature[self._dof]),
                high=100 * moved,
                scale=0.1 * moved,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a fifth of the inertia that the joint moves, and the same again."""
        moved = self.machine.inertia(self.where)
        return ((0.2 * moved,), (1.0 * moved,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's armature."""
        joint = spec.joint(self.where)
        joint.armature = max(joint.armature + float(values[0]), 0.0)

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on acceleration."""
        return ((self.parameters[0].clipped(fitted_rate(acceleration, torque)),),)


_MOST_PERIODS = 400.0
"""Periods per turn that are tried at most."""
_TRIED = 4000
"""Numbers of periods in the search, at most."""
_PROPOSED = 3
"""Peaks that become starts."""
_SAMPLES = 4000
"""Samples that the search looks at."""


class TorqueRipple(JointEffect):
    """Torque ripple: a sine of the joint's position, per turn or per metre.

    A sin(N q + phase) on a hinge of N periods per turn, A sin(2π N q + phase) on a slide of N
    periods per metre.
    """

    kind = "torque_ripple"
    proportional: ClassVar[int | None] = 0
    searches: ClassVar[bool] = True
    nothing: ClassVar[tuple[float, ...] | None] = (0.0, 1.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude, periods per turn or per metre, phase."""
        one = 1.0 / self._rate
        return (
            Parameter(
                name="amplitude",
                unit=self.torque_unit,
                low=0.0,
                high=10 * self.load,
                scale=0.1 * self.load,
            ),
            Parameter(
                name="periods",
                unit="1/turn" if self.machine.turns(self.where) else "1/m",
                low=0.5 * one,
                high=2 * self._most,
                scale=one,
            ),
            Parameter(name="phase", unit="rad", low=-2 * pi, high=2 * pi, scale=0.5),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts with a few numbers of periods; only `propose` can cover all of them."""
        lone = 1.0 if self.machine.turns(self.where) else 1 / 0.1
        return tuple(
            (0.1 * self.load, n * lone, phase) for n in (2.0, 6.0) for phase in (0.0, pi / 2)
        )

    @property
    def _most(self) -> float:
        return _MOST_PERIODS if self.machine.turns(self.where) else 1 / 1e-3

    @property
    def _rate(self) -> float:
        """Phase per unit of position of one period per turn or per metre [1, rad/m]."""
        return 1.0 if self.machine.turns(self.where) else 2 * pi

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add an actuator without input, with the ripple as its cogging."""
        name = added_name(spec, self.where, self.kind)
        amplitude, periods, phase = (float(v) for v in values)
        add_cogging(spec, self.where, name, [amplitude, self._rate * periods, phase])

    def vanishes(self, low: Array, high: Array) -> bool:
        """Return whether the amplitude's interval includes zero."""
        return bool(low[0] <= 0 <= high[0])

    def unseen_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """Joint torque against the ripple."""
        amplitude, periods, phase = values
        return np.asarray(-amplitude * np.sin(self._rate * periods * angle + phase))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose starts by a least-squares periodogram over a fine grid of periods.

        The periodogram is that of Lomb and Scargle. The grid, of phase per unit of position, has
        the resolution of the range of motion. The strongest peaks that are not neighbours become
        starts.
        """
        good = np.isfinite(angle) & np.isfinite(torque)
        every = max(1, int(good.sum()) // _SAMPLES)
        q, force = angle[good][::every], -torque[good][::every]
        width = float(np.ptp(q)) if len(q) else 0.0
        if len(q) < 10 or width <= 0:
            return ()
        lowest = max(0.5, pi / width)
        highest = min(self._rate * self._most, lowest + _TRIED * 0.25 * 2 * pi / width)
        if highest <= lowest:
            return ()
        spacing = 0.25 * 2 * pi / width
        grid = np.arange(lowest, highest, spacing)
        power = lombscargle(q, force - force.mean(), grid, floating_mean=True)
        found: list[tuple[float, ...]] = []
        amplitude, periods, _ = self.parameters
        while len(found) < _PROPOSED and np.any(power > 0):
            best = float(grid[int(np.argmax(power))])
            power[np.abs(grid - best) < 2 * pi / width] = 0.0
            waves = np.stack([np.sin(best * q), np.cos(best * q), np.ones(len(q))], axis=1)
            sine, cosine, _ = np.linalg.lstsq(waves, force, rcond=None)[0]
            found.append(
                (
                    amplitude.clipped(hypot(sine, cosine)),
                    periods.clipped(best / self._rate),
                    atan2(cosine, sine),
                )
            )
        return tuple(found)
