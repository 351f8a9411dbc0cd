"""Effects of sensors: bias, gain, quantisation, delay, misalignment, offset, eccentricity."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.gap.model.effect import (
    AdditiveEffect,
    DrivenEffect,
    Effect,
    JointEffect,
    Parameter,
    Readings,
)
from loose_env.gap.model.effects.drives import DELAY, delay_by, held_delay
from loose_env.gap.model.effects.mjcf import added_name, angle_unit, site_pose
from loose_env.gap.model.nominal_model import NominalModel, named
from loose_env.recording import joint_sensors
from loose_env.typing import Array

_S = mujoco.mjtSensor
_TURNING = (
    _S.mjSENS_ACCELEROMETER, _S.mjSENS_GYRO, _S.mjSENS_VELOCIMETER, _S.mjSENS_FORCE,
    _S.mjSENS_TORQUE, _S.mjSENS_MAGNETOMETER,
)  # fmt: skip
"""Vectors in the frame of their site."""


def column_of(sensor: str) -> str:
    """Column of a sensor, without axis."""
    return f"sensor.{sensor}"


_QUANTITIES = {
    _S.mjSENS_JOINTPOS: ("joint position", "rad", "m"),
    _S.mjSENS_ACTUATORPOS: ("drive position", "rad", "m"),
    _S.mjSENS_JOINTVEL: ("joint speed", "rad/s", "m/s"),
    _S.mjSENS_ACTUATORVEL: ("drive speed", "rad/s", "m/s"),
    _S.mjSENS_ACTUATORFRC: ("drive torque", "N·m", "N"),
    _S.mjSENS_JOINTACTFRC: ("actuator torque", "N·m", "N"),
    _S.mjSENS_ACCELEROMETER: ("acceleration", "m/s²"),
    _S.mjSENS_FRAMELINACC: ("acceleration", "m/s²"),
    _S.mjSENS_GYRO: ("turning rate", "rad/s"),
    _S.mjSENS_FRAMEANGVEL: ("turning rate", "rad/s"),
    _S.mjSENS_FRAMEPOS: ("position in space", "m"),
    _S.mjSENS_VELOCIMETER: ("speed in space", "m/s"),
    _S.mjSENS_FORCE: ("force", "N"),
    _S.mjSENS_TORQUE: ("torque at a site", "N·m"),
}
"""Quantity and unit; at a joint its unit where that turns, and where it slides."""


def quantity_of(machine: NominalModel, sensor: str) -> tuple[str, str]:
    """Quantity of a sensor and its unit; "" of one that is not known."""
    model, own = machine.model, machine.model.sensor(sensor)
    words, *units = _QUANTITIES.get(_S(int(own.type[0])), ("", ""))
    if len(units) == 2:
        number = int(own.objid[0])
        if int(own.objtype[0]) == mujoco.mjtObj.mjOBJ_ACTUATOR:
            if int(model.actuator_trntype[number]) != mujoco.mjtTrn.mjTRN_JOINT:
                return "", ""
            number = int(model.actuator_trnid[number, 0])
        units = units[not machine.turns(model.joint(number).name) :]
    return words, units[0]


def _reading_scale(machine: NominalModel, sensor: str) -> tuple[float, str]:
    """Return the smallest change of a reading that matters, and its unit."""
    own = machine.model.sensor(sensor)
    at_joint = int(own.objtype[0]) == mujoco.mjtObj.mjOBJ_JOINT
    joint = own.objid if at_joint else slice(None)
    load, speed = (float(x[joint].max()) for x in (machine.load_scales, machine.speed_scales))
    speeds = _S.mjSENS_JOINTVEL, _S.mjSENS_GYRO, _S.mjSENS_VELOCIMETER
    loads = (
        _S.mjSENS_FORCE, _S.mjSENS_TORQUE, _S.mjSENS_JOINTACTFRC, _S.mjSENS_ACTUATORFRC,
    )  # fmt: skip
    sizes = {
        _S.mjSENS_JOINTPOS: 0.01, _S.mjSENS_ACCELEROMETER: 0.2, _S.mjSENS_FRAMELINACC: 0.2,
        _S.mjSENS_FRAMEPOS: 0.005, **dict.fromkeys(speeds, 0.05 * speed),
        **dict.fromkeys(loads, 0.05 * load),
    }  # fmt: skip
    return sizes.get(_S(int(own.type[0])), 0.05), quantity_of(machine, sensor)[1]


class SensorEffect(Effect):
    """An effect on the reading of a sensor; servos see the joint itself, without it."""

    acts_on = "sensor"
    in_model = False
    dims: ClassVar[tuple[int, ...]] = ()
    """Numbers of axes of the sensors that can have it; all without."""

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return sensors with so many axes."""
        dims = machine.model.sensor_dim
        return named(machine.sensors, np.isin(dims, cls.dims or dims))

    @property
    def dim(self) -> int:
        """Axes of the sensor."""
        return int(self.machine.model.sensor(self.where).dim[0])

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Change the sensor's column."""
        column = column_of(self.where)
        if column not in readings:
            return readings
        return {**readings, column: self.shown(time, readings[column], values)}

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Reading with the effect (..., T) of a scalar, (..., T, 3) of a vector."""
        raise NotImplementedError


class SensorBias(AdditiveEffect, SensorEffect):
    """Constant bias of a sensor, one for each axis."""

    kind = "sensor_bias"
    dims = (1, 3)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Bias of each axis."""
        size, unit = _reading_scale(self.machine, self.where)
        bias = Parameter.sized("", unit, size, -500, 500, scale=1.0, starts=(1.0,))
        names = ("bias",) if self.dim == 1 else ("bias_x", "bias_y", "bias_z")
        return tuple(replace(bias, name=name) for name in names)

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Add the bias."""
        return np.asarray(reading + (values[0] if self.dim == 1 else np.asarray(values)))

    def code(self, values: Array) -> str:
        """Python line: the reading plus the bias."""
        return f"data.sensor({self.where!r}).data += {[float(v) for v in values]}"


class SensorGain(SensorEffect):
    """Gain of a sensor: a factor on its reading."""

    kind = "sensor_gain"
    null_values = (1.0,)
    parameters = (Parameter.sized("gain", "", 1.0, 0.1, 10, scale=0.05, starts=(0.9, 1.1)),)

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Scale the reading."""
        return float(values[0]) * reading

    def code(self, values: Array) -> str:
        """Python line: the reading times the gain."""
        return f"data.sensor({self.where!r}).data *= {float(values[0])!r}"


