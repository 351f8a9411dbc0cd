"""Selection of poses that load a link's seat in every direction (thesis 4.2.3).

Looseness shows only where the push of its seat has a part along its direction. With no direction
assumed, a pose is good if the pushes from the joints span every direction, and a pose set is
good if its joints differ much from pose to pose.
"""

from __future__ import annotations

from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics.seat_loads import reactions, wrench_rank
from loose_env.typing import Array

__all__ = ["chebyshev_nodes", "chebyshev_poses", "choose_poses", "worst_push"]

MOST_POSES = 50_000


def worst_push(
    arm: Arm, pose: ArrayLike, link: int | None = None, *, normalised: bool = True
) -> float:
    """Minimum over directions of the load that the joints exert on a link's seat (4.2.3).

    Parameters
    ----------
    arm, pose
        As `reactions`.
    link : int, optional
        Link of interest, from 1; by default the link that fares worst.
    normalised : bool
        Per root of the energy of the links beyond the seat [√kg]; else per torque [1/m].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> round(worst_push(planar(2), [0.3, 0.0]), 9)  # straight: no push along the arm
    0.0
    """
    found = reactions(arm, pose)
    push = found.per_energy if normalised else found.per_torque
    links = range(arm.n) if link is None else (arm.link_number(link) - 1,)
    return min(float(wrench_rank(push[k, list(arm.axes)])[1][-1]) for k in links)


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
    ranges = [(-np.pi, np.pi) if r is None else r for r in arm.joint_ranges]
    return np.array(list(product(*(chebyshev_nodes(*r, count) for r in ranges))))


def choose_poses(
    poses: ArrayLike,
    scores: ArrayLike,
    count: int,
    *,
    keep: float = 0.25,
    difference: Literal["angle", "sine"] = "angle",
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
    difference : {"angle", "sine"}
        How a joint's move counts: by its angle modulo a turn, up to π, or by |sin| of it. The
        axis of rotation is found by dividing by the sine (4.31): a half turn tells nothing.

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
    if difference not in ("angle", "sine"):
        raise UnknownName(f"moves count by 'angle' or 'sine', got {difference!r}")
    if not 0 < keep <= 1:
        raise InvalidSetting(f"keep is a share above 0 and up to 1, got {keep!r}")
    best = np.argsort(-s, kind="stable")[: max(1, int(np.ceil(keep * len(q))))]
    if not 1 <= count <= len(best):
        raise InvalidSetting(f"choose 1 to {len(best)} poses from the best {keep:g}, got {count}")
    near, mean = np.full(len(best), np.inf), np.zeros(len(best))
    chosen = [0]
    while len(chosen) < count:
        move = q[best] - q[best[chosen[-1]]]
        size = np.abs(np.sin(move)) if difference == "sine" else np.abs(_wrapped(move))
        near = np.minimum(near, size.min(axis=1))
        mean += size.mean(axis=1)
        near[chosen] = -1.0
        # Sorted by score already; lexsort keeps the earlier of equals.
        order = np.lexsort((np.arange(len(best)), -mean.round(9), -near.round(9)))
        chosen.append(int(order[0]))
    return np.asarray(best[chosen])


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
