"""Loose seat as an extra joint: Jacobian, inertia, planar identification, arm with tool held.

A looseness joint is one more joint, neither driven nor measured: one more column of the Jacobian.
Where the loose seat has moved, other columns change too, and which ones locates the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.faults import (
    SEAT,
    Fault,
    StructuralLooseness,
    part_seats,
    seated_spec,
    set_seat,
)
from loose_env.kinematics import Chain, Frame, JointKind
from loose_env.typing import Array


def placed(arm: Arm, pose: ArrayLike) -> mujoco.MjData:
    """Arm without seat at a pose [rad], bending modes at rest."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    return data


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[str]) -> Array:
    """Inertia matrix of some joints while all others are locked."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in joints]
    return full[np.ix_(dofs, dofs)]


def link_frames(arm: Arm, pose: ArrayLike) -> Array:
    """Rotations from each link's frame to the world at a pose [rad], (n, 3, 3)."""
    data = placed(arm, pose)
    return np.array([data.body(name).xmat.reshape(3, 3) for name in arm.seat_bodies])


# The looseness joint.


def insert_looseness(
    chain: Chain, link: int, axis: ArrayLike, *, kind: JointKind = "prismatic"
) -> Chain:
    """Put a looseness joint between joint ``link`` and what that joint moves (3.30-3.32)."""
    return replace(
        chain,
        kinds=(*chain.kinds[:link], kind, *chain.kinds[link:]),
        axes=np.insert(chain.axes, link, _unit(axis), axis=0),
        anchors=np.insert(chain.anchors, link, chain.anchors[link - 1], axis=0),
    )


def displaced(
    chain: Chain, link: int, axis: ArrayLike, displacement: float, *, kind: JointKind = "prismatic"
) -> Chain:
    """Move everything distal to a loose seat by its displacement [m or rad]; no more (3.33)."""
    motion = looseness_transform(axis, displacement, kind=kind)
    turn, origin = motion[:3, :3], chain.anchors[link - 1]

    def moved(points: Array) -> Array:
        return np.asarray((points - origin) @ turn.T + origin + motion[:3, 3])

    axes, anchors = chain.axes.copy(), chain.anchors.copy()
    axes[link:] = axes[link:] @ turn.T
    anchors[link:] = moved(anchors[link:])
    return replace(
        chain, axes=axes, anchors=anchors, tool=moved(chain.tool), tool_axes=turn @ chain.tool_axes
    )


def slot_direction(axis: ArrayLike, normal: ArrayLike) -> Array:
    """Direction of a slot: the joint's axis crossed with the slot's normal (3.27)."""
    return np.asarray(np.cross(_unit(axis), _unit(normal)))


def looseness_transform(
    axis: ArrayLike, displacement: float, *, kind: JointKind = "prismatic"
) -> Array:
    """Homogeneous transform across a looseness joint, turned back to frame (i) (3.26)."""
    z = _unit(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z) / np.linalg.norm(np.cross(helper, z))
    to_loose, motion = np.eye(4), np.eye(4)
    to_loose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    if kind == "prismatic":
        motion[2, 3] = displacement
    else:
        c, s = np.cos(displacement), np.sin(displacement)
        motion[:2, :2] = [[c, -s], [s, c]]
    return to_loose @ motion @ to_loose.T  # no translation in it: the transpose is the inverse


def changed_columns(before: ArrayLike, after: ArrayLike) -> NDArray[np.bool_]:
    """Mask (n,) of the columns of a Jacobian (m, n) that changed."""
    return np.asarray(np.linalg.norm(np.subtract(after, before), axis=0) > 1e-9)


def link_of_changed_columns(changed: Sequence[bool] | NDArray[np.bool_], frame: Frame) -> int:
    """Locate the loose link, from 1, by the changed columns (after 3.33); 0 if none changed.

    In tool coordinates, and for a slide at the tool point in world axes, columns 1 to the link
    change; at the world's origin those after it. Several blocks no single seat can cause.
    """
    mask = np.asarray(changed, dtype=bool)
    count = int(mask.sum())
    block = mask[len(mask) - count :] if frame == "base" else mask[:count]
    if not block.all():
        columns = (np.flatnonzero(mask) + 1).tolist()
        raise InvalidData(f"columns {columns} changed, which is not one block: no single seat")
    return len(mask) - count if frame == "base" and count else count


