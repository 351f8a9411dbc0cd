"""The static-force test: the tool is held, the joints are driven (thesis 3.2.1, 8.1.2).

With the tool held, J q̇ = 0 over all n+1 columns. Joints that still move, in an arm whose own
columns allow no such motion, move because a seat slides: the seat's twist is minus what the
joints do at the tool. Along that motion no force is carried, to the stops.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.faults import SEAT, Fault, seat_of, seated_spec, set_seat
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SeatTwist:
    """Motion of the seat inferred from a docked arm's joints."""

    direction: Array
    """Unit vector of the seat's motion at the tool, in the Jacobian's rows (m,); its sign is
    free."""
    size: float
    """Rms of the motion along it, in the Jacobian's units."""
    first_share: float
    """Share of the whole motion's power that lies along it, 0 to 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkAgreement:
    """Misfit of each link to the directions measured in several poses."""

    misfit: Array
    """Rms angle between the directions, turned into a link's frame, and their axial mean
    [rad] (n,)."""
    best: int
    """Link with the smallest misfit, from 1."""
    direction: Array
    """Direction of the slide in that link's frame (d,), largest component positive."""


def _arrays(*values: ArrayLike) -> list[Array]:
    return [np.asarray(value, dtype=float) for value in values]


def joint_torques(jacobian: ArrayLike, force: ArrayLike) -> Array:
    """Joint torques equivalent to a force at the tool, J^T f (3.10).

    ``jacobian`` (m, n): rows of the Jacobian. ``force`` (m,) or (m, N): force and moment on the
    tool in the same rows [N, N·m].

    Examples
    --------
    >>> joint_torques([[0.0, 0.0], [0.6, 0.3]], [0.0, 10.0])
    array([6., 3.])
    """
    return np.asarray(np.asarray(jacobian, dtype=float).T @ np.asarray(force, dtype=float))


def tool_acceleration(
    jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike, force: ArrayLike | None = None
) -> Array:
    """Tool acceleration at low speed, J M⁻¹ (τ* + J^T f) (3.9, 3.15-3.17, 3.20-3.24, 4.24).

    ``jacobian`` (m, n): rows of the Jacobian; n counts the looseness joint if there is one.
    ``inertia`` (n, n): inertia matrix. ``torque`` (n,) or (n, N): joint torques without potential
    loads, which the caller takes off; 0 at a looseness joint. ``force`` (m,) or (m, N): force of
    the surroundings on the tool; none for a free arm.

    Examples
    --------
    >>> tool_acceleration([[0.5]], [[2.0]], [4.0])
    array([1.])
    """
    j, m, tau = _arrays(jacobian, inertia, torque)
    if force is not None:
        tau = tau + joint_torques(j, force)
    return np.asarray(j @ np.linalg.solve(m, tau))


def dock_force(jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike) -> Array:
    """Force of the jig that keeps the tool still (3.25), shape (m,) or (m, N).

    Examples
    --------
    >>> dock_force([[0.5]], [[2.0]], [4.0])
    array([-8.])
    """
    j, m, tau = _arrays(jacobian, inertia, torque)
    free, mobility = j @ np.linalg.solve(m, tau), j @ np.linalg.solve(m, j.T)
    return np.asarray(-np.linalg.lstsq(mobility, free, rcond=1e-12)[0])


def docked_acceleration(jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike) -> Array:
    """Joint accelerations that remain while the tool stands still (3.22, 3.25).

    Zero for a fully held arm without spare joints; not zero once a looseness joint is there.

    Examples
    --------
    >>> docked_acceleration([[0.5]], [[2.0]], [4.0])
    array([0.])
    """
    j, m, tau = _arrays(jacobian, inertia, torque)
    return np.asarray(np.linalg.solve(m, tau + j.T @ dock_force(j, m, tau)))


