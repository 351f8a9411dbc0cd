"""Passive actuators in an MJCF spec: cogging, constant torque, damper; stiff dry friction."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

_STIFF = 0.9999  # MuJoCo's largest constraint impedance
_OPEN_CIRCUIT = 1e12
"""Resistance at which no current brakes the rotor [ohm]."""


def add_cogging(spec: mujoco.MjSpec, joint: str, name: str, cogging: Sequence[float]) -> None:
    """Add a torque that is periodic in a joint's angle."""
    _drive(spec, joint, name, cogging=list(np.asarray(cogging, dtype=float)))


def add_constant(spec: mujoco.MjSpec, joint: str, name: str, torque: float) -> None:
    """Add a constant torque [N·m] or force [N] on a joint."""
    drive = _drive(spec, joint, name)
    drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    drive.biasprm = [torque, *np.zeros(9)]


def add_limited_damper(
    spec: mujoco.MjSpec, joint: str, name: str, *, damping: float, limit: float
) -> None:
    """Add a torque proportional to a joint's speed, up to a limit."""
    drive = _drive(spec, joint, name)
    drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    drive.biasprm = [0.0, 0.0, -damping, *np.zeros(7)]
    drive.forcelimited, drive.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]


def _drive(
    spec: mujoco.MjSpec, joint: str, name: str, *, cogging: Sequence[float] = (0.0, 0.0, 0.0)
) -> mujoco.MjsActuator:
    """Add an actuator to a joint, after the model's own ones and without a command.

    It is a motor with its terminals open: only motors can be without an input.
    """
    drive = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # The model's defaults do not apply to this one.
    drive.forcelimited = drive.ctrllimited = drive.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    drive.gear = [1, 0, 0, 0, 0, 0]
    drive.dynprm, drive.gainprm, drive.biasprm = np.zeros(10), np.zeros(10), np.zeros(10)
    drive.damping, drive.armature = np.zeros_like(drive.damping), 0.0
    drive.delay, drive.nsample = 0.0, 0
    drive.set_to_dcmotor(
        motorconst=[1.0, 0.0],
        resistance=_OPEN_CIRCUIT,
        cogging=list(cogging),
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
    )
    return drive


def make_it_stick(joint: mujoco.MjsJoint | mujoco.MjsTendon, step: float) -> None:
    """Set a joint's or tendon's friction to the largest stiffness stable at a step [s]."""
    joint.solimp_friction = [_STIFF, _STIFF, 0.001, 0.5, 2]
    joint.solref_friction = [2 * step, 1.0]