def _unit(axis: ArrayLike) -> Array:
    vector = np.asarray(axis, dtype=float)
    return np.asarray(vector / np.linalg.norm(vector))


def seated_inertia(arm: Arm, pose: ArrayLike, fault: Fault) -> Array:
    """Inertia matrix M of the driven joints and, for a fault, its seat last (3.43)."""
    links, kinds = part_seats(fault)
    if not links:
        return mass_matrix(arm.model, placed(arm, pose), arm.joints)
    spec = seated_spec(arm, links, kinds)
    if isinstance(fault, StructuralLooseness):
        spec.joint(SEAT).axis = list(fault.direction)
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, value in zip(arm.joints, np.asarray(pose, dtype=float), strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    return mass_matrix(model, data, [*arm.joints, SEAT])


class Condition(NamedTuple):
    """Condition number of an inertia matrix: in SI units, and scaled to a unit diagonal."""

    raw: float
    scaled: float


def condition_of(inertia: ArrayLike) -> Condition:
    """Condition number of an inertia matrix, raw and free of units."""
    m = np.asarray(inertia, dtype=float)
    size = np.sqrt(np.diag(m))
    values, unit = np.linalg.eigvalsh(m), np.linalg.eigvalsh(m / np.outer(size, size))
    return Condition(float(values[-1] / values[0]), float(unit[-1] / unit[0]))


def backlash_condition(ratio: float) -> float:
    """Scaled condition of one joint with play, its motor side ``ratio`` times its link side.

    M = I [[1 + r, 1], [1, 1]]: (1 + c) / (1 - c) with c = (1 + r)^(-1/2), about 4 / r for small r.
    """
    coupling = 1 / np.sqrt(1 + ratio)
    # 1 - c = r c² / (1 + c): no cancellation for a light motor side.
    return float((1 + coupling) ** 2 / (ratio * coupling**2))


# The recursion: one joint after the other is turned, and the tool's velocity tells where it lies.


class PlanarParameters(NamedTuple):
    """Geometry of a planar serial arm: links in the frame of the velocities, offsets of joints."""

    lengths: Array
    """Length of each link, base first [m] (n,)."""
    directions: Array
    """Direction of each link [rad] (n,)."""
    offsets: Array
    """Angle between the links less the joint's reading, joints 2 to n [rad] (n-1,)."""


def velocity_components(jacobian: ArrayLike, rates: ArrayLike) -> Array:
    """Tool velocity from each joint alone, a row a joint (n, d) (3.51, 3.52); their sum is (3.53).

    With the looseness joint's column and rate among them it is that of the loose arm (3.30).
    """
    j, q = np.asarray(jacobian, dtype=float), np.asarray(rates, dtype=float)
    return np.asarray((j * q).T)


def rotation_arms(velocities: ArrayLike, rates: ArrayLike) -> Array:
    """Vector from each revolute joint to the tool (3.58-3.60), all axes along z (3.56)."""
    v, w = np.asarray(velocities, dtype=float), np.asarray(rates, dtype=float)
    return np.asarray(np.column_stack([v[:, 1], -v[:, 0]]) / w[:, None])


def identify_planar(velocities: ArrayLike, rates: ArrayLike, angles: ArrayLike) -> PlanarParameters:
    """Find lengths and offsets from the tool to the base (3.49, 3.50, 3.63, 3.64, 3.66, 3.67).

    All joints turn: a slide's velocity is a free vector, the same wherever the slide lies, so the
    recursion ends there. The joint angle is that between link i and link i-1. The thesis prints
    (3.65) instead, which changes with the joints beyond; see `distended_angles`.
    """
    arms, q = rotation_arms(velocities, rates), np.asarray(angles, dtype=float)
    links = arms - np.vstack([arms[1:], np.zeros((1, 2))])
    directions = np.arctan2(links[:, 1], links[:, 0])
    # The law of cosines (3.63) is the norm of this difference.
    lengths = np.linalg.norm(links, axis=1)
    return PlanarParameters(lengths, directions, _wrap(np.diff(directions) - q[1:]))


def distended_angles(velocities: ArrayLike, rates: ArrayLike) -> Array:
    """Angles of links 1 to n-1 as printed in (3.65): to the arm R of the next joint (3.61)."""
    arms = rotation_arms(velocities, rates)
    links = arms[:-1] - arms[1:]
    to_tool = np.arctan2(arms[1:, 1], arms[1:, 0])
    return _wrap(to_tool - np.arctan2(links[:, 1], links[:, 0]))


def parameter_deviations(
    velocities: ArrayLike, rates: ArrayLike, noise: float
) -> tuple[Array, Array]:
    """Deviations of lengths [m] and offsets [rad] from white velocity noise, to first order."""
    arms = rotation_arms(velocities, rates)
    n = len(arms)
    place = noise / np.abs(np.asarray(rates, dtype=float))  # sd of a joint's place [m]
    links = arms - np.vstack([arms[1:], np.zeros((1, 2))])
    lengths = np.sqrt(place**2 + np.append(place[1:], 0.0) ** 2)
    across = np.column_stack([-links[:, 1], links[:, 0]])
    across /= np.linalg.norm(links, axis=1)[:, None] ** 2
    gradient = np.zeros((n, n, 2))  # of each link's direction in each joint's place
    gradient[np.arange(n), np.arange(n)] = across
    gradient[np.arange(n - 1), np.arange(1, n)] = -across[:-1]
    offset = np.diff(gradient, axis=0)
    return lengths, np.sqrt(np.einsum("kja,j->k", offset**2, place**2))


def _wrap(angle: Array) -> Array:
    return np.asarray(np.pi - (np.pi - angle) % (2 * np.pi))


# The dock: the tool is held, the joints are driven. Joints that still move, in an arm whose own
# columns allow no such motion, move because a seat slides.


def joint_torques(jacobian: ArrayLike, force: ArrayLike) -> Array:
    """Joint torques equivalent to a force at the tool, J^T f (3.10)."""
    return np.asarray(np.asarray(jacobian, dtype=float).T @ np.asarray(force, dtype=float))


def dock_force(jacobian: Array, inertia: Array, torque: Array) -> Array:
    """Force f of the jig that keeps the tool still (3.25).

    The tool's acceleration at low speed, J M⁻¹ (τ* + J^T f), is 0 (3.9, 3.15-3.17, 3.20-3.21,
    3.23-3.24). Torques come without potential loads and are 0 at a looseness joint (4.24).
    """
    free = jacobian @ np.linalg.solve(inertia, torque)
    mobility = jacobian @ np.linalg.solve(inertia, jacobian.T)
    return np.asarray(-np.linalg.lstsq(mobility, free, rcond=1e-12)[0])


def docked_acceleration(jacobian: Array, inertia: Array, torque: Array) -> Array:
    """Joint accelerations that remain while the tool stands still (3.22)."""
    held = jacobian.T @ dock_force(jacobian, inertia, torque)
    return np.asarray(np.linalg.solve(inertia, torque + held))


def remaining_motions(jacobian: ArrayLike) -> Array:
    """Joint motions that leave the tool still, (n, n - rank): the null space of the held rows."""
    _, values, rows = np.linalg.svd(np.asarray(jacobian, dtype=float))
    rank = int((values > 1e-9 * values.max(initial=0.0)).sum())
    return np.asarray(rows[rank:].T)


def moving_directions(angles: ArrayLike, noise: float) -> Array:
    """Principal joint motions (k, n) in a record (n, N) above three times the encoders' noise."""
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(np.asarray(angles, dtype=float))))
    keep = np.sqrt(np.maximum(values, 0.0)) > 3.0 * noise
    return np.asarray(vectors.T[::-1][keep[::-1]])


