"""Ways to choose the poses of a set before anything is measured.

Two kinds of reasoning stand side by side. The thesis (4.2.3) wants poses that load the seats well
and whose joints differ much. The other kind asks what the tool would see: a slide at link k shows
as R_k(q) z, with R_k from link k's frame to the tool's, and a set is good if no direction in
another link could show the same axes in all of its poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.link_finding.moves import candidate_poses
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics import chebyshev_poses, choose_poses, worst_push
from loose_env.statistics import axes_grid
from loose_env.typing import Array

__all__ = ["PLANNED", "PoseSets", "link_confusion"]


PLANNED: dict[str, str] = {
    "random": "every joint anywhere in its range",
    "largest differences": "random poses of which the joints differ most (4.2.3)",
    "reaction wrenches": "random poses that load the worst seat most, per energy (4.2.3)",
    "Chebyshev": "both, on the Chebyshev points of the joints' ranges: 4.2.3 in full",
    "one joint": "one joint after the other, from the base outward (4.2.2)",
    "all joints": "every joint at once, so that each link's direction turns differently",
}
"""Names of the strategies that need no record, and what they do."""

_CHEBYSHEV_GRID = 1500
"""Most points of the Chebyshev grid that are scored."""
_POOL, _DRAWN = 384, 96
"""Random poses that are scored once for an arm, and how many of them a set is chosen from."""
_COMBINATIONS = 96
"""Moves of all joints that are weighed against each other for one pose."""


class PoseSets:
    """Makes pose sets for one arm.

    Parameters
    ----------
    arm : Arm
        The arm.
    moves : array_like (m,)
        Moves of a hinge from one pose to the next that "one joint" and "all joints" may make
        [rad]; the others go anywhere.
    sd : float
        Standard deviation of a direction for which "all joints" is laid out [rad].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> sets = PoseSets(planar(3), moves=np.radians([-90, -60, -30, 30, 60, 90]))
    >>> rng = np.random.default_rng(0)
    >>> np.degrees(sets.make("one joint", np.zeros(3), 3, rng)).round().tolist()
    [[0.0, 0.0, 0.0], [0.0, -90.0, 0.0], [0.0, -90.0, -90.0]]
    """

    def __init__(self, arm: Arm, *, moves: ArrayLike, sd: float = np.radians(10.0)) -> None:
        self.arm, self.frames = arm, ToolFrames(arm)
        self.moves = np.asarray(moves, dtype=float)
        if self.moves.ndim != 1 or not np.isfinite(self.moves).all() or not self.moves.any():
            raise InvalidSetting(f"moves are angles [rad], not all zero; got {moves!r}")
        if not (np.isfinite(sd) and sd > 0):
            raise InvalidSetting(f"sd must be a positive angle [rad], got {sd!r}")
        self.sd = float(sd)

    def make(self, strategy: str, start: ArrayLike, count: int, rng: np.random.Generator) -> Array:
        """Make one set.

        Parameters
        ----------
        strategy : str
            One of `PLANNED`.
        start : array_like (n,)
            Current pose [rad, or m where a joint slides]. "random", "one joint" and "all
            joints" take their first record there.
        count : int
            Number of poses.
        rng : numpy.random.Generator
            Source of all draws; "Chebyshev" and "one joint" need none.

        Returns
        -------
        ndarray (count, n)

        Raises
        ------
        UnknownName
            If there is no such strategy.
        InvalidSetting
            If the pose does not fit the arm, or the number is no whole number from 1.
        """
        q = np.asarray(start, dtype=float)
        if q.shape != (self.arm.n,) or not self.arm.within_ranges(q).all():
            raise InvalidSetting(
                f"a pose of {self.arm.name!r} has {self.arm.n} finite joint positions in their "
                f"ranges [rad or m], got {start!r}"
            )
        if isinstance(count, bool) or int(count) != count or count < 1:
            raise InvalidSetting(f"a set has a whole number of poses, 1 or more; got {count!r}")
        if strategy == "random":
            return np.array([q, *(self.arm.random_pose(rng) for _ in range(count - 1))])
        if strategy == "largest differences":
            drawn = np.array([q, *(self.arm.random_pose(rng) for _ in range(self._draws(count)))])
            scores = np.zeros(len(drawn))  # the first of equals is where the arm stands
            return drawn[choose_poses(self._angles(drawn), scores, count, keep=1.0)]
        if strategy == "reaction wrenches":
            poses, pushes = self._pool
            among = rng.permutation(len(poses))[: self._draws(count)]
            return np.asarray(poses[among[np.argsort(-pushes[among], kind="stable")[:count]]])
        if strategy == "Chebyshev":
            poses, pushes = self._grid
            keep = max(0.25, min(1.0, count / len(poses)))
            return np.asarray(poses[choose_poses(self._angles(poses), pushes, count, keep=keep)])
        if strategy == "one joint":
            return self._one_by_one(q, count)
        if strategy == "all joints":
            return self._all_at_once(q, count, rng)
        raise UnknownName(f"unknown strategy {strategy!r}; known are {list(PLANNED)}")

    def _one_by_one(self, start: Array, count: int) -> Array:
        """Move joints 2, 3 .. n by the move that turns most; in later rounds the next best."""
        turning = [j for j in range(1, self.arm.n) if not self.frames.slides[j]]
        poses = [start]
        for step in range(count - 1):
            pose = poses[-1].copy()
            if turning:
                j, tried = turning[step % len(turning)], step // len(turning)
                there = self._fitting(j, pose[j])
                if len(there):
                    pose[j] = there[tried % len(there)]
            poses.append(pose)
        return np.array(poses)

    def _fitting(self, joint: int, position: float) -> Array:
        """Poses that a joint's moves reach, largest turn first."""
        best = np.argsort(-np.abs(np.sin(self.moves)).round(9), kind="stable")
        there = position + self.moves[best][np.abs(np.sin(self.moves[best])) > 1e-6]
        limits = self.arm.joint_ranges[joint]
        if limits is None:
            return np.asarray(there)
        return np.asarray(there[(there >= limits[0] - 1e-9) & (there <= limits[1] + 1e-9)])

    def _all_at_once(self, start: Array, count: int, rng: np.random.Generator) -> Array:
        """Add the pose, all hinges moved, that confuses the links least."""
        poses = [start]
        turning = ~self.frames.slides
        turning[0] = False  # carries the whole arm along and turns nothing in the tool frame
        while len(poses) < count:
            where = candidate_poses(
                self.arm,
                poses[-1],
                self.moves,
                joints="all",
                sliding=self.frames.slides,
                most=_COMBINATIONS,
                rng=rng,
            )
            moved = np.abs(where - poses[-1])[:, turning] > 1e-9
            whole = where[moved.sum(axis=1) == moved.sum(axis=1).max()]
            confusion = link_confusion(self.frames, np.array(poses), whole, sd=self.sd)
            poses.append(whole[int(np.argmin(confusion.round(12)))])
        return np.array(poses)

    @cached_property
    def _pool(self) -> tuple[Array, Array]:
        """Random poses and how well they load the worst seat; the same for everybody."""
        rng = np.random.default_rng(0)
        poses = np.array([self.arm.random_pose(rng) for _ in range(_POOL)])
        return poses, np.array([worst_push(self.arm, q) for q in poses])

    @cached_property
    def _grid(self) -> tuple[Array, Array]:
        points = max(2, int(np.floor(_CHEBYSHEV_GRID ** (1 / self.arm.n) + 1e-9)))
        poses = chebyshev_poses(self.arm, points)
        return poses, np.array([worst_push(self.arm, q) for q in poses])

    def _draws(self, count: int) -> int:
        return min(_POOL, max(_DRAWN, 4 * count))

    def _angles(self, poses: Array) -> Array:
        """Poses with slides as angles: their whole range is half a turn, the largest difference."""
        shown = poses.copy()
        for j in np.flatnonzero(self.frames.slides):
            low, high = self.arm.joint_ranges[j] or (0.0, np.pi)
            shown[:, j] = np.pi * (poses[:, j] - low) / (high - low)
        return shown


