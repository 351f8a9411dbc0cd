"""A payload at the tool."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.effects.geometry import reach_of
from loose_env.gap.effects.joint_effect import added_name
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["Payload"]

Array = NDArray[np.float64]

_RADIUS = 0.01
"""Radius of gyration of the payload, in lengths of the machine."""


class Payload(Effect):
    """A small body at the tool's site."""

    kind = "payload"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """The tool, if its site hangs on a moving link."""
        if not machine.tool:
            return ()
        body = int(machine.model.site_bodyid[machine.model.site(machine.tool).id])
        return ("tool",) if machine.model.body_weldid[body] > 0 else ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its mass."""
        moved = self._moved
        return (Parameter(name="mass", unit="kg", low=0.0, high=20 * moved, scale=0.05 * moved),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A tenth and a half of the mass that the machine moves before its last third."""
        return ((0.05 * self._moved,), (0.3 * self._moved,))

    @property
    def _moved(self) -> float:
        """Mass of all that the first joint moves, over the number of joints [kg]."""
        model = self.machine.model
        first = int(model.jnt_bodyid[0])
        return float(model.body_subtreemass[first]) / len(self.machine.joints)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add a body to the one that carries the tool."""
        mass = float(values[0])
        if mass <= 0:
            return
        site = spec.site(self.machine.tool)
        place = np.array(site.pos)
        if site.frame is not None or not np.isfinite(place).all():
            place = self.machine.model.site_pos[self.machine.model.site(site.name).id]
        body = site.parent.add_body(name=added_name("tool", self.kind), pos=place)
        body.mass, body.ipos = mass, [0, 0, 0]
        body.inertia = [mass * (_RADIUS * reach_of(self.machine)) ** 2] * 3
        body.explicitinertial = True
