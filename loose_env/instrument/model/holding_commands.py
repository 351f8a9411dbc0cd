"""Commands that hold a pose or move an arm there, and the reason why a pose cannot be held."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.instrument.model.actuators import actuators_on, drives_of
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.typing import Array


def holding_commands(arm: InstrumentedArm, pose: Array) -> tuple[dict[str, float], Array]:
    """Commands and torques that balance gravity in a pose.

    Of several actuators on a joint one carries the load, as
    `loose_env.instrument.model.actuators.drives_of` chooses it; the others are told to give no
    torque where the joint is. Actuators of other joints, such as a gripper's, hold them where the
    model has them.
    """
    model, data = arm.recording_model.model, _standing(arm, pose)
    load = data.qfrc_bias - data.qfrc_passive
    commands = {model.actuator(a).name: 0.0 for a in range(model.nu)}
    joints = _joints(model)
    place = {name: float(data.joint(name).qpos[0]) for name in joints}
    needed = {name: float(load[model.joint(name).dofadr[0]]) for name in joints}
    chosen = [drive for drive in drives_of(model, joints)[0] if drive is not None]
    for drive in actuators_on(model, joints)[0]:
        if drive in chosen:
            continue
        q = place[drive.joint]
        if drive.gain != 0:
            idle = float(drive.command(0.0, q))
            commands[drive.actuator] = float(np.clip(idle, *drive.command_range))
        # The chosen actuator need not supply the force of this one.
        needed[drive.joint] -= drive.torque(commands[drive.actuator], q)
    for drive in chosen:
        commands[drive.actuator] = float(drive.command(needed[drive.joint], place[drive.joint]))
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    return commands, np.asarray(load[dofs])


def starting_commands(arm: InstrumentedArm, pose: Array) -> dict[str, float]:
    """Commands that move the arm to a pose: the pose itself for position servos.

    Under them the arm hangs below the pose by the sag of its servos. Motors hold it as
    `holding_commands` has them.
    """
    return _at_the_start(arm, pose, holding_commands(arm, pose)[0])


def why_not_held(arm: InstrumentedArm, pose: Array) -> str:
    """Reason why the actuators cannot servo a pose; "" if they can."""
    holding = holding_commands(arm, pose)[0]
    told = (holding, _at_the_start(arm, pose, holding))
    for drive in arm.drives:
        if drive is None:
            continue
        low, high = drive.command_range
        room = 1e-9 * max(abs(low), abs(high), 1.0) if np.isfinite([low, high]).all() else 0.0
        for commands in told:
            command = commands[drive.actuator]
            if not low - room <= command <= high + room:
                return (
                    f"{drive.actuator} would have to be told {command:.4g} to hold {drive.joint}, "
                    f"and takes commands from {low:g} to {high:g}"
                )
    return ""


def _at_the_start(arm: InstrumentedArm, pose: Array, holding: dict[str, float]) -> dict[str, float]:
    """Static commands (actuator -> command), the pose itself for servos."""
    model, data, commands = arm.recording_model.model, _standing(arm, pose), dict(holding)
    for drive in drives_of(model, _joints(model))[0]:
        if drive is not None and drive.servo:
            q = float(data.joint(drive.joint).qpos[0])
            commands[drive.actuator] = float(drive.command(0.0, q))
    return commands


def _standing(arm: InstrumentedArm, pose: Array) -> mujoco.MjData:
    """Recordable model at rest in a pose."""
    model = arm.recording_model.model
    data = mujoco.MjData(model)
    for name, q in zip(arm.joints, pose, strict=True):
        data.joint(name).qpos[0] = q
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    return data


def _joints(model: mujoco.MjModel) -> list[str]:
    """Revolute and prismatic joints."""
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    return [model.joint(j).name for j in range(model.njnt) if int(model.jnt_type[j]) in kinds]
