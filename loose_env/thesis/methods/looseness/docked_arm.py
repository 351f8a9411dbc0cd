"""The static-force test in space: a jig that yields, gravity, friction in the joints (8.1.2).

The tool stands in a jig, the drives carry the nominal weight and push slowly against it, all
joints at once. With the tool held, J δq + u ξ = C f: joints move because the jig yields to its
force f by its compliance C, or because a seat slides by ξ along u. Where the force is measured the
compliance need not be known: the seat's motion is what no linear function of the force explains,
because a seat keeps shut, then slides, then meets its stop. Without a force sensor the drives'
torques take the force's place, and friction in the joints comes between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm, MismatchDraw
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.faults import Fault, seat_of, seated_spec, set_seat
from loose_env.io import Checked, NonNegative, Positive
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.looseness.static_force_test import link_frames
from loose_env.typing import Array

__all__ = [
    "DockedMotion",
    "DockedVerdict",
    "JigSettings",
    "SeatMotion",
    "docked_verdict",
    "measure_docked",
    "seat_motion",
]

_LEVER = 0.1
"""Length by which turns of the tool are weighed against its shifts [m]."""
_JIG = ("jig_x", "jig_y", "jig_z", "jig_turn_x", "jig_turn_y", "jig_turn_z")
_STIFF = 0.9999


@dataclass(frozen=True, kw_only=True)
class JigSettings(Checked):
    """The jig, the friction of the joints, and what is read."""

    stiffness: Positive = 1e6
    """Stiffness of the jig along each axis [N/m]; about each axis it is 0.01 m² times that."""
    mass: Positive = 1.0
    """Mass of its moving part [kg]."""
    damping_ratio: NonNegative = 0.3
    """Damping ratio of the moving part alone on the jig [1]."""
    joint_friction: NonNegative = 0.0
    """Coulomb friction of every joint over the torque limit of its drive [1]."""
    encoder_noise: NonNegative = 2.7e-6
    """Rms error of an encoder, rounding included [rad, m where a joint slides]."""
    force_noise: NonNegative = 0.05
    """Rms error of the jig's force [N]; of its moment 0.1 m times that."""
    rate: Positive = 500.0
    """Readings a second [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DockedMotion:
    """Readings of one docked record and the nominal arm's kinematics."""

    pose: Array
    """Pose by the encoders [rad, m where a joint slides] (n,)."""
    jacobian: Array
    """Nominal Jacobian, world axes, turns in units of 0.1 m (6, n)."""
    frames: Array
    """Rotation from each link's frame to the world (n, 3, 3)."""
    angles: Array
    """Joint positions less the pose (n, N)."""
    torques: Array
    """Torques of the drives beyond the nominal weight [N·m] (n, N)."""
    forces: Array
    """Force and moment over 0.1 m of the jig on the tool, world axes [N] (6, N)."""
    noise: float
    """Rms error of an encoder."""


