"""Manipulability ellipsoids of an arm and of its proximal part (thesis 6.4, 8.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Ellipsoid:
    """Manipulability ellipsoid: half axes, longest first, and their directions."""

    lengths: Array
    """Half axes (d,) [m/s for unit rates, or m/s per √(N m s²) if weighted by energy]."""
    axes: Array
    """Unit vectors of the half axes in columns (d, d); their sign means nothing."""

    @property
    def aspect(self) -> float:
        """Ratio of longest to shortest half axis; infinite if the arm is singular."""
        short = float(self.lengths[-1])
        return float(self.lengths[0]) / short if short > 0 else float("inf")


def ellipsoid(jacobian: ArrayLike, inertia: ArrayLike | None = None) -> Ellipsoid:
    """Manipulability ellipsoid of a Jacobian, plain or weighted by energy (8.2.3).

    Plain, it is the image of joint rates with |q'| = 1: axes of J Jᵀ. With an inertia matrix it
    is the image of rates with q'ᵀ M q' = 1, of equal kinetic energy: axes of J M⁻¹ Jᵀ.
    ``jacobian`` (d, n): linear rows [m]. ``inertia`` (n, n): that of the joints [kg m²].

    Examples
    --------
    >>> ellipsoid([[2.0, 0.0], [0.0, 1.0]]).lengths
    array([2., 1.])
    """
    j = np.asarray(jacobian, dtype=float)
    if inertia is not None:
        root = np.linalg.cholesky(np.asarray(inertia, dtype=float))
        j = np.linalg.solve(root, j.T).T  # J L⁻ᵀ, so that its square is J M⁻¹ Jᵀ
    axes, lengths, _ = np.linalg.svd(j, full_matrices=True)
    full = np.zeros(j.shape[0])
    full[: len(lengths)] = lengths
    return Ellipsoid(lengths=full, axes=axes)


def direction_deg(vector: ArrayLike) -> float:
    """Angle of a vector (2,) from the y axis, counter-clockwise as in the thesis [deg], 0 to 360.

    Examples
    --------
    >>> direction_deg([-1.0, 0.0])
    90.0
    """
    x, y = np.asarray(vector, dtype=float)
    return float(np.degrees(np.arctan2(-x, y)) % 360)


def axis_difference_deg(a: float, b: float) -> float:
    """Signed difference of two undirected axes, a - b, from -90 to 90 [deg].

    Examples
    --------
    >>> axis_difference_deg(209.0, 29.0)
    0.0
    """
    return float((a - b + 90) % 180 - 90)


def rotation_line(arm: Arm, pose: ArrayLike) -> Array:
    """Direction of tool motion due to joint 1, z × R, in the tool frame (d,).

    Examples
    --------
    >>> from loose_env.arms import vera
    >>> round(direction_deg(rotation_line(vera(), [0.0, np.radians(122.0)])))
    299
    """
    column = geometric_jacobian(Chain.of(arm, pose), "tool")[list(arm.axes), 0]
    return np.asarray(column / np.linalg.norm(column))


def joint_inertia(arm: Arm, pose: ArrayLike) -> Array:
    """Inertia matrix of the joints with bending modes at rest [kg m²] (n, n).

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> joint_inertia(planar(3), [0.0, 0.1, 0.2]).shape
    (3, 3)
    """
    data = _placed(arm, pose)
    full = np.zeros((arm.model.nv, arm.model.nv))
    mujoco.mj_fullM(arm.model, data, full)
    dofs = [int(arm.model.joint(name).dofadr[0]) for name in arm.joints]
    return full[np.ix_(dofs, dofs)]


def submanipulator_jacobian(arm: Arm, pose: ArrayLike, link: int) -> Array:
    """Jacobian of the proximal part that carries a link and its descendants (8.2.3).

    Joints 1 to ``link`` move; everything distal to them is locked and rides along. The point is
    the centre of mass of the distal segment, which the seat has to drive. Returns (d, link):
    motion of the point per joint motion, in the axes of the link [m].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> submanipulator_jacobian(planar(3), [0.0, 0.1, 0.2], 2).shape
    (2, 2)
    """
    number = arm.link_number(link)
    data = _placed(arm, pose)
    model = arm.model
    body = model.body(arm.seat_bodies[number - 1]).id
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, data.subtree_com[body], body)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints[:number]]
    frame = data.xmat[body].reshape(3, 3)
    return np.asarray((frame.T @ jacobian)[list(arm.axes)][:, dofs])


def submanipulator(arm: Arm, pose: ArrayLike, link: int) -> Ellipsoid:
    """Energy-weighted ellipsoid of the proximal part, J M⁻¹ Jᵀ (8.2.3).

    M is that of joints 1 to ``link`` while the others are locked.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> float(submanipulator(planar(3), [0.0, 0.1, 0.2], 1).lengths[1])  # one joint, one line
    0.0
    """
    jacobian = submanipulator_jacobian(arm, pose, link)
    return ellipsoid(jacobian, joint_inertia(arm, pose)[:link, :link])


def _placed(arm: Arm, pose: ArrayLike) -> mujoco.MjData:
    """Arm without seat at a pose (n,) [rad], bending modes at rest."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    return data