def seat_twist(jacobian: Array, angles: Array) -> Array:
    """Direction of the seat's motion at the tool, -J q of a docked arm: unit vector, axial.

    It is that of the velocity which the seat alone gives the tool (3.57, 3.68, 3.69).
    """
    motion = -jacobian @ (angles - angles.mean(axis=1, keepdims=True))
    left, _, _ = np.linalg.svd(motion, full_matrices=False)
    return np.asarray(left[:, 0] * np.sign(left[np.argmax(np.abs(left[:, 0])), 0]))


def compatible_links(directions: ArrayLike, frames: ArrayLike) -> tuple[Array, int]:
    """Rms angle of directions (P, d) to their mean in each link's frame [rad], and the best link.

    ``frames`` (P, n, d, d): rotation from each link's frame to the world in each pose.
    """
    u, r = np.asarray(directions), np.asarray(frames)
    own = np.einsum("pkdc,pd->pkc", r, u / np.linalg.norm(u, axis=1, keepdims=True))
    _, vectors = np.linalg.eigh(np.einsum("pkc,pkb->kcb", own, own))
    along = np.abs(np.einsum("pkc,kc->pk", own, vectors[:, :, -1]))
    misfit = np.sqrt(np.mean(np.arccos(np.clip(along, 0.0, 1.0)) ** 2, axis=0))
    return misfit, int(np.argmin(misfit)) + 1


