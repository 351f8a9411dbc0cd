"""A vector sensor that is mounted askew."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loose_env.gap.effect import Effect, Readings
from loose_env.gap.effects.joint_effect import added_name
from loose_env.gap.effects.sensor_kinds import column_of, vectors
from loose_env.gap.machine import Machine
from loose_env.gap.parameter import Parameter

__all__ = ["SensorMisalignment"]

Array = NDArray[np.float64]


class SensorMisalignment(Effect):
    """The sensor's site is turned by a rotation vector, given in the site's own frame."""

    kind = "sensor_misalignment"
    acts_on: ClassVar[str] = "sensor"
    nothing: ClassVar[tuple[float, ...] | None] = (0.0, 0.0, 0.0)
    adds_up: ClassVar[bool] = True

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Every sensor of three axes that is fixed to a site."""
        return vectors(machine)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The rotation vector."""
        return tuple(
            Parameter(name=f"turn_{axis}", unit="rad", low=-1.6, high=1.6, scale=0.05)
            for axis in "xyz"
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Three degrees about every axis at once: small turns add up."""
        return ((0.05, 0.05, 0.05),)

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Show the vector in the turned frame."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        turn = Rotation.from_rotvec(np.asarray(values, dtype=float)).as_matrix()
        return {**readings, column: readings[column] @ turn}

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Move the sensor to a site of its own, turned."""
        sensor, model = spec.sensor(self.where), self.machine.model
        site = spec.site(sensor.objname)
        place, turned = np.array(site.pos), np.array(site.quat)
        if any(model.site(k).name == site.name for k in range(model.nsite)):
            # with angles worked out; one that was turned before is written as a quaternion
            number = model.site(site.name).id
            turned = model.site_quat[number]
            if site.frame is not None or not np.isfinite(place).all():
                place = model.site_pos[number]
        askew = added_name(spec, self.where, self.kind)
        x, y, z, w = (
            Rotation.from_quat(turned, scalar_first=True)
            * Rotation.from_rotvec(np.asarray(values, dtype=float))
        ).as_quat()
        site.parent.add_site(name=askew, pos=place, quat=[w, x, y, z])
        sensor.objname = askew
