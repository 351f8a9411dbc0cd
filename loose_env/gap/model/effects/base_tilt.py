"""A base that does not stand upright: gravity comes from another direction."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.geometry import normal_of
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.model.parameter import Parameter

__all__ = ["BaseTilt"]

Array = NDArray[np.float64]


class BaseTilt(Effect):
    """Gravity turned about axes across it, seen from the base.

    Two axes; one where the arm moves in a plane that holds gravity, for a small tilt out of that
    plane changes nothing. A tilt is named after the world axis nearest to its own.
    """

    kind = "base_tilt"
    acts_on: ClassVar[str] = "arm"
    adds_up: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """The base, if there is gravity."""
        off = machine.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        weightless = off or not np.any(machine.model.opt.gravity)
        return () if weightless else ("base",)

    def __init__(self, machine: Machine, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        down = machine.model.opt.gravity / np.linalg.norm(machine.model.opt.gravity)
        normal = normal_of(machine)
        if normal is not None and abs(normal @ down) < 1e-6:
            self._axes = normal[None]
        else:
            # The two world axes farthest from gravity, made perpendicular to it and each other.
            first, second = (np.eye(3)[k] for k in np.sort(np.argsort(np.abs(down))[:2]))
            first = first - down * (first @ down)
            first /= np.linalg.norm(first)
            across = np.cross(down, first)
            self._axes = np.array([first, np.copysign(1.0, across @ second) * across])
        self.nothing = (0.0,) * len(self._axes)  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Angle about each axis."""
        return tuple(
            Parameter(
                name=f"tilt_{'xyz'[int(np.argmax(np.abs(axis)))]}",
                unit="rad", low=-0.8, high=0.8, scale=0.02,
            )
            for axis in self._axes
        )  # fmt: skip

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Two degrees about every axis."""
        return ((0.04,) * len(self._axes),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Turn gravity."""
        turn = Rotation.from_rotvec(np.asarray(values, dtype=float) @ self._axes)
        # The base turns one way, gravity as seen from it the other way.
        spec.option.gravity = turn.inv().apply(np.array(spec.option.gravity))
