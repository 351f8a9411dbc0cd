"""RMS errors in physical units by quantity, also as text; noise ratio of two comparisons."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Channel
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.typing import Array

_SENSOR = mujoco.mjtSensor
_OF_A_JOINT = {
    _SENSOR.mjSENS_JOINTPOS: ("joint position", "rad", "m"),
    _SENSOR.mjSENS_ACTUATORPOS: ("drive position", "rad", "m"),
    _SENSOR.mjSENS_JOINTVEL: ("joint speed", "rad/s", "m/s"),
    _SENSOR.mjSENS_ACTUATORVEL: ("drive speed", "rad/s", "m/s"),
    _SENSOR.mjSENS_ACTUATORFRC: ("drive torque", "N·m", "N"),
    _SENSOR.mjSENS_JOINTACTFRC: ("joint torque", "N·m", "N"),
}
"""Quantity, its unit where the joint turns, and where it slides."""
_OF_A_SITE = {
    _SENSOR.mjSENS_ACCELEROMETER: ("acceleration", "m/s²"),
    _SENSOR.mjSENS_FRAMELINACC: ("acceleration", "m/s²"),
    _SENSOR.mjSENS_GYRO: ("turning rate", "rad/s"),
    _SENSOR.mjSENS_FRAMEANGVEL: ("turning rate", "rad/s"),
    _SENSOR.mjSENS_FRAMEPOS: ("position in space", "m"),
    _SENSOR.mjSENS_VELOCIMETER: ("speed in space", "m/s"),
    _SENSOR.mjSENS_FORCE: ("force", "N"),
    _SENSOR.mjSENS_TORQUE: ("torque at a site", "N·m"),
}


def quantity_of(machine: NominalModel, channel: Channel) -> str | None:
    """Quantity and unit of a channel; None for a sensor of unknown unit.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> machine = NominalModel(planar(2).spec)
    >>> quantity_of(machine, Channel(column=f"torque.{machine.joints[0]}"))
    'joint torque [N·m]'
    """
    model = machine.model
    source, _, name = channel.column.partition(".")
    if source == "torque":
        return f"joint torque [{_unit(model, model.joint(name).id, 'N·m', 'N')}]"
    sensor = model.sensor(name)
    kind, number = mujoco.mjtSensor(int(sensor.type[0])), int(sensor.objid[0])
    if kind in _OF_A_SITE:
        return "{} [{}]".format(*_OF_A_SITE[kind])
    if kind not in _OF_A_JOINT:
        return None
    words, turning, sliding = _OF_A_JOINT[kind]
    if int(sensor.objtype[0]) == mujoco.mjtObj.mjOBJ_ACTUATOR:
        if int(model.actuator_trntype[number]) != mujoco.mjtTrn.mjTRN_JOINT:
            return None
        number = int(model.actuator_trnid[number, 0])
    return f"{words} [{_unit(model, number, turning, sliding)}]"


def errors_by_quantity(
    machine: NominalModel,
    comparison: ResidualModel,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> dict[str, tuple[float, float]]:
    """Root mean square errors in physical units, pooled by quantity."""
    rows, found = comparison.rows, {}
    of_channel = np.array([quantity_of(machine, c) or "" for c in comparison.channels])
    scale = comparison.scales[rows.trial, rows.channel]
    for quantity in dict.fromkeys(of_channel):
        own = (of_channel[rows.channel] == quantity) & ~rows.is_feature
        if quantity and own.any():
            found[str(quantity)] = (rms(before[own] * scale[own]), rms(after[own] * scale[own]))
    return found


def quantity_notes(errors: Mapping[str, tuple[float, float]]) -> list[str]:
    """Format errors before and after the correction as text.

    Examples
    --------
    >>> quantity_notes({"joint position [rad]": (0.0433, 0.01678)})
    ['joint position: 0.0433 rad before, 0.0168 rad after']
    """
    found = []
    for quantity, (before, after) in errors.items():
        name, _, unit = quantity.rstrip("]").partition(" [")
        found.append(f"{name}: {before:.3g} {unit} before, {after:.3g} {unit} after")
    return found


def _unit(model: mujoco.MjModel, joint: int, turning: str, sliding: str) -> str:
    slides = int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_SLIDE
    return sliding if slides else turning


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square (N,)."""
    return float(np.sqrt(np.mean(values**2)))


def noise_ratio(own: ResidualModel, runs: ResidualModel) -> Array:
    """Ratio of the noise of two comparisons, for each number of the same runs (N,).

    Features use their own standard deviation, however noisy the channels they are computed from.
    """
    found: Array = (own.scales / runs.scales)[runs.rows.trial, runs.rows.channel]
    found[runs.rows.is_feature] = 1.0
    return found
