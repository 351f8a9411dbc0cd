"""Loads on the seat of each link due to joint torques (thesis 4.2.3).

A torque at a joint sets the arm in motion; the seat of a link has to push all that lies beyond
it. Looseness moves only where that push has a part along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = ["Reactions", "carried_bodies", "reactions", "wrench_rank"]


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

    @property
    def accelerations(self) -> Array:
        """Joint accelerations per torque at each joint in turn, the others braked (n, n)."""
        return np.diag(1 / np.diag(self.inertia))

    @property
    def per_torque(self) -> Array:
        """Wrench at each seat per torque at each joint, others braked (n links, 6, n joints)."""
        return np.asarray(self.wrench @ self.accelerations)

    @property
    def per_energy(self) -> Array:
        """Wrench at each seat per root energy of links j to n, others braked.

        Impulses instead of steady torques: an impulsive torque at joint i gives links j to n
        the energy T and the momentum p. The property is p / √(2T) (n links, 6, n joints) [√kg for
        forces]. No force exceeds the root of the mass that link j carries, its own included.
        """
        motion = self.accelerations
        energy = np.einsum("ai,jab,bi->ji", motion, self.distal, motion)
        # A joint that leaves links j to n at rest neither pushes them nor gives them energy.
        scale = np.where(energy > 0, np.sqrt(np.where(energy > 0, energy, 1.0)), np.inf)
        return np.asarray((self.wrench @ motion) / scale[:, None, :])


def reactions(arm: Arm, pose: ArrayLike) -> Reactions:
    """Compute the load on every seat from every joint in a pose (4.2.3).

    Moments are about the seat, the bolted connection at the link's proximal end.

    Parameters
    ----------
    arm : Arm
        The arm; bending modes at rest.
    pose : array (n,)
        Joint positions [rad].

    Raises
    ------
    InvalidSetting
        If the pose does not have one finite number for every joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> reactions(planar(2), [0.0, 0.5]).per_torque.shape
    (2, 6, 2)
    """
    q = np.asarray(pose, dtype=float)
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(
            f"a pose of {arm.name!r} is {arm.n} finite numbers [rad], got {pose!r}"
        )
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
        arms = data.xipos[carried] - data.xpos[seat]
        force = momentum[carried].sum(axis=0)
        moment = (turning[carried] + np.cross(arms[:, :, None], momentum[carried], axis=1)).sum(0)
        frame = data.xmat[seat].reshape(3, 3)
        wrench[k] = np.vstack([frame.T @ force, frame.T @ moment])
        distal[k] = inertias[carried].sum(axis=0)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return Reactions(wrench=wrench, distal=distal, inertia=full[np.ix_(dofs, dofs)])


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


def carried_bodies(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Mask of the bodies in the subtree of a body, itself included (nbody,).

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> model = planar(2).model
    >>> [model.body(b).name for b in np.flatnonzero(carried_bodies(model, model.body("link1").id))]
    ['link1', 'flange2', 'link2']
    """
    carried = np.zeros(model.nbody, dtype=bool)
    carried[body] = True
    for b in range(body + 1, model.nbody):  # parents come before their children
        carried[b] = carried[model.body_parentid[b]]
    return carried
