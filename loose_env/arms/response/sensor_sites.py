"""Accelerometer sites on links, and the direction in which the own joint moves them.

The thesis expects wear first at the distal end of the link before a joint, in the tangential
direction (8.3.4). That end is where the next joint sits or, of the last link, where the tool
sits: it exists on any arm, and nearly all of the link's motion passes through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.arms.arm import Arm
from loose_env.errors import UnknownName
from loose_env.typing import Array

__all__ = ["CLEARANCE", "LinkSite", "Place", "link_site"]

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
