"""Finding the loose link from directions in space (or in the plane), two ways.

The thesis's way takes the cross product of the directions before and after a joint's move for
the axis of the rotation between them (4.31) and looks whether it is the joint's. In space this
holds only for a direction across the axis: at an angle b from the axis, a move D is estimated with
the axis off by e, tan(e) = cot(b) / cos(D / 2), which for random directions and D = 60 degrees is
34 degrees in the median.

The other way asks what each hypothesis would have the tool see, and compares that. With R_k(q)
from link k's frame to the tool's, directions p measured with precision W in several poses are
carried back into link k: A_k = sum R_k' W R_k. The direction that fits link k best is the
eigenvector of the smallest eigenvalue of A_k; summing it out leaves the link's likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.diagnosis.likelihood.axial_likelihood import log_mean_bingham, precision_of
from loose_env.diagnosis.link_finding.direction_images import ToolFrames, fault_locations
from loose_env.diagnosis.link_finding.planar import Finding, LinkFindingSettings
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = [
    "DirectionSighting",
    "LinkPosterior",
    "axis_from_turn",
    "confusable_faults",
    "judge_turn_in_space",
    "link_posterior",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class DirectionSighting:
    """Direction of looseness seen in one pose."""

    pose: Array
    """Pose [rad, or m where a joint slides] (n,)."""
    direction: Array
    """Unit vector in the tool frame (d,), axial."""
    precision: Array
    """Precision across the direction [1/rad²] (d, d); zero where nothing was seen."""

    @classmethod
    def of(cls, pose: ArrayLike, direction: ArrayLike, uncertainty: ArrayLike) -> DirectionSighting:
        """Make a sighting of a direction with a standard deviation [rad] or covariance [rad²].

        Raises
        ------
        InvalidData
            As `precision_of`.
        """
        precision = precision_of(direction, uncertainty)
        p = np.asarray(direction, dtype=float)
        return cls(
            pose=np.asarray(pose, dtype=float),
            direction=p / np.linalg.norm(p),
            precision=precision,
        )


def axis_from_turn(before: ArrayLike, after: ArrayLike, move: float) -> Array:
    """Estimate the axis about which a direction turned, z* = (p x p*) / sin(-D) (4.31).

    Parameters
    ----------
    before, after : array_like (3,)
        Unit vectors p and p* in the tool frame; their signs do not matter, so neither does that
        of the result.
    move : float
        The joint's move D [rad], no multiple of pi.

    Returns
    -------
    ndarray (3,)
        z*; its length is 1 if the direction lies across the axis.

    Raises
    ------
    InvalidSetting
        If sin(D) is zero.

    Examples
    --------
    >>> p, turned = [1.0, 0.0, 0.0], [np.cos(0.5), -np.sin(0.5), 0.0]
    >>> axis_from_turn(p, turned, 0.5).round(6).tolist()
    [-0.0, -0.0, 1.0]
    """
    if abs(np.sin(move)) < 1e-6:
        raise InvalidSetting(
            f"a move of {np.degrees(move):g} degrees turns every axis onto itself; take another"
        )
    p, turned = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    return np.asarray(np.cross(p, turned) / np.sin(-move))


def judge_turn_in_space(
    before: ArrayLike,
    after: ArrayLike,
    *,
    axis: ArrayLike,
    move: float,
    settings: LinkFindingSettings,
) -> Finding:
    """Say whether the direction turned when one joint moved (steps 5 to 8 of 4.2.2).

    As the sign of a direction is unknown, so is that of z*: z* and -z* are both held against the
    joint's axis. In the plane (two components) z* is a number and the axis is 1.

    Parameters
    ----------
    before, after : array_like (d,)
        Unit vectors in the tool frame before and after the move; d = 2 or 3.
    axis : array_like (3,)
        Axis of the joint in the tool frame (4.30); a joint's own move does not change it.
    move : float
        The joint's move [rad].
    settings : LinkFindingSettings
        Holds the thresholds: `still` (e_min) and `turned` (e_max).

    Returns
    -------
    {"still", "turned", "unclear"}

    Examples
    --------
    >>> rules = LinkFindingSettings()
    >>> z = [0.0, 0.0, 1.0]
    >>> judge_turn_in_space([1, 0, 0], [0, 1, 0], axis=z, move=np.pi / 2, settings=rules)
    'turned'
    >>> judge_turn_in_space([1, 0, 0], [-1, 0, 0], axis=z, move=np.pi / 2, settings=rules)
    'still'
    """
    if abs(np.sin(move)) < 1e-6:
        return "unclear"
    p, q = (np.asarray(v, dtype=float) for v in (before, after))
    if p.shape != q.shape or p.shape not in ((2,), (3,)):
        raise InvalidData(
            f"directions have two or three components each, got shapes {p.shape} and {q.shape}"
        )
    line = np.asarray(axis, dtype=float)
    if len(p) == 2:
        p, q, line = np.append(p, 0.0), np.append(q, 0.0), np.array([0.0, 0.0, 1.0])
    estimate = axis_from_turn(p, q, move)
    if np.linalg.norm(estimate) < settings.still:
        return "still"
    off = min(np.linalg.norm(estimate - line), np.linalg.norm(estimate + line))
    return "turned" if off < settings.turned else "unclear"


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkPosterior:
    """Posterior over the loose link, from the directions of several poses."""

    names: tuple[str, ...]
    """Hypotheses: a slide at each link, then play in each joint."""
    probabilities: Array
    """Their probabilities (H,)."""
    log_likelihoods: Array
    """Log-density of all directions under each, relative to uniform ones (H,)."""
    directions: Array
    """Direction that fits each link best, in the link's own frame, axial (n, d)."""
    covariances: Array
    """Its covariance [rad²] (n, d, d); no eigenvalue exceeds 1."""

    @property
    def best(self) -> str:
        """The most probable hypothesis; the first of equals."""
        return self.names[int(np.argmax(self.probabilities > self.probabilities.max() - 1e-9))]

    @property
    def direction_sd(self) -> Array:
        """Rms standard deviation of each link's direction, over the directions across [rad]."""
        total = np.trace(self.covariances, axis1=-2, axis2=-1)
        # Rounding can leave a sure direction a trace below zero.
        return np.asarray(np.sqrt(np.maximum(total, 0.0) / (self.directions.shape[1] - 1)))

    def of(self, names: Sequence[str]) -> float:
        """Probability that one of several hypotheses holds."""
        return float(sum(self.probabilities[self.names.index(name)] for name in set(names)))