def measure_docked(
    arm: Arm,
    pose: ArrayLike,
    fault: Fault,
    torque: ArrayLike,
    rng: np.random.Generator,
    *,
    settings: JigSettings | None = None,
    mismatch: MismatchDraw | None = None,
) -> DockedMotion:
    """Push an arm slowly against its jig (integrated by MuJoCo).

    Parameters
    ----------
    arm : Arm
        The nominal arm, in the plane or in space; its gravity acts.
    pose : array_like (n,)
        Where it docks, by its encoders [rad, m where a joint slides]. The jig is moved to where the
        tool then is, and rests without force but for what the drives carry wrongly.
    fault : Fault
        Of one degree of freedom.
    torque : array_like (n, steps)
        Torque of each drive at every step of ``arm.timestep``, beside the nominal weight [N·m].
    rng : numpy.random.Generator
        Noise of the readings.
    settings : JigSettings, optional
        Jig, friction and readings.
    mismatch : MismatchDraw, optional
        How the true arm differs from the nominal one; not at all by default.

    Raises
    ------
    InvalidSetting
        If the jig is too stiff for the step, or the torques are not those of the arm's joints.
    InvalidData
        If the simulation diverged.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.faults import Healthy
    >>> push = np.ones((2, 50))
    >>> found = measure_docked(planar(2), [0.1, 0.9], Healthy(), push, np.random.default_rng(0))
    >>> found.forces.shape[0], found.jacobian.shape
    (6, (6, 2))
    """
    s = JigSettings() if settings is None else settings
    q, drive = np.asarray(pose, dtype=float), np.asarray(torque, dtype=float)
    if drive.ndim != 2 or len(drive) != arm.n:
        raise InvalidSetting(
            f"torque has a row for each of {arm.n} joints, got an array of shape {drive.shape}"
        )
    if np.sqrt(s.stiffness / s.mass) * arm.timestep > 1.0:
        most = s.mass / arm.timestep**2
        raise InvalidSetting(
            f"a jig of {s.stiffness:g} N/m with a mass of {s.mass:g} kg is too stiff for a step "
            f"of {arm.timestep:g} s; use {most:.2g} N/m at most, or a heavier jig"
        )
    off = MismatchDraw.none(arm) if mismatch is None else mismatch
    model, data, true = _docked(arm, q, fault, off, s)
    joints = [model.joint(name) for name in arm.joints]
    dofs = np.array([j.dofadr[0] for j in joints])
    at = np.array([j.qposadr[0] for j in joints])
    spring = np.array([model.joint(name).qposadr[0] for name in _JIG])
    weight = _weight(arm, q)
    every = max(round(1 / s.rate / arm.timestep), 1)
    count = drive.shape[1] // every
    rows = np.empty((count, arm.n + 6))
    for k in range(count * every):
        data.qfrc_applied[dofs] = off.drive_gain * (weight + drive[:, k])
        mujoco.mj_step(model, data)
        if (k + 1) % every == 0:
            rows[k // every] = np.concatenate([data.qpos[at] - true, data.qpos[spring]])
    if not np.isfinite(rows).all():
        raise InvalidData("the docked arm diverged: lower the torque or the jig's stiffness")
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, model.body("jig").quat)
    # Moments over the lever: 0.01 m² k times the turns, over 0.1 m.
    scale = s.stiffness * np.array([1.0, _LEVER])
    force = -np.einsum(
        "s,ij,sjk->sik", scale, turned.reshape(3, 3), rows[:, arm.n :].T.reshape(2, 3, -1)
    )
    force = force.reshape(6, -1)
    angles = rows[:, : arm.n].T
    jacobian = geometric_jacobian(Chain.of(arm, q))
    jacobian[3:] *= _LEVER
    return DockedMotion(
        pose=q,
        jacobian=jacobian,
        frames=link_frames(arm, q),
        angles=angles + s.encoder_noise * rng.standard_normal(angles.shape),
        torques=drive[:, : count * every].reshape(arm.n, count, every)[..., -1],
        forces=force + s.force_noise * rng.standard_normal(force.shape),
        noise=s.encoder_noise,
    )


def _weight(arm: Arm, pose: Array) -> Array:
    """Torque that carries the nominal arm's weight (n,)."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    dofs = [arm.model.joint(name).dofadr[0] for name in arm.joints]
    return np.array(data.qfrc_bias[dofs])


def _docked(
    arm: Arm, pose: Array, fault: Fault, off: MismatchDraw, s: JigSettings
) -> tuple[mujoco.MjModel, mujoco.MjData, Array]:
    """Compile the true arm with its tool in the jig; return its true pose too."""
    link, kind = seat_of(fault)
    spec = seated_spec(arm, arm.n if link is None else link, kind)
    spec.option.timestep = arm.timestep
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    true = pose + off.joint_zero
    for j, name in enumerate(arm.joints):
        joint = spec.joint(name)
        joint.stiffness = [arm.centring.stiffness[j], 0, 0]
        joint.damping = [joint.damping[0] + arm.centring.damping[j], 0, 0]
        joint.springref = float(true[j])
        joint.frictionloss = s.joint_friction * arm.torque_limits[j]
        joint.solimp_friction = [_STIFF, _STIFF, 0.001, 0.5, 2]
        joint.solref_friction = [2 * arm.timestep, 1.0]
    jig = spec.worldbody.add_body(name="jig", gravcomp=1.0)
    jig.mass, jig.inertia = s.mass, [s.mass * _LEVER**2] * 3
    jig.ipos, jig.explicitinertial = [0, 0, 0], True
    for k, name in enumerate(_JIG):
        turns = k >= 3
        scale = _LEVER**2 if turns else 1.0
        jig.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=np.eye(3)[k % 3].tolist(),
            stiffness=[scale * s.stiffness, 0, 0],
            damping=[scale * 2 * s.damping_ratio * np.sqrt(s.stiffness * s.mass), 0, 0],
        )
    jig.add_site(name="jig")
    spec.add_equality(
        name="dock",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=arm.tool,
        name2="jig",
        solref=[2 * arm.timestep, 1.0],
        solimp=[_STIFF, _STIFF, 0.001, 0.5, 2],
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    off.apply(model, arm, data)
    set_seat(model, fault, data)
    mujoco.mj_resetData(model, data)
    for name, value in zip(arm.joints, true, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    place, body = data.site(arm.tool), model.body("jig").id
    model.body_pos[body] = place.xpos
    mujoco.mju_mat2Quat(model.body_quat[body], place.xmat)
    mujoco.mj_forward(model, data)
    return model, data, true


@dataclass(frozen=True, kw_only=True, eq=False)
class SeatMotion:
    """Motion of a seat at the tool that one docked record shows."""

    twist: Array
    """Shift and turn times 0.1 m along the motion, world axes, unit vector (6,), axial."""
    size: float
    """Rms of the motion along it [m]."""
    over_noise: float
    """The same over what the encoders' errors leave [1]."""
    share: float
    """Share of all unexplained motion that lies along it, 0 to 1."""


