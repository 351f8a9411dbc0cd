"""Pose sets by strategy, and pose by pose from a posterior over links; limit on link accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from loose_env.arms import Arm
from loose_env.diagnosis.directions import ToolFrames, log_mean_bingham
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.inference import overlap
from loose_env.kinematics import chebyshev_poses, choose_poses, worst_push
from loose_env.statistics import axes_grid
from loose_env.typing import Array

_POLAR = (np.arange(8192) + 0.5) * np.pi / 2 / 8192
"""Angles from an axis, cell centres up to a right angle [rad]."""


@lru_cache(maxsize=64)
def bingham_width(sd: float, dimension: int) -> float:
    """Width s of the density exp(-sin²/2s²) whose axes scatter with a standard deviation.

    Parameters
    ----------
    sd : float
        Rms angle from the axis, per direction across it [rad].
    dimension : int
        2 for the plane, 3 for space.

    Raises
    ------
    InvalidSetting
        If no density scatters so: axes of no preference have an rms of 52 degrees in the plane
        and, per direction across, of 43 degrees in space.

    Examples
    --------
    >>> round(float(np.degrees(bingham_width(np.radians(5.0), 2))), 2)
    4.96
    """
    if dimension not in (2, 3):
        raise InvalidSetting(f"axes lie in the plane (2) or in space (3), got {dimension!r}")

    def excess(log_width: float) -> float:
        return _rms(np.exp(log_width), dimension) - sd

    low, high = np.log(1e-3), np.log(30.0)
    if not (np.isfinite(sd) and excess(low) < 0 < excess(high)):
        most = np.degrees(_rms(30.0, dimension))
        raise InvalidSetting(
            f"axes scatter with a standard deviation of 0.1 to {most:.0f} degrees, "
            f"got {np.degrees(sd):g}"
        )
    return float(np.exp(brentq(excess, low, high)))


def scattered_axes(true: ArrayLike, width: float, rng: np.random.Generator) -> Array:
    """Draw axes about given ones with density exp(-sin²/2s²).

    Parameters
    ----------
    true : array_like (..., d)
        Unit vectors; d = 2 or 3.
    width : float
        s, as from `bingham_width` [rad].
    rng : numpy.random.Generator
        Source.

    Returns
    -------
    ndarray (..., d)
        Unit vectors.

    Examples
    --------
    >>> drawn = scattered_axes(np.tile([0.0, 0.0, 1.0], (4000, 1)), 0.1, np.random.default_rng(0))
    >>> round(float(np.sqrt(np.mean(np.arccos(drawn[:, 2]) ** 2) / 2)), 2)
    0.1
    """
    axes = np.asarray(true, dtype=float)
    share = _cumulative(width, axes.shape[-1])
    polar = np.interp(rng.random(axes.shape[:-1]), share, _POLAR)[..., None]
    across = rng.standard_normal(axes.shape)
    across -= np.sum(across * axes, axis=-1, keepdims=True) * axes
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.asarray(np.cos(polar) * axes + np.sin(polar) * across)


def direction_limit(
    links: int,
    poses: int,
    sd: float,
    dimension: int,
    rng: np.random.Generator,
    *,
    samples: int = 20_000,
) -> Array:
    """Bound on the success of any choice of poses and any rule, from directions alone.

    Poses may be chosen beforehand or one by one. What the arm's joints can reach is not asked, so
    that the bound need not be reached.

    Parameters
    ----------
    links : int
        Links in question.
    poses : int
        Largest number of poses.
    sd : float
        Standard deviation of a direction, as `bingham_width` takes it [rad].
    dimension : int
        2 or 3.
    rng : numpy.random.Generator
        Source: the volume is found by drawing from g, each draw weighing 1/g.
    samples : int
        Number of draws.

    Returns
    -------
    ndarray (poses,)
        Success with 1 to ``poses`` poses; 1/links with one.

    Examples
    --------
    >>> found = direction_limit(6, 2, np.radians(5.0), 2, np.random.default_rng(0))
    >>> found.round(2).tolist()  # normal scatter has 0.966: erf(pi / (4 n s))
    [0.17, 0.97]
    """
    for name, value in (("links", links), ("poses", poses), ("samples", samples)):
        if isinstance(value, bool) or int(value) != value or value < 1:
            raise InvalidSetting(f"{name} is a whole number from 1, got {value!r}")
    width = bingham_width(sd, dimension)
    common = np.zeros((samples, poses, dimension))
    common[..., 0] = 1.0
    seen = scattered_axes(common, width, rng)
    across = (np.eye(dimension) - seen[..., :, None] * seen[..., None, :]) / width**2
    alone = float(log_mean_bingham(across[0, 0]))
    found = np.empty(poses)
    for t in range(1, poses + 1):
        # Density of the t axes over uniform ones.
        log = log_mean_bingham(across[:, :t].sum(axis=1)) - t * alone
        falling = np.sort(log)[::-1]
        volume = np.cumsum(np.exp(-falling)) / samples
        inside = int(np.searchsorted(volume, 1 / links))
        found[t - 1] = 1 / links if t == 1 else min(1.0, inside / samples)
    return np.maximum.accumulate(found)


def _density(width: float, dimension: int) -> Array:
    """Density of the angle from the axis, unnormalised, on `_POLAR`."""
    return np.asarray(
        np.exp(-0.5 * (np.sin(_POLAR) / width) ** 2) * np.sin(_POLAR) ** (dimension - 2)
    )


@lru_cache(maxsize=64)
def _cumulative(width: float, dimension: int) -> Array:
    """Share of axes within each angle of `_POLAR`."""
    mass = np.cumsum(_density(width, dimension))
    return np.asarray(mass / mass[-1])


def _rms(width: float, dimension: int) -> float:
    weight = _density(width, dimension)
    return float(np.sqrt(weight @ _POLAR**2 / weight.sum() / (dimension - 1)))


def candidate_poses(
    frames: ToolFrames, pose: Array, moves: Array, *, most: int, rng: np.random.Generator
) -> Array:
    """Poses that one move of every hinge reaches within the ranges (C, n); the first is the pose.

    Joints that slide stay: they cannot turn a direction. So does joint 1, which carries the whole
    arm along. Of more than ``most`` combinations of moves [rad] as many are drawn, beside the moves
    of single joints.
    """
    arm, options = frames.arm, []
    for j, limits in enumerate(arm.joint_ranges):
        steps = np.zeros(1)
        if j > 0 and not frames.slides[j]:
            steps = np.concatenate([steps, moves])
            steps = steps[np.sort(np.unique(steps, return_index=True)[1])]  # zero stays first
            if limits is not None:
                there = pose[j] + steps
                fits = (there >= limits[0] - 1e-9) & (there <= limits[1] + 1e-9)
                fits[0] = True
                steps = steps[fits]
        options.append(pose[j] + steps)
    if np.prod([float(len(o)) for o in options]) <= most:
        grid = np.meshgrid(*options, indexing="ij")
        return np.stack([g.ravel() for g in grid], axis=1)
    each = np.arange(arm.n)
    single = [np.where(each == j, q, pose) for j, own in enumerate(options) for q in own[1:]]
    drawn = np.stack([rng.choice(o, size=most) for o in options], axis=1)
    return np.vstack([pose, *single, drawn])


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkPosterior:
    """Posterior over the loose link, from the directions of several poses."""

    probabilities: Array
    """Probability of each link (n,)."""
    directions: Array
    """Direction that fits each link best, in the link's own frame, axial (n, d)."""
    sd: Array
    """Its rms standard deviation over the directions across (n,) [rad]."""