def link_posterior(
    frames: ToolFrames,
    sightings: Sequence[DirectionSighting],
    *,
    prior: ArrayLike | None = None,
    scales: Sequence[float] = (1.0,),
) -> LinkPosterior:
    """Weigh all hypotheses by the directions seen in several poses.

    The direction in the link is summed out (uniform beforehand), so that play, whose line is
    known, is weighted fairly against a slide, whose direction is not.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    sightings : sequence of DirectionSighting
        One or more.
    prior : array_like (2 n,), optional
        Prior weight of each hypothesis, in the order of `fault_locations`; equal by default. Zero
        leaves a hypothesis out.
    scales : sequence of float
        Factors by which the standard deviations given may be too small, all equally likely;
        summed out. More than one makes single bad directions matter less.

    Raises
    ------
    InvalidData
        If there is no sighting.
    InvalidSetting
        If prior or scales make no sense.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> frames = ToolFrames(planar(2))
    >>> poses = np.array([[0.0, 0.3], [0.0, 1.6]])
    >>> seen = frames.images(poses)[:, 0] @ [0.8, 0.6]  # a slide at link 1
    >>> found = link_posterior(
    ...     frames, [DirectionSighting.of(q, p, 0.05) for q, p in zip(poses, seen)]
    ... )
    >>> found.best, found.directions[0].round(6).tolist()
    ('structural_looseness@link1', [0.8, 0.6])
    """
    names = fault_locations(frames.arm)
    weights = np.ones(len(names)) if prior is None else np.asarray(prior, dtype=float)
    if weights.shape != (len(names),) or not np.isfinite(weights).all() or weights.min() < 0:
        raise InvalidSetting(
            f"the prior has {len(names)} weights, zero or more, one for each of {names}; "
            f"got {prior!r}"
        )
    if not weights.any():
        raise InvalidSetting("the prior leaves no hypothesis; give one a positive weight")
    if not scales or min(scales) <= 0:
        raise InvalidSetting(f"scales are positive factors, got {scales!r}")
    if not sightings:
        raise InvalidData("there is no direction to judge by; take a record first")
    poses = np.array([s.pose for s in sightings])
    precision = np.array([s.precision for s in sightings])
    images, lines = frames.images(poses), frames.unit_lines(poses)
    carried = np.einsum("tkia,tij,tkjb->kab", images, precision, images)
    off = np.einsum("tki,tij,tkj->tk", lines, precision, lines)
    has_line = np.any(lines != 0, axis=-1)

    by_scale = []
    for scale in scales:
        alone = log_mean_bingham(precision / scale**2)  # (T,)
        slide = log_mean_bingham(carried / scale**2) - alone.sum()
        # A joint that cannot move the tool in a pose expects nothing there: uniform.
        play = np.where(has_line, -0.5 * off / scale**2 - alone[:, None], 0.0).sum(axis=0)
        by_scale.append(np.concatenate([slide, play]))
    likelihood = np.logaddexp.reduce(by_scale, axis=0) - np.log(len(scales))
    with np.errstate(divide="ignore"):
        log = likelihood + np.log(weights)
    probability = np.exp(log - log.max())
    values, vectors = np.linalg.eigh(carried)
    above = values[:, 1:] - values[:, :1]
    spread = 1 / np.maximum(above, 1.0)
    across = vectors[:, :, 1:]
    return LinkPosterior(
        names=names,
        probabilities=probability / probability.sum(),
        log_likelihoods=likelihood,
        directions=_axial(vectors[:, :, 0]),
        covariances=np.einsum("kia,ka,kja->kij", across, spread, across),
    )


