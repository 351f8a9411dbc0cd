"""Effects of sensors: bias, gain, quantisation, delay, misalignment, and encoder offset.

An encoder offset shifts the zero of a joint's reading and of its servo.
"""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.gap.model.effect import Effect, Readings
from loose_env.gap.model.effects.drives.actuators import held_delay
from loose_env.gap.model.effects.mjcf.joint_effect import JointEffect, added_name, angle_unit
from loose_env.gap.model.effects.mjcf.sensor_columns import (
    column_of,
    is_position_or_speed,
    reading_scale,
    vectors,
)
from loose_env.gap.model.nominal_model import NominalModel, history_for
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_AXES = {1: ("bias",), 3: ("bias_x", "bias_y", "bias_z")}


class SensorBias(Effect):
    """Constant bias of a sensor, one for each axis; servos see the joint itself."""

    kind = "sensor_bias"
    acts_on: ClassVar[str] = "sensor"
    in_model: ClassVar[bool] = False
    is_additive: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return sensors of one axis or three."""
        dims = machine.model.sensor_dim
        return tuple(n for k, n in enumerate(machine.sensors) if n and int(dims[k]) in _AXES)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        self._size = int(machine.model.sensor(where).dim[0])
        self.null_values = (0.0,) * self._size  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Bias of each axis."""
        scale, unit = reading_scale(self.machine, self.where)
        return tuple(
            Parameter(name=name, unit=unit, low=-500 * scale, high=500 * scale, scale=scale)
            for name in _AXES[self._size]
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: visible on every axis."""
        scale, _ = reading_scale(self.machine, self.where)
        return ((scale,) * self._size,)

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Add to the sensor's column."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        bias = values[0] if self._size == 1 else np.asarray(values)
        return {**readings, column: readings[column] + bias}

    def code(self, values: Array) -> str:
        """Python line: the reading plus the bias."""
        return f"data.sensor({self.where!r}).data += {[float(v) for v in values]}"


_NEGLIGIBLE = 1e-3
"""Error of a gain that no sensor is calibrated to."""


class SensorGain(Effect):
    """Gain of a sensor: a factor on its reading; servos see the joint itself."""

    kind = "sensor_gain"
    acts_on: ClassVar[str] = "sensor"
    in_model: ClassVar[bool] = False
    null_values: ClassVar[tuple[float, ...] | None] = (1.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every sensor."""
        return tuple(name for name in machine.sensors if name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Gain factor."""
        return (Parameter(name="gain", unit="", low=0.1, high=10.0, scale=0.05),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a tenth less and more."""
        return ((0.9,), (1.1,))

    def is_negligible(self, values: Array) -> bool:
        """Return whether the gain is within the accuracy of sensor calibration."""
        return abs(float(values[0]) - 1.0) < _NEGLIGIBLE

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Scale the sensor's column."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        return {**readings, column: float(values[0]) * readings[column]}

    def code(self, values: Array) -> str:
        """Python line: the reading times the gain."""
        return f"data.sensor({self.where!r}).data *= {float(values[0])!r}"


_STEPS = (0.2, 1.0)
"""Steps of a sensor from which fits start where the data show none, over a change that matters."""


class SensorQuantisation(Effect):
    """Quantisation of a sensor: its reading is rounded to whole steps; servos see the joint itself.

    The step is found in the readings: their distances are multiples of it.
    """

    kind = "sensor_quantisation"
    acts_on: ClassVar[str] = "sensor"
    in_model: ClassVar[bool] = False
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("step", "low"),)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return sensors of one axis."""
        dims = machine.model.sensor_dim
        return tuple(n for k, n in enumerate(machine.sensors) if n and int(dims[k]) == 1)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Step of the reading."""
        scale, unit = reading_scale(self.machine, self.where)
        low, high = 1e-4 * scale, 1e3 * scale
        return (Parameter(name="step", unit=unit, low=low, high=high, scale=scale, log=True),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: visible steps."""
        scale, _ = reading_scale(self.machine, self.where)
        return tuple((share * scale,) for share in _STEPS)

    def propose_from(self, resolution: float) -> tuple[tuple[float, ...], ...]:
        """Propose the step that the readings show."""
        return ((self.parameters[0].clipped(resolution),),) if resolution > 0 else ()

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Round the sensor's column."""
        column, step = column_of(self.where), float(values[0])
        if column not in readings:
            return readings
        return {**readings, column: step * np.round(readings[column] / step)}

    def code(self, values: Array) -> str:
        """Python lines: the reading in whole steps."""
        step = float(values[0])
        return (
            "import numpy as np\n"
            f"data.sensor({self.where!r}).data[:] = "
            f"{step!r} * np.round(data.sensor({self.where!r}).data / {step!r})"
        )


_LONGEST = 0.25
"""Longest delay that is tried [s]."""


class SensorDelay(Effect):
    """Delay of a sensor; servos see the joint itself, undelayed.

    Exported as MuJoCo's own sensor delay.
    """

    kind = "sensor_delay"
    acts_on: ClassVar[str] = "sensor"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)
    is_time_shift: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return every sensor."""
        return tuple(name for name in machine.sensors if name)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sensor delay."""
        return (Parameter(name="delay", unit="s", low=0.0, high=_LONGEST, scale=0.01),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts from a fast bus to that of hobby servos."""
        return ((0.001,), (0.003,), (0.008,), (0.02,), (0.05,), (0.12,))

    @property
    def _jumps(self) -> bool:
        """True if the reading is no position or speed and has no delay in the model."""
        spec_sensor = self.machine.spec.sensor(self.where)
        smooth = is_position_or_speed(self.machine, column_of(self.where))
        return not smooth and float(spec_sensor.delay) == 0.0

    def sensor_delay(self, values: Array) -> tuple[str, float] | None:
        """Return the delay of an acceleration or a force."""
        return (self.where, float(values[0])) if self._jumps else None

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Shift the column of a position or a speed."""
        column = column_of(self.where)
        if column not in readings or values[0] <= 0 or self._jumps:
            return readings
        vector = int(self.machine.model.sensor(self.where).dim[0]) > 1
        late = delayed(time, readings[column], float(values[0]), axis=-2 if vector else -1)
        return {**readings, column: late}

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Export as a history and a delay of the sensor, on top of its existing delay."""
        if values[0] <= 0:
            return
        sensor, step = spec.sensor(self.where), float(spec.option.timestep)
        own = float(sensor.delay) if sensor.interp else held_delay(float(sensor.delay), step)
        sensor.delay, sensor.interp = own + float(values[0]), 1
        sensor.nsample = max(history_for(sensor.delay, step), int(sensor.nsample))


def delayed(time: Array, values: Array, delay: float, *, axis: int = -1) -> Array:
    """Delay values, linear between samples; the first one is held before the start.

    Examples
    --------
    >>> delayed(np.arange(4.0), np.array([0.0, 2.0, 4.0, 6.0]), 0.5)
    array([0., 1., 3., 5.])
    """
    at = np.interp(time - delay, time, np.arange(len(time), dtype=float))
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(time) - 1)
    moved = np.moveaxis(values, axis, -1)
    share = at - low
    return np.moveaxis(moved[..., low] * (1 - share) + moved[..., high] * share, -1, axis)


class SensorMisalignment(Effect):
    """Misalignment of a vector sensor: a rotation vector in the site's own frame."""

    kind = "sensor_misalignment"
    acts_on: ClassVar[str] = "sensor"
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0, 0.0)
    is_additive: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return sensors of three axes that are fixed to a site."""
        return vectors(machine)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Rotation vector."""
        return tuple(
            Parameter(name=f"turn_{axis}", unit="rad", low=-1.6, high=1.6, scale=0.05)
            for axis in "xyz"
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: three degrees about every axis at once, as small rotations add up."""
        return ((0.05, 0.05, 0.05),)

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Rotate the vector to the misaligned frame."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        turn = Rotation.from_rotvec(np.asarray(values, dtype=float)).as_matrix()
        return {**readings, column: readings[column] @ turn}

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Move the sensor to a rotated site of its own."""
        sensor, model = spec.sensor(self.where), self.machine.model
        site = spec.site(sensor.objname)
        place, turned = np.array(site.pos), np.array(site.quat)
        if any(model.site(k).name == site.name for k in range(model.nsite)):
            # with angles resolved; one that was rotated before is written as a quaternion
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


class EncoderOffset(JointEffect):
    """Encoder offset: the joint's coordinate is the true one plus a constant.

    The reading and the servo use the coordinate; the links, the joint's stops and its spring stay
    at their positions.
    """

    kind = "encoder_offset"
    exact_law: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Offset: reading minus truth."""
        if self.machine.turns(self.where):
            return (Parameter(name="offset", unit="rad", low=-1.0, high=1.0, scale=0.02),)
        return (Parameter(name="offset", unit="m", low=-0.3, high=0.3, scale=0.005),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: visible, of either sign."""
        scale = self.parameters[0].scale
        return ((-scale,), (scale,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Shift the joint's reference, range and spring."""
        joint = spec.joint(self.where)
        offset = float(values[0]) / angle_unit(joint)
        joint.ref += offset
        joint.springref += offset
        if self.machine.model.jnt_limited[self.machine.joint_number(self.where)]:
            joint.range = np.array(joint.range) + offset