def remaining_motions(jacobian: ArrayLike, *, tolerance: float = 1e-9) -> Array:
    """Joint motions that leave the tool still: the null space of J.

    ``jacobian`` (m, n): only the rows that the jig holds; n counts the looseness joint if there is
    one. ``tolerance``: singular values below this share of the largest count as zero. Returns (n,
    k): orthonormal motions; k = n - rank of J.

    Examples
    --------
    >>> remaining_motions([[0.6, 0.3, 0.3]]).shape
    (3, 2)
    """
    _, values, rows = np.linalg.svd(np.asarray(jacobian, dtype=float))
    rank = int((values > tolerance * values.max(initial=0.0)).sum())
    return np.asarray(rows[rank:].T)


def moving_directions(angles: ArrayLike, noise: float, *, factor: float = 3.0) -> Array:
    """Joint motions seen in a record, larger than the encoders' noise (k, n).

    ``angles`` (n, N): joint positions [rad]. ``noise``: rms error of one reading [rad]. ``factor``:
    principal motion counts if its rms is above ``factor`` times the noise. Returns (k, n):
    principal motions, largest first, unit vectors.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.sin(np.arange(100.0))
    >>> moving_directions([1e-3 * t, 0 * t], 1e-6).shape
    (1, 2)
    """
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(np.asarray(angles, dtype=float))))
    keep = np.sqrt(np.maximum(values, 0.0)) > factor * noise
    return np.asarray(vectors.T[::-1][keep[::-1]])


def seat_twist(jacobian: ArrayLike, angles: ArrayLike) -> SeatTwist:
    """Motion of the seat at the tool, from the joint motion of a docked arm: -J q.

    A spare joint's own motion drops out, because it does nothing at the tool.

    ``jacobian`` (m, n): the nominal Jacobian, the rows that the jig holds. ``angles`` (n, N): joint
    positions while docked [rad].

    Examples
    --------
    >>> import numpy as np
    >>> t = 1e-3 * np.sin(np.arange(50.0))
    >>> seat_twist([[0.0, 0.0], [0.6, 0.3]], [t, 0 * t]).direction
    array([0., 1.])
    """
    x = np.asarray(angles)
    motion = -np.asarray(jacobian) @ (x - x.mean(axis=1, keepdims=True))
    left, values, _ = np.linalg.svd(motion, full_matrices=False)
    if values[0] == 0:
        raise InvalidData("the joints did nothing at the tool: there is no motion to read")
    u = left[:, 0] * np.sign(left[np.argmax(np.abs(left[:, 0])), 0])
    return SeatTwist(
        direction=u,
        size=float(values[0] / np.sqrt(x.shape[1])),
        first_share=float(values[0] ** 2 / (values**2).sum()),
    )


def link_frames(arm: Arm, pose: ArrayLike) -> Array:
    """Rotations from each link's frame to the world at a pose [rad], (n, 3, 3)."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(arm.model, data)
    return np.array([data.body(name).xmat.reshape(3, 3) for name in arm.seat_bodies])


def compatible_links(directions: ArrayLike, frames: ArrayLike) -> LinkAgreement:
    """Find the link in whose frame the directions of several poses agree.

    ``directions`` (P, d): direction of the slide in each pose, world axes; signs are free.
    ``frames`` (P, n, d, d): rotation from each link's frame to the world in each pose.

    Examples
    --------
    >>> import numpy as np
    >>> quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> frames = [[np.eye(2), np.eye(2)], [np.eye(2), quarter]]
    >>> compatible_links([[1.0, 0.0], [0.0, 1.0]], frames).best
    2
    """
    u, r = np.asarray(directions), np.asarray(frames)
    size = np.linalg.norm(u, axis=1, keepdims=True)
    own = np.einsum("pkdc,pd->pkc", r, u / size)
    _, vectors = np.linalg.eigh(np.einsum("pkc,pkb->kcb", own, own))
    means = vectors[:, :, -1]
    angle = np.arccos(np.clip(np.abs(np.einsum("pkc,kc->pk", own, means)), 0.0, 1.0))
    misfit = np.sqrt(np.mean(angle**2, axis=0))
    best = int(np.argmin(misfit))
    mean = means[best]
    return LinkAgreement(
        misfit=misfit, best=best + 1, direction=mean * np.sign(mean[np.argmax(np.abs(mean))])
    )


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
    moments: Array
    """Moment of the jig on the tool about the plane's normal [N·m] (N,)."""
    seat: Array
    """Place of the seat between its stops [m or rad] (N,)."""


