"""Which sensors measure the motion of a model's joints, and which a run needs."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.recording.run import Run

__all__ = [
    "JointSensors",
    "add_joint_columns",
    "check_comparison",
    "joint_sensors",
    "joints_needed",
]

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_WHY = {
    "inverse": (
        "has 'torque.' columns and no 'ctrl.' ones, so the torque that the model needs for the "
        "measured motion is compared, which takes the position of every joint that moves with "
        "them"
    ),
    "free": (
        "has neither 'ctrl.' nor 'torque.' columns, so it is a free response from the measured "
        "initial state, which takes the position of every joint"
    ),
}


@dataclass(frozen=True, kw_only=True)
class JointSensors:
    """Sensors of one joint, in the model's order."""

    position: tuple[str, ...] = ()
    """Sensors that read its position [rad or m]."""
    velocity: tuple[str, ...] = ()
    """Sensors that read its velocity [rad/s or m/s]."""


def joint_sensors(model: mujoco.MjModel) -> dict[str, JointSensors]:
    """Find the ``jointpos`` and ``jointvel`` sensors of each hinge and slide with a name.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.

    Returns
    -------
    dict
        Sensors of each joint, in the model's order; empty tuples where it has none.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> joint_sensors(mujoco.MjModel.from_xml_string(xml))
    {'turn': JointSensors(position=('encoder',), velocity=())}
    """
    return {
        model.joint(j).name: JointSensors(
            position=_reading(model, mujoco.mjtSensor.mjSENS_JOINTPOS, j),
            velocity=_reading(model, mujoco.mjtSensor.mjSENS_JOINTVEL, j),
        )
        for j in range(model.njnt)
        if model.jnt_type[j] in (_HINGE, _SLIDE) and model.joint(j).name
    }


def joints_needed(model: mujoco.MjModel, run: Run) -> tuple[int, ...]:
    """Joints whose position the comparison of a run rests on, by their number in the model.

    None for a forward comparison; for an inverse one those of the kinematic trees that carry the
    torques measured, since each moves the others; all for a free response.
    """
    if run.comparison == "forward":
        return ()
    trees = model.body_treeid[model.jnt_bodyid]
    if run.comparison == "free":
        return tuple(range(model.njnt))
    carried = {int(trees[model.joint(name).id]) for name in run.torques}
    return tuple(int(j) for j in np.flatnonzero(np.isin(trees, list(carried))))


def check_comparison(model: mujoco.MjModel, run: Run) -> None:
    """Refuse a run that lacks the joint positions its comparison rests on.

    Statistics of a run with random excitation need none of this; a simulation of it does.

    Raises
    ------
    InvalidData
        If a position is not in the run; the message names the joint, and the column to add or
        the sensor that the model lacks.
    """
    lacking = []
    for j in joints_needed(model, run):
        name = model.joint(j).name
        if model.jnt_type[j] not in (_HINGE, _SLIDE):
            lacking.append(f"{name or f'joint {j}'!r} (free or a ball: no sensor column holds it)")
            continue
        sensors = _reading(model, mujoco.mjtSensor.mjSENS_JOINTPOS, j)
        if not sensors:
            lacking.append(f"{name or f'joint {j}'!r} (the model has no jointpos sensor of it)")
        elif not any(sensor in run.sensors for sensor in sensors):
            lacking.append(f"{name or f'joint {j}'!r} (column 'sensor.{sensors[0]}')")
    if lacking:
        raise InvalidData(
            f"{run.name}: the run {_WHY[run.comparison]}; missing are those of {', '.join(lacking)}"
        )


def add_joint_columns(spec: mujoco.MjSpec) -> None:
    """Give a model without sensors and actuators, such as a URDF, those of its joints.

    Every hinge and slide gets the position sensor ``JOINT_pos``, the velocity sensor ``JOINT_vel``
    and the motor ``JOINT``, whose command is the joint's torque [N·m] or force [N].

    Parameters
    ----------
    spec : mujoco.MjSpec
        The model, which is changed.

    Examples
    --------
    >>> spec = mujoco.MjSpec.from_string(
    ...     "<mujoco><worldbody><body><joint name='turn'/><geom size='.1'/></body></worldbody>"
    ...     "</mujoco>"
    ... )
    >>> add_joint_columns(spec)
    >>> [sensor.name for sensor in spec.sensors], [motor.name for motor in spec.actuators]
    (['turn_pos', 'turn_vel'], ['turn'])
    """
    kinds = {"pos": mujoco.mjtSensor.mjSENS_JOINTPOS, "vel": mujoco.mjtSensor.mjSENS_JOINTVEL}
    for joint in spec.joints:
        if joint.type not in (_HINGE, _SLIDE) or not joint.name:
            continue
        for ending, kind in kinds.items():
            spec.add_sensor(
                name=f"{joint.name}_{ending}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
        motor = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_motor()


def _reading(model: mujoco.MjModel, kind: mujoco.mjtSensor, joint: int) -> tuple[str, ...]:
    found = (model.sensor_type == kind) & (model.sensor_objid == joint)
    names = (model.sensor(int(i)).name for i in np.flatnonzero(found))
    return tuple(name for name in names if name)
