"""Columns of a recording that belong to each joint of a model; inverse-dynamics torques."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from scipy import ndimage

from loose_env.importing.evidence import Signal
from loose_env.importing.units import quantity_of
from loose_env.recording import ModelColumns, joint_sensors
from loose_env.sensors import STANDARD_GRAVITY
from loose_env.typing import Array

SMOOTHED = 9
"""Samples over which positions are averaged before they are differentiated twice."""
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

    @property
    def columns(self) -> tuple[str, str, str, str]:
        """All of its columns."""
        return self.position, self.velocity, self.torque, self.command


def joint_targets(model: mujoco.MjModel) -> list[JointTarget]:
    """List the joints with one coordinate and a name, in the model's order."""
    known = ModelColumns.of(model).known
    found = []
    for name, sensors in joint_sensors(model).items():
        joint = model.joint(name).id
        low, high = map(float, model.jnt_range[joint])
        drive, kind = _drive(model, joint)
        columns = {
            "position": f"sensor.{sensors.position[0]}" if sensors.position else "",
            "velocity": f"sensor.{sensors.velocity[0]}" if sensors.velocity else "",
            "torque": f"torque.{name}",
            "command": f"ctrl.{drive}",
        }
        found.append(
            JointTarget(
                name=name,
                slide=model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE,
                limits=(low, high) if model.jnt_limited[joint] else None,
                drive=kind,
                **{role: column * (column in known) for role, column in columns.items()},
            )
        )
    return found


_TURNING = {"gyro", "gyroscope", "angular"}
_GRAVITY = 0.2
"""Share by which the mean over a second of an accelerometer that no name tells may be
off 1 g [1]."""


def tool_sensors(
    model: mujoco.MjModel, free: Sequence[Signal], rates: Mapping[str, Sequence[Array]]
) -> Iterator[tuple[str, Signal, str, str]]:
    """Channels of the model's only accelerometer and gyro: column, channel, unit, and reason.

    An accelerometer's unit is the one in which its mean over a second is 1 g; a gyro's the one in
    which it is not much faster than the fastest joint.
    """
    at_rest = {"g": 1.0, "m/s^2": STANDARD_GRAVITY, "mg": 1e3}
    kinds = (
        (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "acceleration",
         {"acc", "accel", "acceleration", "accelerometer"}),
        (mujoco.mjtSensor.mjSENS_GYRO, "angular speed", _TURNING),
    )  # fmt: skip
    for kind, quantity, words in kinds:
        ids = np.flatnonzero(model.sensor_type == kind)
        name = model.sensor(int(ids[0])).name if len(ids) == 1 else ""
        own, told = dict[str, Signal](), True
        for s in free:
            stated, named = quantity_of(s.unit), bool(set(s.meaning.words) & words)
            alone = quantity == "acceleration" and stated == quantity
            # A file's name may be all that says acceleration: then gravity has to be in it.
            beside = quantity == s.meaning.role and not set(s.meaning.words) & _TURNING
            if s.meaning.axis and (alone or ((named or beside) and stated in ("", quantity))):
                own.setdefault(s.meaning.axis, s)
                told &= alone or named
        if not name or len(own) != 3:
            continue
        if quantity == "acceleration":
            still = [own[axis].averaged(1.0) for axis in "xyz"]
            norm = float(np.median(np.linalg.norm(still, axis=0)))
            unit = min(at_rest, key=lambda u: abs(np.log(max(norm, 1e-9) / at_rest[u])))
            if not told and abs(norm / at_rest[unit] - 1) > _GRAVITY:
                continue
        else:
            joint = max((float(np.std(np.concatenate(v))) for v in rates.values()), default=0.0)
            fast = max(float(np.std(s.values)) for s in own.values())
            unit = "deg/s" if joint > 0 and fast / joint > 10 else "rad/s"
        for axis in "xyz":
            reason = f"the model's only sensor of {quantity}; check its axes by loose doctor"
            yield f"sensor.{name}.{axis}", own[axis], own[axis].unit or unit, reason


def inverse_dynamics(
    model: mujoco.MjModel, qpos: Array, qvel: Array, qacc: Array, readings: Array | None = None
) -> Array:
    """Generalised force that a motion needs, shape (T, nv); sensor data go to ``readings``.

    Contacts, stops and friction are left out: they change neither kinematics nor what gravity and
    inertia need.
    """
    data, flags = mujoco.MjData(model), model.opt.disableflags
    torques = np.zeros((len(qpos), model.nv))
    try:
        model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for row in range(len(qpos)):
            data.qpos[:], data.qvel[:], data.qacc[:] = qpos[row], qvel[row], qacc[row]
            mujoco.mj_inverse(model, data)
            torques[row] = data.qfrc_inverse
            if readings is not None:
                readings[row] = data.sensordata
    finally:
        model.opt.disableflags = flags
    return torques


def needed_torques(
    model: mujoco.MjModel, joints: Mapping[str, Sequence[Array]], step: float, every: int = 1
) -> dict[str, list[Array]]:
    """Torques that the model needs for a measured motion [N·m or N], by joint and run.

    Those of each so many rows, where ``every`` is more than 1.

    Positions are averaged over nine samples before they are differentiated. Joints that follow
    another by an equality move with it. Empty where the motion of a joint is not known, or where
    loops are closed, whose forces are not unique.
    """
    if model.nq != model.nv or model.nv == 0 or not joints:
        return {}
    joint_kind = int(mujoco.mjtEq.mjEQ_JOINT)
    couplings = {}
    for i in map(int, np.flatnonzero(model.eq_active0)):
        if int(model.eq_type[i]) != joint_kind:
            return {}
        follower, leader = (int(ids[i]) for ids in (model.eq_obj1id, model.eq_obj2id))
        couplings[model.joint(follower).name] = (leader, model.eq_data[i, :5])
    names = [model.joint(j).name for j in range(model.njnt)]
    if not set(names) - set(couplings) <= set(joints):
        return {}
    runs = len(next(iter(joints.values())))
    found: dict[str, list[Array]] = {name: [] for name in names}
    for run in range(runs):
        length = max((len(own[run]) for own in joints.values()), default=0)
        position = np.zeros((length, model.nq))
        for j, name in enumerate(names):
            if name in joints and len(joints[name][run]) == length:
                position[:, j] = joints[name][run]
        for name, (leader, poly) in couplings.items():
            if name not in joints:
                x = position[:, leader] if leader >= 0 else np.zeros(length)
                position[:, names.index(name)] = np.polynomial.polynomial.polyval(x, poly)
        torque = np.zeros((len(position[::every]), model.nv))
        if length > 2:
            position = np.asarray(ndimage.uniform_filter1d(position, SMOOTHED, axis=0))
            velocity = np.gradient(position, step, axis=0)
            motion = (position, velocity, np.gradient(velocity, step, axis=0))
            torque = inverse_dynamics(model, *(each[::every] for each in motion))
        for j, name in enumerate(names):
            found[name].append(torque[:, j])
    return found


def _drive(model: mujoco.MjModel, joint: int) -> tuple[str, Drive]:
    """Name of the only actuator of a joint, "" where it has none or several, and its kind."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    own = [
        i
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) in kinds and model.actuator_trnid[i, 0] == joint
    ]
    if len(own) != 1:
        return "", "torque"
    bias, affine = model.actuator_biasprm[own[0]], mujoco.mjtBias.mjBIAS_AFFINE
    kind: Drive = "position" if bias[1] else "velocity" if bias[2] else "torque"
    return model.actuator(own[0]).name, (
        kind if model.actuator_biastype[own[0]] == affine else "torque")  # fmt: skip
