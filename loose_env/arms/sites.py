"""Sites of link accelerometers, and arms shaken from outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms.arm import COIL, Arm, add_shaker, place_shaker
from loose_env.arms.linear import inertance_rate
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.typing import Array, ComplexArray

Place = Literal["proximal", "distal"]

CLEARANCE = 0.05
"""Least distance of a distal sensor from the axis of the link's own joint [m].

In a wrist whose axes cross, the next joint's centre lies on the own joint's axis, where that
joint's motion shows nothing. A sensor sits on the outside of the link, off the axis."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkSite:
    """A place on a link, in the frame of the body that carries it."""

    link: int
    """Number of the link."""
    body: str
    """The body: of a link that bends, the part at that end."""
    position: Array
    """Position in the body's frame [m] (3,)."""
    tangent: Array
    """Direction in which the link's own joint moves the place, unit vector, body frame (3,)."""
    scaled_by: int
    """Body of the bare arm whose distance from its parent the place shares; -1 for none."""

    @property
    def tangential_frame(self) -> Array:
        """Rotation whose x axis is the tangent; columns are its axes in the body's frame (3, 3)."""
        x = self.tangent
        z = np.eye(3)[int(np.argmin(np.abs(x)))]
        z = z - (z @ x) * x
        z /= np.linalg.norm(z)
        return np.column_stack([x, np.cross(z, x), z])

    @property
    def tangential_quat(self) -> list[float]:
        """`tangential_frame` as a quaternion (4,)."""
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, self.tangential_frame.ravel())
        return [float(q) for q in quat]


def link_site(arm: Arm, link: int, place: Place = "distal") -> LinkSite:
    """Find a place on a link.

    Parameters
    ----------
    arm : Arm
        The arm.
    link : int
        Number of the link, from 1 at the base.
    place : {"distal", "proximal"}
        "distal": where the next joint sits, or the tool on the last link, but `CLEARANCE` off
        the axis of a turning joint at least. "proximal": the origin of the link's seat, where
        its own turning joint has no lever; the tangent is zero there.

    Raises
    ------
    UnknownName
        If there is no such link or place.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> site = link_site(planar(3), 1)
    >>> site.body, site.position.tolist(), site.tangent.tolist()
    ('link1', [0.3, 0.0, 0.0], [0.0, 1.0, 0.0])
    """
    i = arm.link_number(link) - 1
    if place not in ("proximal", "distal"):
        raise UnknownName(f"a sensor sits at the 'proximal' or 'distal' end, got {place!r}")
    m = arm.model
    if place == "proximal":
        return LinkSite(
            link=link,
            body=arm.seat_bodies[i],
            position=np.zeros(3),
            tangent=np.zeros(3),
            scaled_by=-1,
        )
    if i + 1 < arm.n:
        joint = m.joint(arm.joints[i + 1])
        beyond = scaled_by = int(joint.bodyid[0])
        body = int(m.body_parentid[beyond])
        anchor = np.zeros(3)
        mujoco.mju_rotVecQuat(anchor, joint.pos, m.body_quat[beyond])
        position = m.body_pos[beyond] + anchor
    else:
        site = m.site(arm.tool)
        body = scaled_by = int(site.bodyid[0])
        position = np.array(site.pos)
    # The rest of the arm does not matter: the own joint moves all of the link alike.
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    turn = data.xmat[body].reshape(3, 3)
    own = m.joint(arm.joints[i])
    axis = turn.T @ data.xaxis[own.id]
    if own.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
        tangent = axis
    else:
        lever = position - turn.T @ (data.xanchor[own.id] - data.xpos[body])
        lever = lever - (lever @ axis) * axis
        length = float(np.linalg.norm(lever))
        if length < CLEARANCE:
            if length > 1e-6:
                away = lever / length
            else:
                away = np.eye(3)[int(np.argmin(np.abs(axis).round(9)))]
                away = away - (away @ axis) * axis
                away /= np.linalg.norm(away)
            position = position + (CLEARANCE - length) * away
            lever = CLEARANCE * away
        tangent = np.cross(axis, lever)
        tangent /= np.linalg.norm(tangent)
    return LinkSite(
        link=link,
        body=m.body(body).name,
        position=position,
        tangent=tangent.round(12) + 0.0,
        scaled_by=scaled_by,
    )


