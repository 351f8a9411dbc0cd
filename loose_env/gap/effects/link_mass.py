"""Mass of a link."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.effects.inertials import Inertial, inertial_of, set_inertial
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["LinkMass", "links_with_mass"]

Array = NDArray[np.float64]


def links_with_mass(machine: Machine) -> tuple[str, ...]:
    """Names of the links that have mass of their own."""
    mass = machine.model.body_mass
    return tuple(name for name in machine.links if mass[machine.model.body(name).id] > 0)


class LinkMass(Effect):
    """Mass added to a link where its own lies; its inertia grows in proportion."""

    kind = "link_mass"
    acts_on: ClassVar[str] = "link"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every link that has mass."""
        return links_with_mass(machine)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The mass added."""
        own = self._own
        return (Parameter(name="mass", unit="kg", low=-0.9 * own, high=20 * own, scale=0.1 * own),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A quarter less and more."""
        return ((-0.25 * self._own,), (0.25 * self._own,))

    @property
    def _own(self) -> float:
        return float(self.machine.model.body(self.where).mass[0])

    def displaced_mass(self, values: Array) -> float:
        """The mass added, or taken away."""
        return abs(float(values[0]))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Scale the link's mass and inertia."""
        old = inertial_of(self.machine, spec, self.where)
        factor = max(1.0 + float(values[0]) / old.mass, 0.01)
        scaled = Inertial(factor * old.mass, old.centre, factor * old.tensor)
        set_inertial(self.machine, spec, self.where, scaled)
