"""A payload at the tool."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.effects.geometry import link_ends, reach_of
from loose_env.gap.effects.joint_effect import added_name
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["Payload", "payload_words"]

Array = NDArray[np.float64]

_RADIUS = 0.01
"""Radius of gyration of the payload, in lengths of the machine."""


class Payload(Effect):
    """A small body at the tool's site; without a site, at the end of the last link."""

    kind = "payload"
    acts_on: ClassVar[str] = "arm"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0,)

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """The tool."""
        return ("tool",)

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

    def displaced_mass(self, values: Array) -> float:
        """Its mass."""
        return float(values[0])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add a body to the one that carries the tool."""
        mass = float(values[0])
        if mass <= 0:
            return
        if self.machine.tool:
            site = spec.site(self.machine.tool)
            place, carrier = np.array(site.pos), site.parent
            if site.frame is not None or not np.isfinite(place).all():
                place = self.machine.model.site_pos[self.machine.model.site(site.name).id]
        else:
            name, place = _outermost(self.machine)
            carrier = spec.body(name)
        body = carrier.add_body(name=added_name(spec, "tool", self.kind), pos=place)
        body.mass, body.ipos = mass, [0, 0, 0]
        body.inertia = [mass * (_RADIUS * reach_of(self.machine)) ** 2] * 3
        body.explicitinertial = True


def payload_words(machine: Machine) -> list[str]:
    """A sentence on where a payload is tried in a model without a site at its tool; else none."""
    model = machine.model
    if machine.tool:
        carrier = model.site(machine.tool).bodyid[0]
        link = str(model.body(int(model.body_weldid[carrier])).name)
        if machine.tool == "tool" or link == machine.last_link:
            return []
        return [
            f"the model has no site at the end of its last link: a payload is tried at "
            f'{machine.tool} of {link}; add <site name="tool"/> where it hangs'
        ]
    name, place = _outermost(machine)
    where = "the origin" if not place.any() else "the far end"
    return [
        f"the model has no site at its tool: a payload is tried at {where} of {name}, and its mass "
        'stands for that place; add <site name="tool"/> where it hangs'
    ]


def _outermost(machine: Machine) -> tuple[str, Array]:
    """Body that stands for the tool, with a place in its frame (3,) [m]."""
    model, last = machine.model, machine.model.body(machine.last_link).id
    fixed = [b for b in range(last + 1, model.nbody) if model.body_weldid[b] == last]
    if fixed:
        return str(model.body(fixed[-1]).name), np.zeros(3)
    return machine.last_link, link_ends(machine, machine.last_link)[1]
