"""Loads on the seats of serial arms, Chebyshev poses, and choice of poses by them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm, limits_of
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = [
    "carried_bodies",
    "chebyshev_poses",
    "choose_poses",
    "reactions",
    "worst_push",
    "wrench_rank",
]


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
    q = arm.checked_pose(pose)
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


MOST_POSES = 50_000


def worst_push(arm: Arm, pose: ArrayLike) -> float:
    """Smallest load over directions and links that the joints exert on a seat (4.2.3) [√kg].

    Per root of the energy of the links beyond the seat.

    Parameters
    ----------
    arm, pose
        As `reactions`.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> round(worst_push(planar(2), [0.3, 0.0]), 9)  # straight: no push along the arm
    0.0
    """
    push = reactions(arm, pose).per_energy[:, list(arm.axes)]
    return min(float(wrench_rank(each)[1][-1]) for each in push)


def chebyshev_nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev points of an interval, from low to high (4.2.3).

    They are the zeros of the Chebyshev polynomial of degree ``count``, closer at the ends.

    Examples
    --------
    >>> chebyshev_nodes(0.0, 1.0, 2).round(4)
    array([0.1464, 0.8536])
    """
    if not (np.isfinite([low, high]).all() and low < high):
        raise InvalidSetting(f"an interval runs from low to high, got {low!r} to {high!r}")
    if isinstance(count, bool) or count < 1 or int(count) != count:
        raise InvalidSetting(f"the number of points is a whole number from 1, got {count!r}")
    k = np.arange(count)
    nodes = -np.cos((2 * k + 1) * np.pi / (2 * count))
    return np.asarray((low + high) / 2 + (high - low) / 2 * nodes)


def chebyshev_poses(arm: Arm, count: int) -> Array:
    """Poses on the Chebyshev nodes of every joint's range (4.2.3).

    Parameters
    ----------
    arm : Arm
        The arm; joints that turn without end span -π to π.
    count : int
        Points a joint.

    Returns
    -------
    ndarray (count**n, n)
        Poses [rad].

    Raises
    ------
    InvalidSetting
        If there would be more than 50,000 poses.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> chebyshev_poses(planar(2), 4).shape
    (16, 2)
    """
    if count**arm.n > MOST_POSES:
        raise InvalidSetting(
            f"{count} points for each of {arm.n} joints are {count**arm.n} poses; take fewer "
            f"points, at most {int(MOST_POSES ** (1 / arm.n))}"
        )
    ends = zip(*limits_of(arm.joint_ranges), strict=True)
    return np.array(list(product(*(chebyshev_nodes(*each, count) for each in ends))))


def choose_poses(
    poses: ArrayLike,
    scores: ArrayLike,
    count: int,
    *,
    keep: float = 0.25,
) -> NDArray[np.intp]:
    """Select, among the best poses, a set with maximum joint-space spread (4.2.3).

    The pose of the best score comes first. Each next one is, among the best share ``keep``, the
    one whose least-moved joint differs most from every pose already chosen; of equals the one
    with the larger mean difference, then the better score.

    Parameters
    ----------
    poses : array (P, n)
        Candidates [rad].
    scores : array (P,)
        The larger the better, as from `worst_push`.
    count : int
        Size of the set.
    keep : float
        Share of the candidates from which to choose [1].

    Returns
    -------
    ndarray (count,)
        Rows of ``poses`` in the order chosen.

    Raises
    ------
    InvalidData
        If shapes do not fit or a value is not finite.
    InvalidSetting
        If the share keeps fewer poses than are wanted.

    Examples
    --------
    >>> choose_poses([[0.0], [0.1], [1.0]], [3.0, 2.0, 1.0], 2, keep=1.0)
    array([0, 2])
    """
    q, s = np.asarray(poses, dtype=float), np.asarray(scores, dtype=float)
    if q.ndim != 2 or s.shape != (len(q),) or not (np.isfinite(q).all() and np.isfinite(s).all()):
        raise InvalidData(f"poses (P, n) and scores (P,) must be finite, got {q.shape}, {s.shape}")
    if not 0 < keep <= 1:
        raise InvalidSetting(f"keep is a share above 0 and up to 1, got {keep!r}")
    best = np.argsort(-s, kind="stable")[: max(1, int(np.ceil(keep * len(q))))]
    if not 1 <= count <= len(best):
        raise InvalidSetting(f"choose 1 to {len(best)} poses from the best {keep:g}, got {count}")
    near, mean = np.full(len(best), np.inf), np.zeros(len(best))
    chosen = [0]
    while len(chosen) < count:
        size = np.abs((q[best] - q[best[chosen[-1]]] + np.pi) % (2 * np.pi) - np.pi)
        near = np.minimum(near, size.min(axis=1))
        mean += size.mean(axis=1)
        near[chosen] = -1.0
        # Sorted by score already; lexsort keeps the earlier of equals.
        order = np.lexsort((np.arange(len(best)), -mean.round(9), -near.round(9)))
        chosen.append(int(order[0]))
    return np.asarray(best[chosen])
