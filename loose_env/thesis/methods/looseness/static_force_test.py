"""The static-force test: hold the tool, drive the joints, see what moves (thesis 3.2.1, 8.1.2).

With the tool held, J q̇ = 0 over all n+1 columns. Joints that still move, in an arm whose own
columns allow no such motion, move because a seat slides: the seat's twist is minus what the
joints do at the tool. Along that motion no force is carried, to the stops.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = [
    "LinkAgreement",
    "SeatTwist",
    "compatible_links",
    "dock_force",
    "docked_acceleration",
    "free_torque",
    "joint_torques",
    "link_frames",
    "moving_directions",
    "remaining_motions",
    "seat_force",
    "seat_twist",
    "tool_acceleration",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class SeatTwist:
    """What a docked arm's joints say about the seat."""

    direction: Array
    """Unit vector of the seat's motion at the tool, in the Jacobian's rows (m,); its sign is
    free."""
    size: float
    """Rms of the motion along it, in the Jacobian's units."""
    first_share: float
    """Share of the whole motion's power that lies along it, 0 to 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkAgreement:
    """How well each link explains the directions seen in several poses."""

    misfit: Array
    """Rms angle between the directions, turned into a link's frame, and their axial mean
    [rad] (n,)."""
    best: int
    """Link with the smallest misfit, from 1."""
    direction: Array
    """Direction of the slide in that link's frame (d,), largest component positive."""


def joint_torques(jacobian: ArrayLike, force: ArrayLike) -> Array:
    """Joint torques equivalent to a force at the tool, J^T f (3.10).

    ``jacobian`` (m, n): rows of the Jacobian. ``force`` (m,) or (m, N): force and moment on the
    tool in the same rows [N, N·m].

    Examples
    --------
    >>> joint_torques([[0.0, 0.0], [0.6, 0.3]], [0.0, 10.0])
    array([6., 3.])
    """
    j, f = _matrix(jacobian), _finite(force, "force")
    if f.ndim not in (1, 2) or f.shape[0] != j.shape[0]:
        raise InvalidData(f"a Jacobian of shape {j.shape} takes {j.shape[0]} rows of force")
    return np.asarray(j.T @ f)


def seat_force(jacobian: ArrayLike, force: ArrayLike, column: int) -> Array:
    """Force that a looseness joint would have to carry under a force at the tool (3.10).

    A seat between its stops carries none: such a force at the tool has no part along the slide
    (the wrench of zero amplitude).

    ``jacobian`` (m, n+1): the loose arm's Jacobian. ``force`` (m,) or (m, N): force on the tool.
    ``column``: the looseness joint's column, from 0.

    Examples
    --------
    >>> float(seat_force([[0.0, 1.0], [0.6, 0.0]], [2.0, 10.0], 1))
    2.0
    """
    return np.asarray(joint_torques(jacobian, force)[column])


def tool_acceleration(
    jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike, force: ArrayLike | None = None
) -> Array:
    """Tool acceleration at low speed, J M⁻¹ (τ* + J^T f) (3.9, 3.15-3.17, 3.20-3.24).

    ``jacobian`` (m, n): rows of the Jacobian; n counts the looseness joint if there is one.
    ``inertia`` (n, n): inertia matrix. ``torque`` (n,) or (n, N): joint torques, potential loads
    taken off (3.14); 0 at a looseness joint. ``force`` (m,) or (m, N): force of the surroundings on
    the tool; none for a free arm.

    Examples
    --------
    >>> tool_acceleration([[0.5]], [[2.0]], [4.0])
    array([1.])
    """
    j, m, tau = _dynamics(jacobian, inertia, torque)
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
    j, m, tau = _dynamics(jacobian, inertia, torque)
    free = j @ np.linalg.solve(m, tau)
    mobility = j @ np.linalg.solve(m, j.T)
    return np.asarray(-np.linalg.lstsq(mobility, free, rcond=1e-12)[0])


