"""Columns of sensors in a recording, their units, and the smallest change that matters."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.model.nominal_model import NominalModel

_S = mujoco.mjtSensor


def column_of(sensor: str) -> str:
    """Column of a sensor, without axis.

    Examples
    --------
    >>> column_of("joint1_pos")
    'sensor.joint1_pos'
    """
    return f"sensor.{sensor}"


def vectors(machine: NominalModel) -> tuple[str, ...]:
    """Names of the sensors of three axes that are fixed to a site."""
    model = machine.model
    at_site = model.sensor_objtype == mujoco.mjtObj.mjOBJ_SITE
    free = model.sensor_refid < 0
    turning = np.isin(model.sensor_type, [int(kind) for kind in _AT_SITE])
    chosen = at_site & free & turning
    return tuple(name for k, name in enumerate(machine.sensors) if name and chosen[k])


_AT_SITE = (
    _S.mjSENS_ACCELEROMETER,
    _S.mjSENS_GYRO,
    _S.mjSENS_VELOCIMETER,
    _S.mjSENS_FORCE,
    _S.mjSENS_TORQUE,
    _S.mjSENS_MAGNETOMETER,
)


def reading_scale(machine: NominalModel, sensor: str) -> tuple[float, str]:
    """Return the smallest change of a reading that matters, and its unit."""
    model = machine.model
    number = model.sensor(sensor).id
    kind = _S(int(model.sensor_type[number]))
    obj = int(model.sensor_objid[number])
    of_joint = model.sensor_objtype[number] == mujoco.mjtObj.mjOBJ_JOINT
    turns = not of_joint or machine.turns(machine.joints[obj])
    load = machine.load(machine.joints[obj]) if of_joint else float(machine.load_scales.max())
    speed = machine.speed(machine.joints[obj]) if of_joint else float(machine.speed_scales.max())
    scales = {
        _S.mjSENS_JOINTPOS: (0.01, "rad" if turns else "m"),
        _S.mjSENS_JOINTVEL: (0.05 * speed, "rad/s" if turns else "m/s"),
        _S.mjSENS_ACCELEROMETER: (0.2, "m/s²"),
        _S.mjSENS_GYRO: (0.05 * speed, "rad/s"),
        _S.mjSENS_VELOCIMETER: (0.05 * speed, "m/s"),
        _S.mjSENS_FORCE: (0.05 * load, "N"),
        _S.mjSENS_TORQUE: (0.05 * load, "N·m"),
        _S.mjSENS_JOINTACTFRC: (0.05 * load, "N·m" if turns else "N"),
        _S.mjSENS_ACTUATORFRC: (0.05 * load, ""),
        _S.mjSENS_FRAMELINACC: (0.2, "m/s²"),
        _S.mjSENS_FRAMEPOS: (0.005, "m"),
    }
    return scales.get(kind, (0.05, ""))


def is_position_or_speed(machine: NominalModel, column: str) -> bool:
    """Return whether a column is a position or a speed, not an acceleration or force."""
    kind, _, name = column.partition(".")
    return kind == "sensor" and int(machine.model.sensor(name).type[0]) in _SMOOTH


_SMOOTH = tuple(
    int(kind)
    for kind in (
        _S.mjSENS_JOINTPOS,
        _S.mjSENS_JOINTVEL,
        _S.mjSENS_FRAMEPOS,
        _S.mjSENS_FRAMELINVEL,
        _S.mjSENS_FRAMEANGVEL,
        _S.mjSENS_VELOCIMETER,
        _S.mjSENS_GYRO,
    )
)