def simulate_docked(
    arm: Arm,
    pose: ArrayLike,
    fault: Fault,
    torque: ArrayLike,
    *,
    jig: Jig = "clamp",
    every: int = 1,
) -> DockedRecord:
    """Drive the joints of a planar arm whose tool is held (3.18, 3.19, integrated by MuJoCo).

    Each joint has its drive's torque, its soft centring spring and its own damping; no brake.

    ``arm``: the arm; its motion must lie in the x-y plane, gravity normal to it. ``pose`` (n,):
    where it is docked [rad]. ``torque`` (n, steps): torque of each drive at every simulation step
    [N·m].

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.faults import Healthy
    >>> record = simulate_docked(planar(2), [0.1, 0.9], Healthy(), np.ones((2, 20)))
    >>> record.forces.shape
    (2, 20)
    """
    q, drive = np.asarray(pose, dtype=float), np.asarray(torque, dtype=float)
    model, data = _dock(arm, q, fault, jig)
    joints = [model.joint(name) for name in arm.joints]
    dofs = np.array([j.dofadr[0] for j in joints])
    at = np.array([j.qposadr[0] for j in joints])
    seat = int(model.joint(SEAT).qposadr[0])
    dock = model.equality("dock").id
    tool = model.site(arm.tool).id
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    count = drive.shape[1] // every
    rows = np.empty((count, 4 * arm.n + 1))
    wrench = np.zeros((count, 3))
    for k in range(count * every):
        data.qfrc_applied[dofs] = drive[:, k]
        state = data.qpos[at] - q
        passive_rate = data.qvel[dofs].copy()
        mujoco.mj_step(model, data)
        if (k + 1) % every:
            continue
        r = k // every
        springs = -model.jnt_stiffness[[j.id for j in joints]] * state
        net = drive[:, k] + springs - model.dof_damping[dofs] * passive_rate
        rows[r] = np.concatenate([state, data.qacc[dofs], net, data.qvel[dofs], [data.qpos[seat]]])
        held = np.flatnonzero((data.efc_type[: data.nefc] == 0) & (data.efc_id == dock))
        pull = data.efc_J.reshape(data.nefc, model.nv)[held].T @ data.efc_force[held]
        mujoco.mj_jacSite(model, data, linear, angular, tool)
        plane = linear[:2] if jig == "pin" else np.vstack([linear[:2], angular[2:]])
        wrench[r, : len(plane)] = np.linalg.lstsq(plane.T, pull, rcond=None)[0]
    if not np.isfinite(rows).all():
        raise InvalidData("the simulation of the docked arm diverged: lower torque or stiffness")
    n = arm.n
    return DockedRecord(
        angles=rows[:, :n].T.copy(),
        accelerations=rows[:, n : 2 * n].T.copy(),
        torques=rows[:, 2 * n : 3 * n].T.copy(),
        forces=wrench[:, :2].T.copy(),
        moments=wrench[:, 2].copy(),
        seat=rows[:, -1].copy(),
    )


def _dock(arm: Arm, q: Array, fault: Fault, jig: Jig) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile the arm with its seat and its tool in the jig, and bring it to its pose."""
    bare = mujoco.MjData(arm.model)
    bare.qpos[arm.pose_addresses] = q
    mujoco.mj_kinematics(arm.model, bare)
    place = bare.site(arm.tool)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, place.xmat)
    link, kind = seat_of(fault)
    spec = seated_spec(arm, arm.n if link is None else link, kind)
    spec.worldbody.add_site(name="jig", pos=place.xpos.tolist(), quat=quaternion.tolist())
    step = arm.timestep
    spec.add_equality(
        name="dock",
        type=mujoco.mjtEq.mjEQ_CONNECT if jig == "pin" else mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=arm.tool,
        name2="jig",
        solref=[2 * step, 1.0],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2],
    )
    spec.option.timestep = step
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
