"""Joint forces and torques of an arm in a given motion (thesis 5.2, 6.1.2, 7.2.2).

Twice: in closed form for two links in the plane, and from MuJoCo's inverse dynamics for any arm.
A force at a joint is what the part on the base's side exerts on the part on the tool's side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.kinematics import carried_bodies
from loose_env.typing import Array

GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True)
class TwoLinks:
    """Two rigid links in a horizontal plane (6.2-6.5); centres of mass lie on the links."""

    length: float
    """From joint 1 to joint 2, l1 [m]."""
    masses: tuple[float, float]
    """Of either link, m1 and m2 [kg]."""
    centres: tuple[float, float]
    """From a link's own joint to its centre of mass, lc1 and lc2 [m]."""
    inertias: tuple[float, float]
    """About the centres of mass, I1 and I2 [kg m²]."""
    rotors: tuple[float, float] = (0.0, 0.0)
    """Inertia of each drive's rotor seen at its joint [kg m²]; the thesis has none."""

    @classmethod
    def of(cls, arm: Arm) -> TwoLinks:
        """Lump the bodies of a planar arm of two hinges into two links; bending modes at rest.

        Examples
        --------
        >>> from loose_env.arms import vera
        >>> round(TwoLinks.of(vera()).length, 3)
        0.4
        """
        model = arm.model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        joints = [model.joint(name) for name in arm.joints]
        anchors = data.xanchor[[j.id for j in joints]]
        outer = [carried_bodies(model, int(j.bodyid[0])) for j in joints]
        masses, centres, inertias = [], [], []
        for k, bodies in enumerate((outer[0] & ~outer[1], outer[1])):
            mass = model.body_mass[bodies]
            middle = mass @ data.xipos[bodies] / mass.sum()
            turned = data.ximat[bodies].reshape(-1, 3, 3)[:, 2, :]  # z row: inertia about z
            own = np.einsum("bi,bi->b", turned**2, model.body_inertia[bodies])
            about = own + mass * np.sum((data.xipos[bodies] - middle)[:, :2] ** 2, axis=1)
            masses.append(float(mass.sum()))
            centres.append(float(middle[0] - anchors[k, 0]))
            inertias.append(float(about.sum()))
        rotors = [float(model.dof_armature[j.dofadr[0]]) for j in joints]
        return cls(
            length=float(anchors[1, 0] - anchors[0, 0]),
            masses=(masses[0], masses[1]),
            centres=(centres[0], centres[1]),
            inertias=(inertias[0], inertias[1]),
            rotors=(rotors[0], rotors[1]),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLoads:
    """Joint loads in the frame of the link each joint moves: x along it, z up."""

    torque: Array
    """Torque of each drive [N m], or force where the joint slides [N] (..., n)."""
    force: Array
    """Force at each joint [N] (..., n, 3)."""
    moment: Array
    """Moment about each joint's anchor, without the rotors' share [N m] (..., n, 3)."""


def two_link_loads(
    links: TwoLinks,
    angle: ArrayLike,
    rates: ArrayLike,
    accelerations: ArrayLike,
    *,
    gravity: float = GRAVITY,
) -> JointLoads:
    """Loads of two links in closed form (6.2-6.5; their torques are 3.41).

    Gravity acts along -z. The thesis prints I1 + m2 lc1² in (6.2) and (3.41): it is
    I1 + m1 lc1², as here. In (3.41) it prints the bracket after S2 again after C2: the one after
    C2 is lc2 θ12'' + S2 l1 θ1'² + C2 l1 θ1'', as (6.5) has it.

    ``angle`` (...): of joint 2, zero with the arm straight [rad]. ``rates``, ``accelerations``
    (..., 2): of both joints [rad/s, rad/s²]; all three broadcast. ``gravity``: [m/s²].

    Examples
    --------
    >>> links = TwoLinks(length=1.0, masses=(1.0, 1.0), centres=(1.0, 1.0), inertias=(0.0, 0.0))
    >>> two_link_loads(links, 0.0, [1.0, 0.0], [0.0, 0.0]).force[:, 0]
    array([-3., -2.])
    """
    q, v, a = (np.asarray(x, dtype=float) for x in (angle, rates, accelerations))
    q, v1, v2, a1, a2 = np.broadcast_arrays(q, v[..., 0], v[..., 1], a[..., 0], a[..., 1])
    (m1, m2), (c1, c2), (i1, i2) = links.masses, links.centres, links.inertias
    l1, s, c = links.length, np.sin(q), np.cos(q)
    v12, a12, weight = v1 + v2, a1 + a2, np.full(q.shape, gravity)
    # (6.5)
    x2 = m2 * (-c2 * v12**2 - c * l1 * v1**2 + s * l1 * a1)
    y2 = m2 * (c2 * a12 + s * l1 * v1**2 + c * l1 * a1)
    # (6.3)
    n2 = c2 * m2 * (c2 * a12 + l1 * (s * v1**2 + c * a1)) + i2 * a12
    # (6.4)
    x1 = -m1 * c1 * v1**2 - m2 * (c2 * (c * v12**2 + s * a12) + l1 * v1**2)
    y1 = m1 * c1 * a1 + m2 * (c2 * (-s * v12**2 + c * a12) + l1 * a1)
    # (6.2)
    n1 = (i1 + m1 * c1**2) * a1 + l1 * (s * x2 + c * y2) + n2
    moment = [
        [s * m2 * c2 * weight, -(m1 * c1 + m2 * l1 + c * m2 * c2) * weight, n1],
        [np.zeros(q.shape), -c2 * m2 * weight, n2],
    ]
    force = [[x1, y1, (m1 + m2) * weight], [x2, y2, m2 * weight]]
    torque = [n1 + links.rotors[0] * a1, n2 + links.rotors[1] * a2]
    return JointLoads(
        torque=np.moveaxis(np.array(torque), 0, -1),
        force=np.moveaxis(np.array(force), (0, 1), (-2, -1)),
        moment=np.moveaxis(np.array(moment), (0, 1), (-2, -1)),
    )


def arm_loads(
    arm: Arm, pose: ArrayLike, rates: ArrayLike, accelerations: ArrayLike, *, gravity: bool = True
) -> JointLoads:
    """Loads of any arm in one pose and motion: (3.11), MuJoCo's inverse dynamics.

    Bending modes are at rest. Friction and springs of the joints are left out, as in 6.1.2.
    ``pose``, ``rates``, ``accelerations`` (n,): of the joints [rad, rad/s, rad/s²]. ``gravity``:
    whether the arm's gravity acts.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> loads = arm_loads(planar(2), [0.0, 0.5], [0.0, 0.0], [0.0, 0.0])
    >>> bool(np.abs(loads.torque).max() < 1e-9)  # gravity is across the plane
    True
    """
    motion = [np.asarray(x, dtype=float) for x in (pose, rates, accelerations)]
    model = arm.model
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in arm.joints]
    dofs = [int(j.dofadr[0]) for j in joints]
    data.qpos[arm.pose_addresses], data.qvel[dofs], data.qacc[dofs] = motion
    mujoco.mj_inverse(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    force, moment, torque = np.zeros((arm.n, 3)), np.zeros((arm.n, 3)), np.zeros(arm.n)
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    for k, joint in enumerate(joints):
        body = int(joint.bodyid[0])
        anchor = data.xanchor[joint.id]
        # MuJoCo's wrench is about the centre of mass of the whole tree, in world axes.
        reference = data.subtree_com[model.body_rootid[body]]
        push = data.cfrc_int[body, 3:].copy()
        turn = data.cfrc_int[body, :3] - np.cross(anchor - reference, push)
        if not gravity:
            distal = carried_bodies(model, body)
            weights = model.body_mass[distal, None] * model.opt.gravity
            push += weights.sum(axis=0)
            turn += np.cross(data.xipos[distal] - anchor, weights).sum(axis=0)
        axis = data.xaxis[joint.id]
        own = model.dof_armature[dofs[k]] * motion[2][k]
        torque[k] = axis @ (push if joint.type[0] == slide else turn) + own
        frame = data.xmat[body].reshape(3, 3)
        force[k], moment[k] = push @ frame, turn @ frame
    return JointLoads(torque=torque, force=force, moment=moment)


@dataclass(frozen=True, kw_only=True)
class PeakForce:
    """Maximum of a joint's planar force over a sweep, and its location."""

    size: float
    """Force [N]."""
    along: float
    """Its part along the link [N]; negative pulls the link inward."""
    across: float
    """Its part across the link, in the plane [N]."""
    at: tuple[float, ...]
    """Settings of the sweep at the peak."""

    @property
    def direction(self) -> str:
        """Larger of the two components: "longitudinal" or "tangential"."""
        return "longitudinal" if abs(self.along) >= abs(self.across) else "tangential"


def peak_force(force: ArrayLike, settings: Sequence[ArrayLike]) -> PeakForce:
    """Find the maximum planar force over a sweep (5.2).

    ``force`` (..., 2) or (..., 3): along and across a link [N]; what follows is ignored.
    ``settings`` (...): swept quantities, which broadcast to the sweep's shape. The first of equal
    peaks counts.

    Examples
    --------
    >>> peak_force([[1.0, 0.0], [0.0, -2.0]], [[10.0, 20.0]]).at
    (20.0,)
    """
    f = np.asarray(force, dtype=float)
    swept = [np.broadcast_to(np.asarray(s, dtype=float), f.shape[:-1]) for s in settings]
    size = np.hypot(f[..., 0], f[..., 1])
    first = int(np.flatnonzero(size.ravel() >= size.max() * (1 - 1e-12))[0])
    where = np.unravel_index(first, size.shape)
    return PeakForce(
        size=float(size[where]),
        along=float(f[(*where, 0)]),
        across=float(f[(*where, 1)]),
        at=tuple(float(s[where]) for s in swept),
    )