def docked_acceleration(jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike) -> Array:
    """Joint accelerations that remain while the tool stands still (3.22, 3.25).

    Zero for a fully held arm without spare joints; not zero once a looseness joint is there.

    Examples
    --------
    >>> docked_acceleration([[0.5]], [[2.0]], [4.0])
    array([0.])
    """
    j, m, tau = _dynamics(jacobian, inertia, torque)
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
    j = _matrix(jacobian)
    _, values, rows = np.linalg.svd(j, full_matrices=True)
    rank = int((values > tolerance * values.max(initial=0.0)).sum())
    return np.asarray(rows[rank:].T)


def free_torque(jacobian: ArrayLike, torque: ArrayLike) -> Array:
    """Part of the joint torques that no force at the tool can balance (after 3.25), (n,).

    It drives the remaining motions; the rest is J^T f of some force f.

    Examples
    --------
    >>> free_torque([[1.0, 1.0]], [2.0, 0.0])
    array([ 1., -1.])
    """
    j, tau = _matrix(jacobian), _finite(torque, "torque")
    if tau.shape != (j.shape[1],):
        raise InvalidData(f"a Jacobian of shape {j.shape} needs {j.shape[1]} torques")
    free = remaining_motions(j)
    return np.asarray(free @ (free.T @ tau))


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
    x = _finite(angles, "angles")
    if x.ndim != 2 or x.shape[1] < 4:
        raise InvalidData(f"angles are (n, N) with at least 4 samples, got shape {x.shape}")
    if not (np.isfinite(noise) and noise >= 0 and factor > 0):
        raise InvalidSetting(f"noise and factor must not be negative, got {noise!r}, {factor!r}")
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(x)))
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
    j, x = _matrix(jacobian), _finite(angles, "angles")
    if x.ndim != 2 or x.shape[0] != j.shape[1] or x.shape[1] < 4:
        raise InvalidData(
            f"angles must be ({j.shape[1]}, N) with at least 4 samples, got shape {x.shape}"
        )
    motion = -j @ (x - x.mean(axis=1, keepdims=True))
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
    q = np.asarray(pose, dtype=float)
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(f"a pose of {arm.name!r} is {arm.n} finite numbers, got {pose!r}")
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = q
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
    u, r = _finite(directions, "directions"), _finite(frames, "frames")
    if (
        u.ndim != 2
        or len(u) < 2
        or r.ndim != 4
        or r.shape != (len(u), r.shape[1], *2 * u.shape[1:])
    ):
        raise InvalidData(
            "directions are (P, d) with at least 2 poses and frames (P, n, d, d), got shapes "
            f"{u.shape} and {r.shape}"
        )
    size = np.linalg.norm(u, axis=1, keepdims=True)
    if (size == 0).any():
        raise InvalidData("every direction needs a length above zero")
    own = np.einsum("pkdc,pd->pkc", r, u / size)
    _, vectors = np.linalg.eigh(np.einsum("pkc,pkb->kcb", own, own))
    means = vectors[:, :, -1]
    angle = np.arccos(np.clip(np.abs(np.einsum("pkc,kc->pk", own, means)), 0.0, 1.0))
    misfit = np.sqrt(np.mean(angle**2, axis=0))
    best = int(np.argmin(misfit))
    mean = means[best]
    return LinkAgreement(
        misfit=misfit,
        best=best + 1,
        direction=mean * np.sign(mean[np.argmax(np.abs(mean))]),
    )


def _finite(values: ArrayLike, name: str) -> Array:
    found = np.asarray(values, dtype=float)
    if not np.isfinite(found).all():
        raise InvalidData(f"{name} holds NaN or infinite values; every value must be finite")
    return found


def _matrix(values: ArrayLike) -> Array:
    j = _finite(values, "the Jacobian")
    if j.ndim != 2 or 0 in j.shape:
        raise InvalidData(f"a Jacobian has rows and columns, got shape {j.shape}")
    return j


def _dynamics(
    jacobian: ArrayLike, inertia: ArrayLike, torque: ArrayLike
) -> tuple[Array, Array, Array]:
    j, m, tau = _matrix(jacobian), _finite(inertia, "inertia"), _finite(torque, "torque")
    n = j.shape[1]
    if m.shape != (n, n) or tau.ndim not in (1, 2) or tau.shape[0] != n:
        raise InvalidData(
            f"a Jacobian of {n} columns needs an inertia ({n}, {n}) and {n} torques, got "
            f"{m.shape} and {tau.shape}"
        )
    return j, m, tau