Jig = Literal["pin", "clamp"]
"""A pin holds the tool's place and lets it turn; a clamp holds place and orientation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DockedRecord:
    """Record of a docked arm; true values, no sensor noise."""

    angles: Array
    """Joint positions less the pose [rad] (n, N)."""
    accelerations: Array
    """Joint accelerations [rad/s²] (n, N)."""
    torques: Array
    """Torque on the joints: drives, centring springs and joint damping [N·m] (n, N)."""
    forces: Array
    """Force of the jig on the tool in the plane, world axes [N] (2, N)."""


def simulate_docked(
    arm: Arm, pose: ArrayLike, fault: Fault, torque: Array, *, jig: Jig = "clamp", every: int = 1
) -> DockedRecord:
    """Drive the joints of a planar arm whose tool is held (3.18, 3.19, integrated by MuJoCo).

    Each joint has its drive's torque (n, steps), its soft centring spring and its own damping.
    """
    q = np.asarray(pose, dtype=float)
    model, data = _dock(arm, q, fault, jig)
    joints = [model.joint(name) for name in arm.joints]
    dofs = np.array([j.dofadr[0] for j in joints])
    at = np.array([j.qposadr[0] for j in joints])
    stiffness = model.jnt_stiffness[[j.id for j in joints]]
    dock, tool = model.equality("dock").id, model.site(arm.tool).id
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    count, n = torque.shape[1] // every, arm.n
    rows = np.empty((count, 3 * n + 2))
    for k in range(count * every):
        data.qfrc_applied[dofs] = torque[:, k]
        state, rate = data.qpos[at] - q, data.qvel[dofs].copy()
        mujoco.mj_step(model, data)
        if (k + 1) % every:
            continue
        acceleration = data.qacc[dofs].copy()
        net = torque[:, k] - stiffness * state - model.dof_damping[dofs] * rate
        held = np.flatnonzero((data.efc_type[: data.nefc] == 0) & (data.efc_id == dock))
        pull = data.efc_J.reshape(data.nefc, model.nv)[held].T @ data.efc_force[held]
        mujoco.mj_jacSite(model, data, linear, angular, tool)
        plane = linear[:2] if jig == "pin" else np.vstack([linear[:2], angular[2:]])
        force = np.linalg.lstsq(plane.T, pull, rcond=None)[0][:2]
        rows[k // every] = np.concatenate([state, acceleration, net, force])
    if not np.isfinite(rows).all():
        raise InvalidData("the simulation of the docked arm diverged: lower torque or stiffness")
    angles, accelerations, torques, forces = np.split(rows.T.copy(), [n, 2 * n, 3 * n])
    return DockedRecord(angles=angles, accelerations=accelerations, torques=torques, forces=forces)


def _dock(arm: Arm, q: Array, fault: Fault, jig: Jig) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile the arm with its seat and its tool in the jig, and bring it to its pose."""
    place = placed(arm, q).site(arm.tool)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, place.xmat)
    links, kinds = part_seats(fault)
    spec = seated_spec(arm, links or arm.n, kinds)
    spec.worldbody.add_site(name="jig", pos=place.xpos.tolist(), quat=quaternion.tolist())
    spec.add_equality(
        name="dock",
        type=mujoco.mjtEq.mjEQ_CONNECT if jig == "pin" else mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=arm.tool,
        name2="jig",
        solref=[2 * arm.timestep, 1.0],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2],
    )
    spec.option.timestep = arm.timestep
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.disableflags |= int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    )
    for j, name in enumerate(arm.joints):
        joint = spec.joint(name)
        joint.stiffness = [arm.centring.stiffness[j], 0, 0]
        joint.damping = [joint.damping[0] + arm.centring.damping[j], 0, 0]
        joint.springref = float(q[j])
    model = spec.compile()
    data = mujoco.MjData(model)
    set_seat(model, fault, data)
    mujoco.mj_resetData(model, data)
    for name, value in zip(arm.joints, q, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    return model, data