@dataclass(frozen=True, kw_only=True)
class ShakenResponse:
    """Accelerations per unit force of the shaker, over the band."""

    frequency: Array
    """Frequencies [Hz] (K,)."""
    tool: ComplexArray
    """Tool acceleration in the tool frame [m/s² per N] (K, d)."""
    probes: Mapping[str, ComplexArray]
    """Acceleration of every probe along its own axes [m/s² per N] (K, 3)."""

    def covariances(self, probe: str, axis: int) -> tuple[float, Array, Array]:
        """Covariances that white force over the band gives."""
        x, a = self.probes[probe][:, axis], self.tool
        count = len(self.frequency)
        return (
            float(np.mean(np.abs(x) ** 2)),
            np.asarray((x.conj() @ a).real / count),
            np.asarray((a.conj().T @ a).real / count),
        )


class ShakenArm:
    """A healthy arm on its shaker, linearised wherever it is asked to be.

    Parameters
    ----------
    arm : Arm
        An arm that stands at a shaker.
    points : int
        Number of frequencies across the arm's band.

    Raises
    ------
    InvalidSetting
        If the arm has no shaker.
    """

    def __init__(self, arm: Arm, *, points: int = 400) -> None:
        if arm.shaker is None:
            raise InvalidSetting(f"arm {arm.name!r} has no shaker to answer")
        self.arm, self.shaker = arm, arm.shaker
        spec = arm.spec.copy()
        add_shaker(spec, arm.shaker)
        self.model = spec.compile()
        self.frequency = np.linspace(*arm.band, points)

    def at(self, pose: ArrayLike) -> ShakenResponse:
        """Give the answer at a pose [rad or m] (n,).

        Raises
        ------
        InvalidSetting
            If the pose does not have one finite number for every joint.
        """
        arm, model = self.arm, self.model
        q = np.asarray(pose, dtype=float)
        if q.shape != (arm.n,) or not np.isfinite(q).all():
            raise InvalidSetting(
                f"a pose of {arm.name!r} is {arm.n} finite joint positions, got {pose!r}"
            )
        data = mujoco.MjData(model)
        data.qpos[[model.joint(name).qposadr[0] for name in arm.joints]] = q
        place_shaker(model, data, self.shaker)
        mujoco.mj_forward(model, data)
        omega = 2 * np.pi * self.frequency
        force = np.zeros((model.nv, 1), dtype=complex)
        force[model.joint("shaker").dofadr[0]] = 1.0
        motion = np.linalg.solve(
            self._stiffness(data, omega), np.broadcast_to(force, (len(omega), *force.shape))
        )
        acceleration = -(omega**2)[:, None] * motion[..., 0]

        def moves(site: str) -> ComplexArray:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, model.site(site).id)
            frame = data.site(site).xmat.reshape(3, 3)
            return np.asarray(acceleration @ (frame.T @ jacobian).T)

        return ShakenResponse(
            frequency=self.frequency,
            tool=moves(arm.tool)[:, list(arm.axes)],
            probes={site: moves(site) for site in arm.probe_sites},
        )

    def _stiffness(self, data: mujoco.MjData, omega: Array) -> ComplexArray:
        """Dynamic stiffness of every degree of freedom (K, nv, nv)."""
        arm, model = self.arm, self.model
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        stiffness = np.diag(model.jnt_stiffness[model.dof_jntid]).astype(float)
        damping = np.diag(model.dof_damping).astype(float)
        for j, name in enumerate(arm.joints):
            dof = model.joint(name).dofadr[0]
            stiffness[dof, dof] += arm.centring.stiffness[j]
            damping[dof, dof] += arm.centring.damping[j]
            if j != self.shaker.joint - 1:
                stiffness[dof, dof] += arm.holding.stiffness[j]
                damping[dof, dof] += arm.holding.damping[j]
                mass[dof, dof] += arm.holding.stiffness[j] / inertance_rate(arm.timestep) ** 2
        stinger = _stinger_row(model, data)
        stiffness += self.shaker.stinger_stiffness * np.outer(stinger, stinger)
        damping += self.shaker.stinger_damping * np.outer(stinger, stinger)
        s = 1j * omega[:, None, None]
        return np.asarray(stiffness + s * damping + s**2 * mass)


def _stinger_row(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Change of the stinger's length per motion of each degree of freedom (nv,)."""
    ends = np.zeros((2, 3, model.nv))
    for end, site in zip(ends, (COIL, "stinger_end"), strict=True):
        mujoco.mj_jacSite(model, data, end, None, model.site(site).id)
    along = data.site("stinger_end").xpos - data.site(COIL).xpos
    return np.asarray((along / np.linalg.norm(along)) @ (ends[1] - ends[0]))
