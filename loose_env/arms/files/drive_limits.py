"""Torque limits, levels and time step of an arm, where its file leaves them open."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, Holding
from loose_env.arms.holding.compliance import fastest_turn, settling_time
from loose_env.arms.holding.gears import WHEEL_TURN, add_wheel, inertias, poses_of, rounded
from loose_env.arms.response.linear import LinearArm
from loose_env.arms.spec_parts import CREST_FACTOR, FASTEST_TURN, GRAVITY
from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = [
    "AT_LEAST",
    "TIMESTEP",
    "calm_centring",
    "propose_levels",
    "propose_limits",
    "stable_timestep",
    "with_file_springs",
]


AT_LEAST = 1.0
"""Peak tool acceleration beyond gravity for which a proposed torque limit is made [g]."""
TIMESTEP = 2e-4
"""Simulation step, unless a joint's damper or spring needs a shorter one [s]."""
_SHORTEST = TIMESTEP / 16
_TRACE = 1e-10
_SPRUNG_POINTS = 120  # frequencies, where springs have modes that can lie in the band
_GRAVITY_SPARE = 2.0  # a drive holds twice the gravity load
_MOST_DECAY = 0.2
"""Largest decay of a centring damper within half a step [1]. The rig makes up for the half step
with rotor inertia, which the mismatch draws up to 9 % smaller and the damper up to 30 % larger; of
what explicit steps can bear, a drawn stop on the same flange takes up to seven tenths."""


def propose_limits(model: mujoco.MjModel, joints: list[str], poses: Array) -> Array:
    """Propose torque limits: twice the gravity load, and 1 g at the tool besides.

    Parameters
    ----------
    model : mujoco.MjModel
        The bare arm.
    joints : list of str
        Its joints, base first.
    poses : ndarray (m, n)
        Poses to look at [rad or m].

    Returns
    -------
    ndarray (n,)
        Limits [N·m, or N where it slides], two digits.
    """
    data = mujoco.MjData(model)
    site = model.site("tool").id
    dofs = [int(model.joint(j).dofadr[0]) for j in joints]
    at = [int(model.joint(j).qposadr[0]) for j in joints]
    full, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    load, shake = np.zeros(len(joints)), []
    for pose in poses:
        data.qpos[at] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        load = np.maximum(load, np.abs(data.qfrc_bias[dofs]))
        lever = np.linalg.norm(jacobian[:, dofs], axis=0)
        # A joint whose axis meets the tool is shaken as one that lies 0.1 m beside it.
        shake.append(full[dofs, dofs] * GRAVITY * AT_LEAST / np.maximum(lever, 0.1))
    limits = _GRAVITY_SPARE * load + np.median(shake, axis=0)
    return np.array([float(f"{x:.2g}") for x in limits])


def propose_levels(arm: Arm, poses: Array) -> tuple[float, float, float]:
    """Three levels whose top half of all poses and joints can reach.

    The tool's rms acceleration in the band that each joint reaches alone, with the torque that
    is left beside gravity and peaks of three times the rms (`CREST_FACTOR`); the top level is
    the median over poses and joints that move the tool, the others a third and a ninth of it.

    Returns
    -------
    tuple of 3 floats
        Levels [m/s²], two digits.

    Raises
    ------
    InvalidData
        If that median is zero, or no joint moves the tool.
    """
    sprung = arm.gear_joints and arm.rigid is None  # by the file
    linear = LinearArm(arm, points=_SPRUNG_POINTS if sprung else 12)
    reachable = []
    for pose in poses:
        at = linear.at(pose)
        spare = np.maximum(np.array(arm.torque_limits) - np.abs(at.gravity_torque), 0.0)
        moves = np.linalg.norm(at.kinematic, axis=0) > 1e-6
        for j in np.flatnonzero(moves):
            tool = at.response(np.arange(arm.n) == j).tool
            per_torque = np.sqrt(np.mean(np.sum(np.abs(tool[:, :, 0]) ** 2, axis=1)))
            reachable.append(per_torque * spare[j] / CREST_FACTOR)
    if not reachable:
        raise InvalidData(
            f"arm {arm.name!r}: no joint moves its tool, which lies on the axis of every one: add "
            "a site beside the axis to the last body, or name a site or body farther out: tool=..."
        )
    top = float(f"{np.median(reachable):.2g}")
    if not top > 0:
        raise InvalidData(
            f"arm {arm.name!r}: in most poses no torque is left to shake the tool: the limits "
            f"{arm.torque_limits} hardly hold it against gravity; raise them in the file"
        )
    return float(f"{top / 9:.2g}"), float(f"{top / 3:.2g}"), top


