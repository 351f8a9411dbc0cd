"""Centre of mass of a link."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.effects.geometry import link_ends, normal_of, reach_of
from loose_env.gap.effects.inertials import inertial_of, set_inertial
from loose_env.gap.effects.link_mass import links_with_mass
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["LinkCom"]

Array = NDArray[np.float64]


class LinkCom(Effect):
    """The centre of mass lies elsewhere, along the body's axes; mass and inertia about it stay.

    Of a machine that moves in a plane only the shift in the plane counts; an axis of the body that
    is perpendicular to the plane has no parameter.
    """

    kind = "link_com"
    acts_on: ClassVar[str] = "link"
    adds_up: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every link that has mass."""
        return links_with_mass(machine)

    def __init__(self, machine: Machine, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        self._axes: tuple[int, ...] = (0, 1, 2)
        normal = normal_of(machine)
        if normal is not None:
            data = mujoco.MjData(machine.model)
            mujoco.mj_kinematics(machine.model, data)
            along = data.body(where).xmat.reshape(3, 3).T @ normal
            self._axes = tuple(k for k in range(3) if abs(along[k]) < 1 - 1e-6)
        self.nothing = (0.0,) * len(self._axes)  # type: ignore[misc]
        start, end = link_ends(machine, where)
        self._length = max(float(np.linalg.norm(end - start)), 0.05 * reach_of(machine))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Shift along the body's axes."""
        return tuple(
            Parameter(
                name="xyz"[k],
                unit="m",
                low=-1.5 * self._length,
                high=1.5 * self._length,
                scale=0.1 * self._length,
            )
            for k in self._axes
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """A tenth of the link's length along one axis after the other."""
        return tuple(tuple(row) for row in 0.1 * self._length * np.eye(len(self._axes)))

    def displaced_mass(self, values: Array) -> float:
        """The link's mass, by as much of its length as the centre shifts."""
        own = float(self.machine.model.body(self.where).mass[0])
        return own * float(np.linalg.norm(values)) / self._length

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Shift the link's centre."""
        old = inertial_of(self.machine, spec, self.where)
        centre = old.centre.copy()
        centre[list(self._axes)] += np.asarray(values, dtype=float)
        set_inertial(self.machine, spec, self.where, replace(old, centre=centre))
