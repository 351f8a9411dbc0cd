"""A docked arm in simulation: its tool held by a jig while its joints are driven (thesis 8.1.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.faults import SEAT, Fault, seat_of, seated_spec, set_seat
from loose_env.typing import Array

__all__ = ["DockedRecord", "Jig", "simulate_docked"]

Jig = Literal["pin", "clamp"]
"""A pin holds the tool's place and lets it turn; a clamp holds place and orientation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DockedRecord:
    """What happened while the tool stood in its jig; true values, no sensor noise."""

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
    """Drive the joints of a planar arm whose tool is held.

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
    if jig not in ("pin", "clamp"):
        raise UnknownName(f"unknown jig {jig!r}: 'pin' or 'clamp'")
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(f"a pose of {arm.name!r} is {arm.n} finite numbers, got {pose!r}")
    if drive.ndim != 2 or drive.shape[0] != arm.n or not np.isfinite(drive).all():
        raise InvalidSetting(
            f"torque of {arm.name!r} is finite and of shape ({arm.n}, steps), got {drive.shape}"
        )
    if isinstance(every, bool) or every < 1:
        raise InvalidSetting(f"every is a whole number of steps, at least 1; got {every!r}")
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
