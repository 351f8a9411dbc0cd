"""A spec of its own for the chain of a file: flanges, links with all they carry, the tool."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms.files.model_reader import ModelFile
from loose_env.arms.files.serial_chain import Chain
from loose_env.arms.spec_parts import MOTOR_SIDE, new_spec
from loose_env.typing import Array

__all__ = ["BARE_MOTOR_SIDE", "TOOL_SITE", "ChainSpec", "chain_spec"]


BARE_MOTOR_SIDE = 0.25
"""The same where the file gives the joint no rotor inertia: the flange stands for the rotor too."""
TOOL_SITE = "tool"
_RESERVED = ("seat", "open_", "shaker", "coil")  # joints that a rig adds begin with these


@dataclass(frozen=True, kw_only=True)
class ChainSpec:
    """A chain as a spec of its own; names base first."""

    spec: mujoco.MjSpec
    """The arm."""
    joints: tuple[str, ...]
    """Driven joints."""
    links: tuple[str, ...]
    """Their links, a body each."""
    springs: tuple[str, ...]
    """Elastic joints."""


def chain_spec(file: ModelFile, chain: Chain, tool_offset: Array) -> ChainSpec:
    """Build the chain anew, in radians, with a flange and a link for every joint.

    Each link is everything of the file that rides on it, other joints frozen where the file
    has them at its reference. Flange and link share its mass and inertia, both about the same
    centre and in the same frame, so that together they are the link of the file to rounding;
    the flange has `MOTOR_SIDE` of it, or `BARE_MOTOR_SIDE` where the joint has no rotor. Joints
    keep their zero, stiffness, damping and rotor inertia; their stops, dry friction and gravity
    compensation are left out.

    An elastic joint on the body of a driven one stays with it on the flange: the drive's spring
    lies before the seat. One on a body of its own bends the link that it is part of, behind the
    seat; the body is kept.

    The tool is moved by ``tool_offset`` (3,) in its own frame [m].
    """
    m = file.model
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    mujoco.mj_comPos(m, data)
    off = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    spec = new_spec(gravity=(0.0, 0.0, 0.0) if off else [float(g) for g in m.opt.gravity])
    parent, base = spec.worldbody, 0
    joints: list[str] = []
    links: list[str] = []
    springs: list[str] = []
    taken = {m.body(b).name for b in range(m.nbody)}
    moving = sorted({int(m.jnt_bodyid[j]) for j in (*chain.joints, *chain.springs)})
    rides = _riding(m, moving)
    for body in moving:  # a parent comes before its children
        name = m.body(body).name
        own = [j for j in sorted((*chain.joints, *chain.springs)) if m.jnt_bodyid[j] == body]
        place, turn = _relative(data, base, data.xpos[body], data.xmat[body])
        for j in reversed(own):
            place, turn = _to_zero(m, j, place, turn)
        lumped = _lumped(m, data, [b for b in range(m.nbody) if rides[b] == body], body)
        driven = body in chain.links
        moved_name = name
        if driven:
            moved_name = f"{name}_flange"
            while moved_name in taken:
                moved_name += "_"
        flange = parent.add_body(name=moved_name, pos=list(place), quat=_quat(turn))
        for j in own:
            joint = m.joint(j).name
            joint = f"file_{joint}" if joint.startswith(_RESERVED) else joint
            _add_joint(file, j, flange, joint)
            (joints if j in chain.joints else springs).append(joint)
        distal = flange
        if driven:
            rotor = max(joint.armature for joint in flange.joints)
            motor_side = MOTOR_SIDE if rotor > 0 else BARE_MOTOR_SIDE
            distal = flange.add_body(name=name)
            links.append(name)
            _give(flange, lumped, motor_side)
            _give(distal, lumped, 1 - motor_side)
        else:
            _give(flange, lumped, 1.0)
        parent, base = distal, body
    if chain.tool_site is None:
        place, turn = _relative(data, base, data.xpos[chain.tool_body], data.xmat[chain.tool_body])
    else:
        site = chain.tool_site
        place, turn = _relative(data, base, data.site_xpos[site], data.site_xmat[site])
    place = place + turn @ tool_offset
    parent.add_site(name=TOOL_SITE, pos=list(place), quat=_quat(turn))
    return ChainSpec(spec=spec, joints=tuple(joints), links=tuple(links), springs=tuple(springs))


def _riding(m: mujoco.MjModel, moving: list[int]) -> list[int]:
    """For each body the one of the chain that it rides on; 0 where it stands on the ground."""
    rides = [0] * m.nbody
    for body in range(1, m.nbody):
        rides[body] = body if body in moving else rides[int(m.body_parentid[body])]
    return rides


def _give(part: mujoco.MjsBody, lumped: tuple[float, Array, Array, Array], share: float) -> None:
    """Give a body a share of a mass, with its centre, axes and moments."""
    mass, centre, axes, moments = lumped
    part.mass, part.ipos, part.iquat = share * mass, list(centre), _quat(axes)
    part.inertia = [share * float(x) for x in moments]
    part.explicitinertial = True


def _add_joint(file: ModelFile, j: int, flange: mujoco.MjsBody, name: str) -> None:
    m = file.model
    dof = int(m.jnt_dofadr[j])
    drives = [d for d in file.drives if d.joint == m.joint(j).name]
    flange.add_joint(
        name=name,
        type=mujoco.mjtJoint(int(m.jnt_type[j])),
        axis=list(m.jnt_axis[j]),
        pos=list(m.jnt_pos[j]),
        armature=float(m.dof_armature[dof]) + sum(d.armature for d in drives),
        damping=[float(m.dof_damping[dof]) + sum(d.damping for d in drives), 0, 0],
        stiffness=[float(m.jnt_stiffness[j]), 0, 0],
    )


def _relative(data: mujoco.MjData, base: int, place: Array, turn: Array) -> tuple[Array, Array]:
    """A world frame as seen from a body: position (3,) and rotation (3, 3)."""
    back = data.xmat[base].reshape(3, 3).T
    return back @ (place - data.xpos[base]), back @ turn.reshape(3, 3)


def _to_zero(m: mujoco.MjModel, j: int, place: Array, turn: Array) -> tuple[Array, Array]:
    """Move a body's frame from its joint's reference to the joint's zero."""
    reference = float(m.qpos0[int(m.jnt_qposadr[j])])
    axis, anchor = m.jnt_axis[j], m.jnt_pos[j]
    if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
        return place - turn @ axis * reference, turn
    quat, back = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, axis, -reference)
    mujoco.mju_quat2Mat(back, quat)
    rotation = back.reshape(3, 3)
    return place + turn @ (anchor - rotation @ anchor), turn @ rotation


def _lumped(
    m: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], link: int
) -> tuple[float, Array, Array, Array]:
    """Mass, centre, principal axes (3, 3) and moments of bodies as one, in the link's frame."""
    masses = np.array([float(m.body_mass[b]) for b in bodies])
    frames = [_relative(data, link, data.xipos[b], data.ximat[b]) for b in bodies]
    mass = float(masses.sum())
    centre = masses @ np.array([place for place, _ in frames]) / mass
    heavy = [k for k, b in enumerate(bodies) if m.body_mass[b] > 0 or m.body_inertia[b].any()]
    if len(heavy) == 1:  # nothing to add up: the file's own values
        return mass, frames[heavy[0]][0], frames[heavy[0]][1], m.body_inertia[bodies[heavy[0]]]
    tensor = np.zeros((3, 3))
    for b, (place, axes) in zip(bodies, frames, strict=True):
        lever = place - centre
        tensor += axes @ np.diag(m.body_inertia[b]) @ axes.T
        tensor += m.body_mass[b] * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # Of a flat body the largest moment is the sum of the others; rounding must not exceed it.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-15))
    return mass, centre, axes, moments


def _quat(rotation: Array) -> list[float]:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
    return [float(x) for x in quat]
