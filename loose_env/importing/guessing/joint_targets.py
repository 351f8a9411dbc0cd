"""Columns of a recording that belong to each joint of a model; inverse-dynamics torques."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.recording import ModelColumns, joint_sensors
from loose_env.typing import Array

Drive = Literal["position", "velocity", "torque"]
"""Quantity that an actuator's control commands."""


@dataclass(frozen=True, kw_only=True)
class JointTarget:
    """A joint, and the columns of a recording that belong to it; "" where the model has none."""

    name: str
    slide: bool
    limits: tuple[float, float] | None
    """Limits of its position [rad or m]."""
    position: str
    velocity: str
    torque: str
    command: str
    drive: Drive


def joint_targets(model: mujoco.MjModel) -> list[JointTarget]:
    """List the joints with one coordinate and a name, in the model's order."""
    known = ModelColumns.of(model).known
    found = []
    for name, sensors in joint_sensors(model).items():
        joint = model.joint(name).id
        limited = bool(model.jnt_limited[joint])
        low, high = model.jnt_range[joint]
        actuator = _actuator(model, joint)
        command = "" if actuator is None else f"ctrl.{model.actuator(actuator).name}"
        torque = f"torque.{name}"
        found.append(
            JointTarget(
                name=name,
                slide=model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE,
                limits=(float(low), float(high)) if limited else None,
                position=f"sensor.{sensors.position[0]}" if sensors.position else "",
                velocity=f"sensor.{sensors.velocity[0]}" if sensors.velocity else "",
                torque=torque if torque in known else "",
                command=command if command in known else "",
                drive="torque" if actuator is None else _drive(model, actuator),
            )
        )
    return found


def accelerometer_axes(model: mujoco.MjModel) -> dict[str, str]:
    """Columns of the model's accelerometer by axis, where it has exactly one."""
    kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
    ids = np.flatnonzero(model.sensor_type == kind)
    name = model.sensor(int(ids[0])).name if len(ids) == 1 else ""
    return {axis: f"sensor.{name}.{axis}" for axis in "xyz"} if name else {}


def inverse_torques(model: mujoco.MjModel, joints: dict[str, Array], step: float) -> Array | None:
    """Torques that the model needs for a measured motion [N·m or N]."""
    if model.nq != model.nv or model.nv == 0:
        return None
    if {model.joint(j).name for j in range(model.njnt)} != set(joints):
        return None
    position = np.stack([joints[model.joint(j).name] for j in range(model.njnt)], axis=1)
    velocity = np.gradient(position, step, axis=0)
    acceleration = np.gradient(velocity, step, axis=0)
    data = mujoco.MjData(model)
    found = np.empty_like(position)
    for i in range(len(position)):
        data.qpos[:], data.qvel[:], data.qacc[:] = position[i], velocity[i], acceleration[i]
        mujoco.mj_inverse(model, data)
        found[i] = data.qfrc_inverse
    return found


def _actuator(model: mujoco.MjModel, joint: int) -> int | None:
    """The only actuator of a joint; None where it has none or several."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    own = [
        i
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) in kinds and model.actuator_trnid[i, 0] == joint
    ]
    return own[0] if len(own) == 1 else None


def _drive(model: mujoco.MjModel, actuator: int) -> Drive:
    bias = model.actuator_biasprm[actuator]
    if model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_AFFINE:
        return "torque"
    return "position" if bias[1] else "velocity" if bias[2] else "torque"