class SensorQuantisation(SensorEffect):
    """Quantisation of a sensor: its reading is rounded to whole steps."""

    kind = "sensor_quantisation"
    is_read_off = True
    limit = (("step", "low"),)
    dims = (1,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Step of the reading."""
        size, unit = _reading_scale(self.machine, self.where)
        step = Parameter.sized("step", unit, size, 1e-4, 1e3, scale=1, starts=(0.2, 1), log=True)
        return (step,)

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Round the reading."""
        step = float(values[0])
        return np.asarray(step * np.round(reading / step))

    def code(self, values: Array) -> str:
        """Python lines: the reading in whole steps."""
        step, data = float(values[0]), f"data.sensor({self.where!r}).data"
        return f"import numpy as np\n{data}[:] = {step!r} * np.round({data} / {step!r})"


class SensorDelay(SensorEffect):
    """Delay of a sensor, exported as MuJoCo's own; servos see the joint itself, undelayed."""

    kind = "sensor_delay"
    in_model = True
    null_values = (0.0,)
    is_time_shift = True
    parameters = (DELAY,)

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Shift the reading."""
        if values[0] <= 0:
            return reading
        return delayed(time, reading, float(values[0]), axis=-2 if self.dim > 1 else -1)

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Export as a history and a delay of the sensor, on top of its existing delay."""
        if values[0] <= 0:
            return
        sensor, step = spec.sensor(self.where), float(spec.option.timestep)
        own = float(sensor.delay) if sensor.interp else held_delay(float(sensor.delay), step)
        delay_by(sensor, own + float(values[0]), step)


def delayed(time: Array, values: Array, delay: float, *, axis: int = -1) -> Array:
    """Delay values, linear between samples; the first one is held before the start."""
    at = np.interp(time - delay, time, np.arange(len(time), dtype=float))
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(time) - 1)
    moved = np.moveaxis(values, axis, -1)
    share = at - low
    return np.moveaxis(moved[..., low] * (1 - share) + moved[..., high] * share, -1, axis)


class SensorMisalignment(AdditiveEffect, SensorEffect):
    """Misalignment of a vector sensor: a rotation vector in the site's own frame."""

    kind = "sensor_misalignment"
    in_model = True
    # three degrees about every axis, as small rotations add up
    parameters = tuple(
        Parameter.sized(f"turn_{axis}", "rad", 1.0, -1.6, 1.6, scale=0.05, starts=(0.05,))
        for axis in "xyz"
    )

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return sensors of three axes that are fixed to a site."""
        model = machine.model
        at_site = (model.sensor_objtype == mujoco.mjtObj.mjOBJ_SITE) & (model.sensor_refid < 0)
        return named(machine.sensors, at_site & np.isin(model.sensor_type, _TURNING))

    def shown(self, time: Array, reading: Array, values: Array) -> Array:
        """Rotate the vector to the misaligned frame."""
        return np.asarray(reading @ Rotation.from_rotvec(values).as_matrix())

    def export(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Move the sensor to a rotated site of its own."""
        sensor = spec.sensor(self.where)
        site = spec.site(sensor.objname)
        place, turned = site_pose(self.machine, site)
        askew = added_name(spec, self.where, self.kind)
        turn = Rotation.from_quat(turned, scalar_first=True) * Rotation.from_rotvec(values)
        site.parent.add_site(name=askew, pos=place, quat=turn.as_quat(scalar_first=True))
        sensor.objname = askew