def confusable_faults(
    frames: ToolFrames,
    hypothesis: str,
    direction: ArrayLike | None = None,
    *,
    tolerance: float = np.radians(1.0),
    poses: int = 64,
) -> tuple[str, ...]:
    """Hypotheses that no move can tell from a given one by direction, itself included.

    Play in the last joint always moves the tool along one line of the tool frame, as a slide of
    the last link does; the links either side of a sliding joint never turn against each other;
    and a slide along a joint's axis looks the same on both sides of that joint.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    hypothesis : str
        One of `fault_locations`.
    direction : array_like (d,), optional
        Direction of the slide in its link's frame; needed for structural looseness.
    tolerance : float
        Rms angle up to which two hypotheses count as alike [rad]; take that of the measurement
        for those that cannot be told in practice.
    poses : int
        Number of poses, spread over the joints' ranges, in which all are compared.

    Returns
    -------
    tuple of str
        In the order of `fault_locations`.

    Raises
    ------
    InvalidSetting
        If the hypothesis is unknown, or a slide comes without its direction.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> frames = ToolFrames(scara())
    >>> confusable_faults(frames, "structural_looseness@link1", [0.0, 0.0, 1.0])[:4][-1]
    'structural_looseness@link4'
    >>> confusable_faults(frames, "structural_looseness@link2", [1.0, 0.0, 0.0])
    ('structural_looseness@link2', 'structural_looseness@link3')
    """
    names, n = fault_locations(frames.arm), frames.arm.n
    if hypothesis not in names:
        raise InvalidSetting(f"unknown hypothesis {hypothesis!r}; known are {names}")
    rng = np.random.default_rng(0)  # the same poses for everybody
    sample = np.array([frames.arm.random_pose(rng) for _ in range(poses)])
    images, lines = frames.images(sample), frames.unit_lines(sample)
    location = names.index(hypothesis)
    if location < n:
        if direction is None:
            raise InvalidSetting(f"{hypothesis} needs the direction of the slide in its link")
        z = np.asarray(direction, dtype=float)
        seen = images[:, location] @ (z / np.linalg.norm(z))
    else:
        seen = lines[:, location - n]
    across = np.eye(frames.dimension) - np.einsum("ti,tj->tij", seen, seen)
    carried = np.einsum("tkia,tij,tkjb->kab", images, across, images) / poses
    slide = np.linalg.eigvalsh(carried)[:, 0]
    play = np.mean(1 - np.einsum("tki,ti->tk", lines, seen) ** 2, axis=0)
    alike = np.concatenate([slide, play]) <= np.sin(tolerance) ** 2
    alike[location] = True
    return tuple(name for name, same in zip(names, alike, strict=True) if same)


def _axial(vectors: Array) -> Array:
    """Choose signs so that each vector's largest component is positive."""
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=1)[:, None], axis=1)
    return np.asarray(np.where(largest < 0, -vectors, vectors))
