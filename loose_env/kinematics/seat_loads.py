"""Loads on the seat of each link due to joint torques (thesis 4.2.3).

A torque at a joint sets the arm in motion; the seat of a link has to push all that lies beyond
it. Looseness moves only where that push has a part along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics.joint_loads import carried_bodies
from loose_env.kinematics.manipulability import LinkPoint
from loose_env.typing import Array

__all__ = ["Others", "Reactions", "reactions", "reciprocal_product", "wrench_rank"]

Others = Literal["held", "free"]
"""What the joints that are not driven do: they keep their place, or carry no torque."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reactions:
    """Reactions at the seats from rest, without gravity (4.2.3); force then moment."""

    wrench: Array
    """On what a link carries, itself included, per joint acceleration, in the link's axes
    [N and N m per rad/s²] (n links, 6, n joints)."""
    distal: Array
    """Inertia matrix of links j to n alone [kg m²] (n links, n joints, n joints)."""
    inertia: Array
    """Inertia matrix of the arm, rotors included [kg m²] (n joints, n joints)."""

    def accelerations(self, others: Others = "held") -> Array:
        """Joint accelerations per torque at each joint in turn, in columns (n, n).

        Raises
        ------
        UnknownName
            If ``others`` is neither "held" nor "free".
        """
        if others == "held":
            return np.diag(1 / np.diag(self.inertia))
        if others == "free":
            return np.asarray(np.linalg.inv(self.inertia))
        raise UnknownName(f"the other joints are 'held' or 'free', got {others!r}")

    def per_torque(self, others: Others = "held") -> Array:
        """Wrench at each seat per torque at each joint (n links, 6, n joints)."""
        return np.asarray(self.wrench @ self.accelerations(others))

    def per_energy(self, others: Others = "held") -> Array:
        """Wrench at each seat per root energy of links j to n (n links, 6, n joints).

        Impulses instead of steady torques: an impulsive torque at joint i gives links j to n
        the energy T and the momentum p. What is returned is p / √(2T) [√kg for forces]. No
        force exceeds the root of the mass that link j carries, its own included.
        """
        motion = self.accelerations(others)
        energy = np.einsum("ai,jab,bi->ji", motion, self.distal, motion)
        # A joint that leaves links j to n at rest neither pushes them nor gives them energy.
        scale = np.where(energy > 0, np.sqrt(np.where(energy > 0, energy, 1.0)), np.inf)
        return np.asarray((self.wrench @ motion) / scale[:, None, :])


def reactions(arm: Arm, pose: ArrayLike, *, point: LinkPoint = "seat") -> Reactions:
    """Compute the load on every seat from every joint in a pose (4.2.3).

    Parameters
    ----------
    arm : Arm
        The arm; bending modes at rest.
    pose : array (n,)
        Joint positions [rad].
    point : {"seat", "centre"}
        Where moments are taken: at the link's proximal end, a bolted connection, or at the
        centre of mass of what the link carries, itself included.

    Raises
    ------
    InvalidSetting
        If the pose does not have one finite number for every joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> reactions(planar(2), [0.0, 0.5]).per_torque().shape
    (2, 6, 2)
    """
    q = np.asarray(pose, dtype=float)
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(
            f"a pose of {arm.name!r} is {arm.n} finite numbers [rad], got {pose!r}"
        )
    if point not in ("centre", "seat"):
        raise UnknownName(f"the point of a link is its 'centre' or its 'seat', got {point!r}")
    model, n = arm.model, arm.n
    data = mujoco.MjData(model)
    data.qpos[arm.pose_addresses] = q
    mujoco.mj_forward(model, data)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    momentum, turning = np.zeros((model.nbody, 3, n)), np.zeros((model.nbody, 3, n))
    inertias = np.zeros((model.nbody, n, n))
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for body in range(1, model.nbody):
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        axes = data.ximat[body].reshape(3, 3)
        v, w = linear[:, dofs], angular[:, dofs]
        momentum[body] = model.body_mass[body] * v
        turning[body] = (axes * model.body_inertia[body]) @ axes.T @ w
        inertias[body] = v.T @ momentum[body] + w.T @ turning[body]
    wrench, distal = np.zeros((n, 6, n)), np.zeros((n, n, n))
    for k, name in enumerate(arm.seat_bodies):
        seat = model.body(name).id
        carried = carried_bodies(model, seat)
        place = data.subtree_com[seat] if point == "centre" else data.xpos[seat]
        arms = data.xipos[carried] - place
        force = momentum[carried].sum(axis=0)
        moment = (turning[carried] + np.cross(arms[:, :, None], momentum[carried], axis=1)).sum(0)
        frame = data.xmat[seat].reshape(3, 3)
        wrench[k] = np.vstack([frame.T @ force, frame.T @ moment])
        distal[k] = inertias[carried].sum(axis=0)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return Reactions(wrench=wrench, distal=distal, inertia=full[np.ix_(dofs, dofs)])


def reciprocal_product(wrench: ArrayLike, twist: ArrayLike) -> float:
    """Power of a wrench on a twist (4.2.3); zero if it does not move the seat.

    Parameters
    ----------
    wrench : array (6,)
        Force and moment about a point [N, N m].
    twist : array (6,)
        Velocity of the looseness at that point and its rate of turn [m/s, rad/s]: a slide along
        z is (z, 0), a hinge about it (0, z).

    Raises
    ------
    InvalidData
        If one of the two is not six finite numbers.

    Examples
    --------
    >>> reciprocal_product([0, 2, 0, 0, 0, 1], [0, 1, 0, 0, 0, 0])
    2.0
    """
    w, t = np.asarray(wrench, dtype=float), np.asarray(twist, dtype=float)
    if w.shape != (6,) or t.shape != (6,) or not (np.isfinite(w).all() and np.isfinite(t).all()):
        raise InvalidData(f"a wrench and a twist are six finite numbers each, got {w} and {t}")
    return float(w @ t)


def wrench_rank(wrenches: ArrayLike, *, tolerance: float = 1e-6) -> tuple[int, Array]:
    """Number of independent wrenches, and their singular values (4.2.3).

    Parameters
    ----------
    wrenches : array (r, m)
        Components of m wrenches that matter, in columns.
    tolerance : float
        A singular value below this share of the largest counts as zero.

    Returns
    -------
    tuple of int and ndarray (r,)
        The last value is the push in the direction least pushed.

    Examples
    --------
    >>> wrench_rank([[1.0, 2.0], [0.0, 0.0]])[0]
    1
    """
    w = np.asarray(wrenches, dtype=float)
    if w.ndim != 2 or 0 in w.shape or not np.isfinite(w).all():
        raise InvalidData(f"wrenches are (r, m) and finite, got shape {w.shape}")
    if not 0 <= tolerance < 1:
        raise InvalidSetting(f"tolerance is a share from 0 up to 1, got {tolerance!r}")
    values = np.zeros(w.shape[0])
    found = np.linalg.svd(w, compute_uv=False)
    values[: len(found)] = found
    return int(np.sum(values > tolerance * values[0])), values