def stable_timestep(arm: Arm, poses: Array) -> float:
    """Find a step that resolves the file's dampers and springs, with every seat open.

    The rig takes them explicitly, and behind an open seat they act on the flange alone. The step
    is halved until no mode of theirs decays or turns by more than 1 in a step.

    Raises
    ------
    InvalidData
        If even a sixteenth of the usual step is too long.
    """
    linear = LinearArm(arm, points=2)
    joints = linear.joint_dofs
    damping = linear.model.dof_damping[joints]
    stiffness = linear.model.jnt_stiffness[linear.model.dof_jntid[joints]]
    decay = turn = 0.0
    for weight in _flange_weights(linear, poses):
        decay = max(decay, float(np.linalg.eigvals(weight * damping).real.max()))
        turn = max(turn, float(np.linalg.eigvals(weight * stiffness).real.max()))
    step = TIMESTEP
    while step * decay > 1 or step**2 * turn > 1:
        step /= 2
        if step < _SHORTEST:
            raise InvalidData(
                f"arm {arm.name!r}: damping {damping.tolist()} and stiffness "
                f"{stiffness.tolist()} of its joints are too large for its inertias: a step of "
                f"{min(1 / max(decay, 1e-12), max(turn, 1e-12) ** -0.5):.1g} s would be needed; "
                "lower them in the file, or give the joints a rotor inertia (armature)"
            )
    return step


def calm_centring(arm: Arm, poses: Array) -> Holding:
    """Weaken the centring dampers that would be too fast for the step with every seat open.

    Behind an open seat they act on the flange alone, which can be a thousandth of what the joint
    carries where the file gives it no rotor inertia. Their springs stay.

    Parameters
    ----------
    arm : Arm
        The arm, its step settled.
    poses : ndarray (m, n)
        Poses to look at [rad or m].

    Returns
    -------
    Holding
        The arm's centring, its damping lowered where needed.
    """
    weights = _flange_weights(LinearArm(arm, points=2), poses)
    damping = np.array(arm.centring.damping)
    most = 2 * _MOST_DECAY / arm.timestep
    lightest = np.einsum("pjj->pj", weights).max(axis=0)
    calm = np.minimum(damping, most / lightest)
    together = max(float(np.linalg.eigvals(w * calm).real.max()) for w in weights)
    calm = np.where(calm < damping, calm * min(1.0, most / together), damping)
    return Holding(stiffness=arm.centring.stiffness, damping=rounded(calm))


def _flange_weights(linear: LinearArm, poses: Array) -> Array:
    """Inverse inertia of the joints in every pose, with every seat open (m, n, n)."""
    inertia = np.array([linear.at(pose).inertia for pose in poses])
    # Play along a sliding joint and the slides of its link are one motion: a trace more of each
    # inertia lets them be solved, and changes nothing of what the joints feel.
    own = np.arange(inertia.shape[1])
    inertia[:, own, own] *= 1 + _TRACE
    joints = linear.joint_dofs
    unit = np.eye(len(own))[:, joints]
    return np.asarray(np.linalg.solve(inertia, np.tile(unit, (len(poses), 1, 1)))[:, joints])


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
