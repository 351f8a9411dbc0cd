"""Manipulability ellipsoids of an arm and of its proximal part (thesis 6.4, 8.2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics.chain import Chain
from loose_env.kinematics.jacobian import geometric_jacobian
from loose_env.typing import Array

__all__ = [
    "Ellipsoid",
    "LinkPoint",
    "axis_difference_deg",
    "direction_deg",
    "ellipsoid",
    "joint_inertia",
    "rotation_line",
    "submanipulator",
    "submanipulator_jacobian",
]

AngleFrom = Literal["x", "y"]
LinkPoint = Literal["centre", "seat"]


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

    @property
    def measure(self) -> float:
        """Product of the half axes: the manipulability measure."""
        return float(np.prod(self.lengths))


def ellipsoid(jacobian: ArrayLike, inertia: ArrayLike | None = None) -> Ellipsoid:
    """Manipulability ellipsoid of a Jacobian, plain or weighted by energy (8.2.3).

    Plain, it is the image of joint rates with |q'| = 1: axes of J Jᵀ. With an inertia matrix it
    is the image of rates with q'ᵀ M q' = 1, of equal kinetic energy: axes of J M⁻¹ Jᵀ.

    Parameters
    ----------
    jacobian : array (d, n)
        Linear rows of the Jacobian [m].
    inertia : array (n, n), optional
        Inertia matrix of the joints [kg m²].

    Raises
    ------
    InvalidData
        If a matrix has the wrong shape, is not finite, or M is not positive definite.

    Examples
    --------
    >>> ellipsoid([[2.0, 0.0], [0.0, 1.0]]).lengths
    array([2., 1.])
    """
    j = np.asarray(jacobian, dtype=float)
    if j.ndim != 2 or 0 in j.shape or not np.isfinite(j).all():
        raise InvalidData(f"a Jacobian is (d, n) and finite, got shape {j.shape}")
    if inertia is not None:
        m = np.asarray(inertia, dtype=float)
        if m.shape != (j.shape[1],) * 2 or not np.isfinite(m).all():
            raise InvalidData(f"the inertia of {j.shape[1]} joints is square, got {m.shape}")
        if not np.allclose(m, m.T, rtol=1e-9, atol=1e-12 * np.abs(m).max()):
            raise InvalidData("an inertia matrix is symmetric; this one is not")
        try:
            root = np.linalg.cholesky(m)
        except np.linalg.LinAlgError as error:
            raise InvalidData("an inertia matrix must be positive definite") from error
        j = np.linalg.solve(root, j.T).T  # J L⁻ᵀ, so that its square is J M⁻¹ Jᵀ
    axes, lengths, _ = np.linalg.svd(j, full_matrices=True)
    full = np.zeros(j.shape[0])
    full[: len(lengths)] = lengths
    return Ellipsoid(lengths=full, axes=axes)


def direction_deg(vector: ArrayLike, *, measured_from: AngleFrom = "y") -> float:
    """Angle of a vector in the plane, counter-clockwise from an axis [deg], 0 to 360.

    Parameters
    ----------
    vector : array (2,)
        Not zero.
    measured_from : {"y", "x"}
        The thesis measures from the y axis of link 2.

    Raises
    ------
    InvalidData
        If the vector is zero, not finite or not in the plane.

    Examples
    --------
    >>> direction_deg([-1.0, 0.0])
    90.0
    """
    v = np.asarray(vector, dtype=float)
    if v.shape != (2,) or not np.isfinite(v).all() or not np.linalg.norm(v) > 0:
        raise InvalidData(f"a direction in the plane is two finite numbers, not both zero: {v}")
    if measured_from not in ("x", "y"):
        raise UnknownName(f"angles are measured from 'x' or 'y', got {measured_from!r}")
    angle = np.arctan2(-v[0], v[1]) if measured_from == "y" else np.arctan2(v[1], v[0])
    return float(np.degrees(angle) % 360)


def axis_difference_deg(a: float, b: float) -> float:
    """Signed difference of two undirected axes, a - b, from -90 to 90 [deg].

    Examples
    --------
    >>> axis_difference_deg(209.0, 29.0)
    0.0
    """
    if not (np.isfinite(a) and np.isfinite(b)):
        raise InvalidData(f"angles must be finite, got {a} and {b}")
    return float((a - b + 90) % 180 - 90)


def rotation_line(arm: Arm, pose: ArrayLike, joint: int = 1) -> Array:
    """Direction of tool motion due to one joint, z × R, in the tool frame (d,).

    Raises
    ------
    InvalidData
        If the tool lies on the joint's axis, so that it does not move.

    Examples
    --------
    >>> from loose_env.arms import vera
    >>> round(direction_deg(rotation_line(vera(), [0.0, np.radians(122.0)])))
    299
    """
    number = arm.link_number(joint)
    column = geometric_jacobian(Chain.of(arm, pose), "tool")[list(arm.axes), number - 1]
    size = np.linalg.norm(column)
    if size < 1e-12:
        raise InvalidData(f"joint {number} of {arm.name!r} does not move the tool in this pose")
    return np.asarray(column / size)


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


def submanipulator_jacobian(
    arm: Arm, pose: ArrayLike, link: int, *, point: LinkPoint = "centre"
) -> Array:
    """Jacobian of the proximal part that carries a link and its descendants (8.2.3).

    Joints 1 to ``link`` move; everything distal to them is locked and rides along.

    Parameters
    ----------
    arm : Arm
        The arm; bending modes at rest.
    pose : array (n,)
        Joint positions [rad].
    link : int
        Link, from 1.
    point : {"centre", "seat"}
        Centre of mass of the distal segment, which the seat has to drive, or the seat itself
        at the link's proximal end.

    Returns
    -------
    ndarray (d, link)
        Motion of the point per joint motion, in the axes of the link [m].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> submanipulator_jacobian(planar(3), [0.0, 0.1, 0.2], 2).shape
    (2, 2)
    """
    number = arm.link_number(link)
    if point not in ("centre", "seat"):
        raise UnknownName(f"the point of a link is its 'centre' or its 'seat', got {point!r}")
    data = _placed(arm, pose)
    model = arm.model
    body = model.body(arm.seat_bodies[number - 1]).id
    place = data.subtree_com[body] if point == "centre" else data.xpos[body]
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, place, body)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints[:number]]
    frame = data.xmat[body].reshape(3, 3)
    return np.asarray((frame.T @ jacobian)[list(arm.axes)][:, dofs])


def submanipulator(
    arm: Arm, pose: ArrayLike, link: int, *, energy: bool = True, point: LinkPoint = "centre"
) -> Ellipsoid:
    """Ellipsoid of the proximal part that carries a link and its descendants (8.2.3).

    Parameters
    ----------
    arm, pose, link, point
        As `submanipulator_jacobian`.
    energy : bool
        Weight joint rates by kinetic energy, J M⁻¹ Jᵀ with M that of joints 1 to ``link`` while
        the others are locked; else J Jᵀ.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> float(submanipulator(planar(3), [0.0, 0.1, 0.2], 1).lengths[1])  # one joint, one line
    0.0
    """
    jacobian = submanipulator_jacobian(arm, pose, link, point=point)
    count = jacobian.shape[1]
    return ellipsoid(jacobian, joint_inertia(arm, pose)[:count, :count] if energy else None)


def _placed(arm: Arm, pose: ArrayLike) -> mujoco.MjData:
    """Arm without seat at a pose, bending modes at rest."""
    q = np.asarray(pose, dtype=float)
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(
            f"a pose of {arm.name!r} is {arm.n} finite numbers [rad], got {pose!r}"
        )
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = q
    mujoco.mj_forward(arm.model, data)
    return data