class TorqueConstant(JointEffect):
    """Factor of a joint's measured torque: the drive's current times a wrong constant."""

    kind = "torque_constant"
    exact_law = True
    in_model = False
    null_values = (1.0,)
    parameters = (Parameter.sized("factor", "", 1.0, 0.02, 50, starts=(0.8, 1.25)),)

    def sensed_torque(self, joint: str, torque: Array, values: Array) -> Array:
        """Scale the joint's torque."""
        return torque * float(values[0]) if joint == self.where else torque

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Scale the joint's column of measured torque."""
        column = f"torque.{self.where}"
        if column not in readings:
            return readings
        return {**readings, column: float(values[0]) * readings[column]}

    def code(self, values: Array) -> str:
        """Python line: the measured torque of the joint."""
        torque = f"data.joint({self.where!r}).qfrc_actuator"
        return f"measured_torque_{self.number} = {float(values[0])!r} * {torque}"


class EncoderOffset(JointEffect):
    """Encoder offset: the joint's coordinate is the true one plus a constant.

    The reading and the servo use the coordinate; the links, the joint's stops and its spring stay
    at their positions.
    """

    kind = "encoder_offset"
    exact_law = True
    null_values = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Offset: reading minus truth."""
        most, step = (50, 0.02) if self.turns else (60, 0.005)
        starts = (-1, 1)
        return (
            Parameter.sized("offset", self.angle_unit, step, -most, most, scale=1, starts=starts),
        )

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Shift the joint's reference, range and spring."""
        joint = spec.joint(self.where)
        offset = float(values[0]) / angle_unit(joint)
        joint.ref += offset
        joint.springref += offset
        if self.machine.model.jnt_limited[self.number]:
            joint.range = np.array(joint.range) + offset


class GearEccentricity(DrivenEffect, AdditiveEffect, JointEffect):
    """Once-per-turn error of the measured angle: a gear or a code wheel that turns off its centre.

    The encoder shows q + sine · sin q + cosine · cos q, and the servo closes its loop on that.
    """

    kind = "gear_eccentricity"
    # a third of a degree in either phase, which add up
    parameters = tuple(
        Parameter(name=name, unit="rad", low=-0.1, high=0.1, scale=0.005, starts=(0.005,))
        for name in ("sine", "cosine")
    )

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return hinges with an encoder."""
        sensors = joint_sensors(machine.model)
        return tuple(n for n in machine.joints if machine.turns(n) and sensors[n].position)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        model, own = machine.model, joint_sensors(machine.model)[where]
        self._encoders, self._rates = own.position, own.velocity
        self._servos: list[tuple[int, float, float, float]] = []
        for k, name in enumerate(machine.actuators):
            gain = model.actuator_gainprm[k, 0] or 1.0
            stiff, damped = (model.actuator_biasprm[k, 1:3] / gain).tolist()
            if machine.actuated_joint.get(name) == where and stiff != 0:
                self._servos.append((k, float(model.actuator_gear[k, 0]), stiff, damped))

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Shift the commands of the joint's servos as the shown position and speed do."""
        angle, (sine, cosine) = position[..., self.number], values
        error, slope = _wave(angle, sine, cosine), _wave(angle, -cosine, sine)
        found = command.copy()
        for number, gear, per_angle, per_speed in self._servos:
            shift = per_angle * error + per_speed * slope * speed[..., self.number]
            found[..., number] += gear * shift
        return found

    def feedback_code(self, values: Array) -> str:
        """Python lines: the commands shifted by the error of what the servo sees."""
        joint, (error, slope) = self.number, _waves_code(f"position[{self.number}]", values)
        return "\n".join(
            f"command[{number}] += {gear!r} * ({p!r} * ({error}) + {d!r} * ({slope}) * "
            f"speed[{joint}])"
            for number, gear, p, d in self._servos
        )

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Add the error to the encoder's reading, its rate to that of a speed beside it."""
        found, (sine, cosine) = dict(readings), values
        shown = [c for name in self._encoders if (c := column_of(name)) in readings]
        for column in shown:
            found[column] = readings[column] + _wave(readings[column], sine, cosine)
        for column in map(column_of, self._rates if shown else ()):
            if column in readings:
                found[column] = readings[column] * (1 + _wave(readings[shown[0]], -cosine, sine))
        return found

    def code(self, values: Array) -> str:
        """Python lines: the readings with the error."""
        error, slope = _waves_code("angle", values)
        shown = f"import numpy as np\nangle = float(data.sensor({self._encoders[0]!r}).data[0])"
        rates = (f"data.sensor({name!r}).data *= 1 + {slope}" for name in self._rates)
        angles = (f"data.sensor({name!r}).data += {error}" for name in self._encoders)
        return "\n".join([shown, *rates, *angles])


def _wave(angle: Array, sine: float, cosine: float) -> Array:
    """Error of a shown angle; its slope is that with -cosine and sine in their places."""
    return np.asarray(sine * np.sin(angle) + cosine * np.cos(angle))


def _waves_code(angle: str, values: Array) -> tuple[str, ...]:
    """Python text of error and slope."""
    sine, cosine = map(float, values)
    pairs = (sine, cosine), (-cosine, sine)
    return tuple(f"{a!r} * np.sin({angle}) + {b!r} * np.cos({angle})" for a, b in pairs)