def seat_motion(record: DockedMotion, *, by_force: bool = True) -> SeatMotion:
    """Motion at the tool that the jig's force does not explain, or the drives' torques.

    Parameters
    ----------
    record : DockedMotion
        Readings.
    by_force : bool
        True to take the force of the jig, False to take the torques, as without a force sensor.

    Examples
    --------
    >>> import numpy as np
    >>> force = np.random.default_rng(0).standard_normal((6, 400))
    >>> slides = 1e-4 * np.sign(force[1])  # a seat along y meets its stops
    >>> record = DockedMotion(
    ...     pose=np.zeros(6),
    ...     jacobian=np.eye(6),
    ...     frames=np.tile(np.eye(3), (6, 1, 1)),
    ...     angles=1e-6 * force - np.outer(np.eye(6)[1], slides),
    ...     torques=force,
    ...     forces=force,
    ...     noise=1e-6,
    ... )
    >>> seat_motion(record).twist.round(2).tolist()
    [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    """
    x = record.angles - record.angles.mean(axis=1, keepdims=True)
    known = record.forces if by_force else record.torques
    known = known - known.mean(axis=1, keepdims=True)
    moved = -record.jacobian @ x
    slope = np.linalg.lstsq(known.T, moved.T, rcond=None)[0].T
    values, vectors = np.linalg.eigh((moved - slope @ known) @ (moved - slope @ known).T)
    twist = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
    size = float(np.sqrt(values[-1] / x.shape[1]))
    noise = record.noise * float(np.linalg.norm(twist @ record.jacobian))
    return SeatMotion(
        twist=twist,
        size=size,
        over_noise=size / max(noise, 1e-300),
        share=float(values[-1] / values.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class DockedVerdict:
    """Hypothesis that the docked records of several poses name."""

    hypothesis: str
    """`healthy`, a slide of a link or play in a joint."""
    misfit: Array
    """Rms angle of the seen motions to those of a slide of link 1 to n, then of play in joint 1 to
    n [rad] (2 n,)."""
    direction: Array
    """Direction of the slide that fits best in its link's frame (3,), axial."""
    seen: int
    """Poses that show something."""


def docked_verdict(
    records: Sequence[DockedMotion], *, by_force: bool = True, seen: float = 3.0
) -> DockedVerdict:
    """Name the link or joint whose looseness fits the docked records of several poses.

    A slide shifts the tool along one line of its link's frame and turns it nowhere; play turns it
    about its joint, which is known. One pose fits a slide of every link, so less than two poses
    that show something name none.

    Parameters
    ----------
    records : sequence of DockedMotion
        One for each pose.
    by_force : bool
        As for `seat_motion`.
    seen : float
        Unexplained motion over the encoders' noise from which a pose shows something [1].
    """
    shown = [(r, m) for r in records if (m := seat_motion(r, by_force=by_force)).over_noise > seen]
    n = records[0].jacobian.shape[1]
    if len(shown) < 2:
        none = np.full(2 * n, np.nan)
        return DockedVerdict(
            hypothesis="healthy", misfit=none, direction=np.zeros(3), seen=len(shown)
        )
    twists = np.array([motion.twist for _, motion in shown])
    columns = np.array([record.jacobian for record, _ in shown])
    frames = np.array([record.frames for record, _ in shown])
    size = np.linalg.norm(columns, axis=1)
    along = np.einsum("tin,ti->tn", columns, twists) / np.where(size > 0, size, 1.0)
    play = np.sum(1 - along**2, axis=0) / (5 * len(shown))
    own = np.einsum("tkdc,td->tkc", frames, twists[:, :3])
    values, vectors = np.linalg.eigh(np.einsum("tka,tkb->kab", own, own))
    # The direction of a slide is fitted: two numbers less.
    slide = (len(shown) - values[:, -1]) / (5 * len(shown) - 2)
    misfit = np.sqrt(np.maximum(np.concatenate([slide, play]), 0.0))
    best = int(np.argmin(misfit))
    kind = f"structural_looseness@link{best + 1}" if best < n else f"backlash@joint{best - n + 1}"
    return DockedVerdict(
        hypothesis=kind,
        misfit=misfit,
        direction=vectors[int(np.argmin(slide)), :, -1],
        seen=len(shown),
    )