def link_posterior(
    frames: ToolFrames, poses: Sequence[Array], seen: Sequence[Array], *, width: float
) -> LinkPosterior:
    """Weigh all links by the directions seen in several poses.

    The direction in the link is summed out (uniform beforehand).

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    poses, seen : sequence of ndarray (n,), (d,)
        Poses [rad or m], and the axis seen in each, a unit vector in the tool frame.
    width : float
        Width of the axes' scatter, as `bingham_width` gives it [rad].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> frames = ToolFrames(planar(2))
    >>> poses = np.array([[0.0, 0.3], [0.0, 1.6]])
    >>> seen = frames.images(poses)[:, 0] @ [0.8, 0.6]  # a slide at link 1
    >>> found = link_posterior(frames, poses, seen, width=0.05)
    >>> int(found.probabilities.argmax()), np.abs(found.directions[0]).round(6).tolist()
    (0, [0.8, 0.6])
    """
    axes, images = np.array(seen), frames.images(np.array(poses))
    across = (np.eye(axes.shape[1]) - axes[:, :, None] * axes[:, None]) / width**2
    carried = np.einsum("tkia,tij,tkjb->kab", images, across, images)
    log = log_mean_bingham(carried)
    share = np.exp(log - log.max())
    values, vectors = np.linalg.eigh(carried)
    spread = 1 / np.maximum(values[:, 1:] - values[:, :1], 1.0)
    return LinkPosterior(
        probabilities=share / share.sum(),
        directions=vectors[:, :, 0],
        sd=np.sqrt(spread.mean(axis=1)),
    )


def choose_move(
    frames: ToolFrames, posterior: LinkPosterior, candidates: Array, *, sd: float
) -> int:
    """Choose the pose whose next direction tells the remaining links best apart.

    Each link predicts a direction in each candidate (C, n). Two of them, an angle d apart, are
    confused no more often than exp(-d² / 8 s²), with s the standard deviation of measurement
    and prediction together (Bhattacharyya's bound). The candidate with the least confusion over all
    pairs wins, pairs weighted by their probabilities.
    """
    weight = posterior.probabilities
    alive = np.flatnonzero(weight > 1e-4 * weight.max())
    one, other = np.triu_indices(len(alive), 1)
    if not len(one):
        return 0
    pair = weight[alive][one] * weight[alive][other]
    own = posterior.sd[alive] ** 2
    slides = np.einsum("ckij,kj->cki", frames.images(candidates), posterior.directions)[:, alive]
    cosine = np.abs(np.einsum("cpi,cpi->cp", slides[:, one], slides[:, other]))
    angle = np.arccos(np.minimum(cosine, 1.0))
    confusion = overlap(angle**2, sd**2 + 0.5 * (own[one] + own[other])) @ pair
    return int(np.argmin(confusion))


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
        q = self.arm.checked_pose(start, reachable=True)
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
            where = candidate_poses(self.frames, poses[-1], self.moves, most=_COMBINATIONS, rng=rng)
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
    directions: int = 10,
) -> Array:
    """Confusability of links of unknown direction after adding each candidate pose (C,), 0 to 1.

    A slide at link k along z shows the axes R_k z. The direction in link l that comes closest to
    them leaves the misfit e², the sum of sin² over the poses. The two are told apart as two
    Gaussians e/s apart: Bhattacharyya's bound on their confusion is exp(-e²/8s²), averaged over the
    pairs of links and over z, `directions` of them over the half sphere; in the plane one stands
    for all.
    """
    taken, new = (np.atleast_2d(np.asarray(p, dtype=float)) for p in (poses, candidates))
    z = axes_grid(directions, 3) if frames.dimension == 3 else np.array([[1.0, 0.0]])
    index = np.arange(frames.arm.n)
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
    return np.asarray(overlap(misfit, sd**2).mean(axis=(1, 2)))
