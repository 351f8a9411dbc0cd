"""Elastic gears between the motors and the links of an arm: their parameters and location."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from loose_env.arms.arm import GEAR_MODE_HZ, Arm, Gears, PerJoint, each_joint
from loose_env.arms.spec_parts import held_inertia
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = [
    "BARE_ROTOR",
    "STIFFNESS_PER_TORQUE",
    "WHEEL_TURN",
    "add_wheel",
    "geared_spec",
    "gears_of",
    "inertias",
    "poses_of",
    "proposed_gears",
    "rotors",
    "rounded",
]


STIFFNESS_PER_TORQUE = 300.0
"""Gear stiffness per peak torque of the drive [1/rad], where no stiffness is known: an estimate, a
wind-up of 3.3 mrad under peak torque."""


BARE_ROTOR = 0.25
"""Rotor inertia over the inertia it carries [1], for a joint without any; an estimate."""


WHEEL_TURN = 0.8
"""Angle a gear's output side alone on its spring may turn in one simulation step [rad]; the rest
of the stable range is left to a stop that pushes on it."""


def gears_of(
    arm: Arm,
    stiffness: PerJoint | None = None,
    mode_hz: PerJoint | None = None,
    damping_ratio: PerJoint | None = None,
) -> Gears:
    """Parameters of an arm's gears, with what is given in place of its own.

    Raises
    ------
    InvalidSetting
        If both a stiffness and a mode are given, or they do not fit the joints.
    """
    if stiffness is not None and mode_hz is not None:
        raise InvalidSetting(
            f"gears have a stiffness or a mode, not both; got stiffness={stiffness!r} and "
            f"mode_hz={mode_hz!r}"
        )
    gears = arm.gears or Gears()
    if stiffness is not None:
        gears = replace(gears, stiffness=_tuple("stiffness", stiffness, arm.n))
    if mode_hz is not None:
        gears = replace(gears, stiffness=None, mode_hz=_tuple("mode_hz", mode_hz, arm.n))
    if damping_ratio is not None:
        gears = replace(gears, damping_ratio=_tuple("damping_ratio", damping_ratio, arm.n))
    return gears


def proposed_gears(arm: Arm) -> Gears:
    """Propose gears for an arm of which only drives and inertias are known.

    Turning joints have `STIFFNESS_PER_TORQUE` times their torque limit, but no more than can be
    simulated with the arm's step; sliding ones a mode of `GEAR_MODE_HZ`.
    """
    carried, _ = inertias(arm)
    rotor = rotors(arm, carried)
    stiffest = 0.25 * rotor * (WHEEL_TURN / arm.timestep) ** 2
    by_torque = STIFFNESS_PER_TORQUE * np.array(arm.torque_limits)
    by_mode = carried * (2 * np.pi * GEAR_MODE_HZ) ** 2
    stiffness = np.where(arm.sliding, by_mode, by_torque)
    return Gears(stiffness=rounded(np.minimum(stiffness, stiffest)))


def geared_spec(
    arm: Arm, stiffness: Array, damping: Array, rotor: Array, moved: Array
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Copy an arm's spec and add a gear to the body of every joint, behind the joint.

    Parameters
    ----------
    arm : Arm
        The arm, its gears stiff.
    stiffness, damping : ndarray (n,)
        Of each gear, per radian or metre.
    rotor : ndarray (n,)
        Inertia that stays before each gear, at the motor [kg·m², or kg where it slides].
    moved : ndarray (n,)
        Inertia that is added behind each gear, to the flange.

    Returns
    -------
    spec : mujoco.MjSpec
        The arm with gears.
    gears : tuple of str
        Names of their joints, base first.

    Raises
    ------
    InvalidSetting
        If a link's seat is on the body of its joint.
    """
    spec = arm.spec.copy()
    taken = {joint.name for joint in spec.joints}
    gears = []
    for i, name in enumerate(arm.joints):
        joint = spec.joint(name)
        flange = joint.parent
        if flange.name == arm.seat_bodies[i]:
            raise InvalidSetting(
                f"arm {arm.name!r}: link {i + 1} has no flange between its joint {name!r} and its "
                "seat, where the gear's output would be; put the joint on a body of its own and "
                "the link on a child of it"
            )
        gear = f"gear{i + 1}"
        while gear in taken:
            gear += "_"
        taken.add(gear)
        joint.armature = float(rotor[i])
        axis = np.asarray(joint.axis, dtype=float)
        flange.add_joint(
            name=gear,
            type=joint.type,
            axis=list(axis),
            pos=list(joint.pos),
            stiffness=[float(stiffness[i]), 0, 0],
            damping=[float(damping[i]), 0, 0],
        )
        if moved[i] > 0:
            slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
            add_wheel(flange, float(moved[i]), axis / np.linalg.norm(axis), slides=slides)
        gears.append(gear)
    return spec, tuple(gears)


def add_wheel(flange: mujoco.MjsBody, inertia: float, axis: Array, *, slides: bool) -> None:
    """Add an inertia about (or a mass along) an axis to a flange, at its centre of mass."""
    if slides:
        flange.mass += inertia
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(flange.iquat, dtype=float))
    axes = rotation.reshape(3, 3)
    tensor = axes @ np.diag(np.asarray(flange.inertia, dtype=float)) @ axes.T
    # A flat disc: half as much about its diameters.
    tensor += inertia * (np.eye(3) + np.outer(axis, axis)) / 2
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # Of a flat body the largest moment is the sum of the others; rounding must not exceed it.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-12))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(axes).ravel())
    flange.iquat, flange.inertia = list(quat), list(moments)
    flange.explicitinertial = True


def inertias(arm: Arm) -> tuple[Array, Array]:
    """Inertia at each joint without its rotor, and its flange's share of that (n,) each."""
    model = arm.model
    rotors = np.array([float(model.dof_armature[model.joint(j).dofadr[0]]) for j in arm.joints])
    carried = held_inertia(arm.spec, arm.joints, poses_of(arm)) - rotors
    own = np.zeros(arm.n)
    for i, name in enumerate(arm.joints):
        joint = model.joint(name)
        body = int(model.jnt_bodyid[joint.id])
        mass = float(model.body_mass[body])
        if model.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_SLIDE:
            own[i] = mass
            continue
        axis = model.jnt_axis[joint.id]
        lever = np.cross(axis, model.body_ipos[body] - model.jnt_pos[joint.id])
        turned, back = np.zeros(3), np.zeros(4)
        mujoco.mju_negQuat(back, model.body_iquat[body])
        mujoco.mju_rotVecQuat(turned, axis, back)
        own[i] = float(model.body_inertia[body] @ turned**2) + mass * float(lever @ lever)
    return carried, own


def rotors(arm: Arm, carried: Array) -> Array:
    """Rotor inertia of each joint, that of a bare one estimated [kg·m², or kg] (n,)."""
    model = arm.model
    rotors = np.array([float(model.dof_armature[model.joint(j).dofadr[0]]) for j in arm.joints])
    return np.where(rotors > 0, rotors, BARE_ROTOR * carried)


def poses_of(arm: Arm) -> Array:
    """The zero pose and random ones, always the same."""
    rng = np.random.default_rng(0)
    return np.array([np.zeros(arm.n), *(arm.random_pose(rng) for _ in range(24))])


def _tuple(name: str, value: PerJoint, n: int) -> tuple[float, ...]:
    return tuple(float(v) for v in each_joint(name, value, n))


def rounded(values: Array) -> tuple[float, ...]:
    """Round to three digits."""
    return tuple(float(f"{v:.3g}") for v in values)
