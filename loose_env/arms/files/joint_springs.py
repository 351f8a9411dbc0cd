"""Elastic joints of a file: what a simulation needs so that it can follow them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from loose_env.arms.arm import Arm
from loose_env.arms.holding.compliance import fastest_turn, settling_time
from loose_env.arms.holding.gears import WHEEL_TURN, add_wheel, inertias, poses_of
from loose_env.errors import InvalidData

__all__ = ["FASTEST_TURN", "with_file_springs"]


FASTEST_TURN = 1.4
"""Angle that the fastest mode of springs may turn in one simulation step [rad]."""
_HALVINGS = 4


def with_file_springs(arm: Arm, springs: tuple[str, ...]) -> Arm:
    """Make an arm whose spec holds elastic joints ready for the rig.

    The rig preloads the springs against gravity, as it does those of gears. Behind an open seat
    the flange is all that is left on the spring of its drive: where it is too light for the step, a
    part of the rotor's inertia is moved to it, so that both together stay as they were; where
    that is not enough the step is halved. Records wait until the springs' modes have died away.

    Parameters
    ----------
    arm : Arm
        An arm with a step that is short enough for everything else.
    springs : tuple of str
        Its elastic joints, base first. None leaves the arm as it is.

    Raises
    ------
    InvalidData
        If a spring is too stiff for a sixteenth of the step.
    """
    if not springs:
        return arm
    arm = replace(arm, gear_joints=springs)
    for halving in range(_HALVINGS + 1):
        made = _with_wheels(arm, arm.timestep / 2**halving)
        if made is not None and fastest_turn(made) <= FASTEST_TURN:
            return replace(made, settling=settling_time(made, _lowest_damping(made)))
    stiffness = [float(arm.model.joint(name).stiffness[0]) for name in springs]
    raise InvalidData(
        f"arm {arm.name!r}: the springs of joints {', '.join(springs)} with {stiffness} are too "
        f"stiff to simulate, even with a step of {arm.timestep / 2**_HALVINGS:.1g} s; lower them "
        "in the file, or take the joints out where they are as good as rigid"
    )


def _of_drives(arm: Arm) -> list[tuple[int, str]]:
    """Springs that stand behind a drive on its flange, each with the number of its joint."""
    m = arm.model
    flanges = [int(m.joint(name).bodyid[0]) for name in arm.joints]
    places = [(int(m.joint(spring).bodyid[0]), spring) for spring in arm.gear_joints]
    return [(flanges.index(body), spring) for body, spring in places if body in flanges]


def _with_wheels(arm: Arm, step: float) -> Arm | None:
    """Return the arm with a step and flanges heavy enough for it; None if rotors do not suffice."""
    spec = arm.spec.copy()
    _, own = inertias(arm)
    m = arm.model
    for j, spring in _of_drives(arm):
        stiffness = float(m.joint(spring).stiffness[0])
        damping = float(m.joint(spring).damping[0])
        needed = stiffness * (step / WHEEL_TURN) ** 2 + step * damping
        joint = spec.joint(arm.joints[j])
        moved = max(needed - float(own[j]), 0.0)
        if joint.armature - moved < needed:
            return None
        if moved > 0:
            joint.armature -= moved
            axis = np.asarray(joint.axis, dtype=float)
            slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
            add_wheel(joint.parent, moved, axis / np.linalg.norm(axis), slides=slides)
    return replace(arm, spec=spec, timestep=step)


def _lowest_damping(arm: Arm) -> float:
    """Smallest damping ratio of a spring with all that it carries, the rest held [1]."""
    m, data = arm.model, mujoco.MjData(arm.model)
    full = np.zeros((m.nv, m.nv))
    lowest = np.inf
    for pose in poses_of(arm):
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, data, full)
        for name in arm.gear_joints:
            joint = m.joint(name)
            carried = full[joint.dofadr[0], joint.dofadr[0]]
            critical = 2 * np.sqrt(float(joint.stiffness[0]) * carried)
            lowest = min(lowest, float(joint.damping[0]) / critical)
    return lowest