def link_confusion(
    frames: ToolFrames,
    poses: ArrayLike,
    candidates: ArrayLike,
    *,
    sd: float,
    links: Sequence[int] | None = None,
    directions: int = 10,
) -> Array:
    """Confusability of links of unknown direction after adding a candidate pose.

    A slide at link k along z shows the axes R_k z. The direction in link l that comes closest to
    them leaves the misfit e², the sum of sin² over the poses. The two are told apart as two
    Gaussians e/s apart: Bhattacharyya's bound on their confusion is exp(-e²/8s²), averaged over
    the pairs of links and over z.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    poses : array_like (P, n)
        Poses of the set so far [rad, or m where a joint slides].
    candidates : array_like (C, n)
        Poses that may join it.
    sd : float
        Standard deviation of a direction [rad].
    links : sequence of int, optional
        Links in question, from 1; all by default.
    directions : int
        Directions of the slide tried over the half sphere; in the plane one stands for all.

    Returns
    -------
    ndarray (C,)
        0: no links are confused; 1: none can be told apart.

    Raises
    ------
    InvalidSetting
        If sd is not positive or fewer than two links are in question.
    InvalidData
        If the poses do not fit the arm.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> stay, turn = [0.0, 0.3], [0.0, 0.3 + np.pi / 2]
    >>> link_confusion(ToolFrames(planar(2)), [stay], [stay, turn], sd=0.1).round(6).tolist()
    [1.0, 0.0]
    """
    if not (np.isfinite(sd) and sd > 0):
        raise InvalidSetting(f"sd must be a positive angle [rad], got {sd!r}")
    chosen = [*range(1, frames.arm.n + 1)] if links is None else list(links)
    if len(set(chosen)) < 2 or min(chosen) < 1 or max(chosen) > frames.arm.n:
        raise InvalidSetting(
            f"two or more links of 1 to {frames.arm.n} can be confused, got {links!r}"
        )
    taken, new = (np.atleast_2d(np.asarray(p, dtype=float)) for p in (poses, candidates))
    if taken.shape[1:] != new.shape[1:]:
        raise InvalidData(f"poses {taken.shape} and candidates {new.shape} differ in joints")
    z = axes_grid(directions, 3) if frames.dimension == 3 else np.array([[1.0, 0.0]])
    index = np.array(chosen) - 1
    one, other = (g.ravel() for g in np.meshgrid(index, index, indexing="ij"))
    one, other = one[one != other], other[one != other]

    def carried(rows: Array) -> Array:
        """Axes of link ``one`` carried over to link ``other`` (rows, pairs, z, d)."""
        images = frames.images(rows)
        seen = np.einsum("tkij,zj->tkzi", images, z)
        return np.asarray(np.einsum("tpji,tpzj->tpzi", images[:, other], seen[:, one]))

    before, after = carried(taken), carried(new)
    spread = np.einsum("tpzi,tpzj->pzij", before, before) + np.einsum(
        "cpzi,cpzj->cpzij", after, after
    )
    misfit = np.maximum(len(taken) + 1 - np.linalg.eigvalsh(spread)[..., -1], 0.0)
    return np.asarray(np.exp(-misfit / (8 * sd**2)).mean(axis=(1, 2)))
