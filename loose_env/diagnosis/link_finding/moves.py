"""Choice of the move that discriminates best between the links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.link_finding.planar import Order, next_joint
from loose_env.diagnosis.link_finding.spatial import LinkPosterior
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = ["JointChoice", "blind_joints", "candidate_poses", "choose_move", "next_seeing_joint"]

JointChoice = Literal["one", "all"]


def blind_joints(
    frames: ToolFrames,
    pose: ArrayLike,
    direction: ArrayLike,
    *,
    moves: ArrayLike = (np.pi / 2,),
    least: float = np.radians(20.0),
) -> NDArray[np.bool_]:
    """Joints whose own move cannot visibly turn a direction seen in a pose.

    Those are joints that slide, and hinges with an axis along the direction: at an angle b from
    the axis, a move D turns it by 2 asin(sin(b) sin(D / 2)).

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    pose : array_like (n,)
        Pose.
    direction : array_like (d,)
        Direction seen in that pose, tool frame.
    moves : array_like (m,)
        Moves that each hinge may make [rad]; the one that turns the direction most counts.
    least : float
        Turn that can be seen [rad]: some three standard deviations of the difference of two
        directions.

    Returns
    -------
    ndarray of bool (n,)

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> frames = ToolFrames(scara())
    >>> blind_joints(frames, np.zeros(4), [1.0, 0.0, 0.0]).tolist()
    [False, False, True, False]
    >>> blind_joints(frames, np.zeros(4), [0.0, 0.0, 1.0]).tolist()
    [True, True, True, True]
    """
    p = np.zeros(3)
    p[list(frames.arm.axes)] = np.asarray(direction, dtype=float)
    along = frames.axes(pose)[0] @ (p / np.linalg.norm(p))
    sine = np.sqrt(np.maximum(0.0, 1 - along**2))
    turn = 2 * np.arcsin(np.abs(np.outer(sine, np.sin(np.asarray(moves, dtype=float) / 2))))
    turn = np.minimum(turn, np.pi - turn).max(axis=1)  # axial
    return np.asarray(frames.slides | (turn < least))


def candidate_poses(
    arm: Arm,
    pose: ArrayLike,
    moves: ArrayLike,
    *,
    joints: JointChoice,
    sliding: Sequence[bool] | NDArray[np.bool_],
    most: int = 2048,
    rng: np.random.Generator | None = None,
) -> Array:
    """Poses that one move reaches, with the joints in their ranges.

    Joints that slide stay: they cannot turn a direction. So does joint 1, which carries the
    whole arm along and changes nothing in the tool frame.

    Parameters
    ----------
    arm : Arm
        The arm, for its ranges.
    pose : array_like (n,)
        Current pose [rad, or m].
    moves : array_like (m,)
        Moves of one hinge [rad]; staying is always among them.
    joints : {"one", "all"}
        True if one joint moves, False if all may.
    sliding : sequence of bool (n,)
        Joints that slide.
    most : int
        With more combinations than this, as many are drawn, beside the moves of single joints.
    rng : numpy.random.Generator, optional
        Source of that draw; always the same one by default.

    Returns
    -------
    ndarray (C, n)
        The first row is the pose itself.

    Raises
    ------
    InvalidSetting
        If ``joints`` is neither of the two.
    """
    if joints not in ("one", "all"):
        raise InvalidSetting(f"joints is 'one' or 'all', got {joints!r}")
    q = np.asarray(pose, dtype=float)
    options: list[Array] = []
    for j, limits in enumerate(arm.joint_ranges):
        steps = np.zeros(1)
        if j > 0 and not sliding[j]:
            steps = np.concatenate([steps, np.asarray(moves, dtype=float)])
            steps = steps[np.sort(np.unique(steps, return_index=True)[1])]  # zero stays first
            if limits is not None:
                there = q[j] + steps
                fits = (there >= limits[0] - 1e-9) & (there <= limits[1] + 1e-9)
                fits[0] = True
                steps = steps[fits]
        options.append(q[j] + steps)
    single = [q]
    for j, choices in enumerate(options):
        for value in choices[1:]:
            single.append(np.where(np.arange(arm.n) == j, value, q))
    if joints == "one":
        return np.array(single)
    if np.prod([float(len(o)) for o in options]) <= most:
        grid = np.meshgrid(*options, indexing="ij")
        return np.stack([g.ravel() for g in grid], axis=1)
    generator = np.random.default_rng(0) if rng is None else rng
    drawn = np.stack([generator.choice(o, size=most) for o in options], axis=1)
    return np.vstack([single, drawn])


def choose_move(
    frames: ToolFrames,
    posterior: LinkPosterior,
    candidates: ArrayLike,
    *,
    sd: float | ArrayLike,
    count: int = 1,
    chunk: int = 1024,
) -> tuple[NDArray[np.intp], Array]:
    """Choose the poses whose next direction tells the remaining hypotheses best apart.

    Each hypothesis predicts a direction in each candidate. Two of them, an angle d apart, are
    confused no more often than exp(-d² / 8 s²), with s the standard deviation of measurement and
    prediction together (Bhattacharyya's bound). The candidate with the least confusion over all
    pairs wins, pairs weighted by their probabilities.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    posterior : LinkPosterior
        Prior knowledge.
    candidates : array_like (C, n)
        Poses to choose from.
    sd : float or array_like (C, 2 n)
        Standard deviation that the next direction is expected to have, in each pose under each
        hypothesis [rad].
    count : int
        Number of the best candidates to return.
    chunk : int
        Candidates that are weighted at once.

    Returns
    -------
    index : ndarray of int (count,)
        The best candidates, best first; among equals the order of the candidates.
    confusion : ndarray (count,)
        Their remaining share of confusion, 0 to 1; 1: nothing can be told apart.

    Raises
    ------
    InvalidSetting
        If sd is not positive.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis.link_finding.spatial import DirectionSighting, link_posterior
    >>> arm = planar(2)
    >>> frames = ToolFrames(arm)
    >>> known = link_posterior(frames, [DirectionSighting.of([0, 0.5], [0.6, 0.8], 0.05)])
    >>> where = candidate_poses(arm, [0, 0.5], [-1.0, 1.5], joints="one", sliding=frames.slides)
    >>> where[choose_move(frames, known, where, sd=0.05)[0]].tolist()
    [[0.0, 2.0]]
    """
    spread = np.asarray(sd, dtype=float)
    if not np.isfinite(spread).all() or np.min(spread) <= 0:
        raise InvalidSetting(f"sd must be a positive angle [rad], got {sd!r}")
    rows, n = np.atleast_2d(np.asarray(candidates, dtype=float)), frames.arm.n
    weight = posterior.probabilities
    alive = np.flatnonzero(weight > 1e-4 * weight.max())
    one, other = np.triu_indices(len(alive), 1)
    if not len(one):
        return np.arange(min(count, len(rows))), np.zeros(min(count, len(rows)))
    pair = weight[alive][one] * weight[alive][other]
    own = np.concatenate([posterior.direction_sd**2, np.zeros(n)])[alive]
    own = 0.5 * (own[one] + own[other])
    spread = np.broadcast_to(spread, (len(rows), len(weight)))[:, alive]
    confusion = np.empty(len(rows))
    for start in range(0, len(rows), chunk):
        part = rows[start : start + chunk]
        slide = np.einsum("ckij,kj->cki", frames.images(part), posterior.directions)
        seen = np.concatenate([slide, frames.unit_lines(part)], axis=1)[:, alive]
        cosine = np.abs(np.einsum("cpi,cpi->cp", seen[:, one], seen[:, other]))
        angle = np.arccos(np.minimum(cosine, 1.0))
        errors = spread[start : start + chunk] ** 2
        variance = 0.5 * (errors[:, one] + errors[:, other]) + own
        confusion[start : start + chunk] = np.exp(-(angle**2) / (8 * variance)) @ pair
    best = np.argsort(confusion, kind="stable")[:count]
    return best, confusion[best] / pair.sum()


def next_seeing_joint(
    order: Order, low: int, high: int, blind: Sequence[bool] | NDArray[np.bool_]
) -> int | None:
    """Joint to move next by the thesis's order while the loose link lies in low..high.

    A blind joint is passed over for the nearest one that is not; None if all are blind, when no
    move of a single joint can tell these links apart from here.

    Parameters
    ----------
    order : {"outward", "inward", "bisection"}
        The order.
    low, high : int
        Links in question.
    blind : sequence of bool (n,)
        From `blind_joints`.

    Examples
    --------
    >>> next_seeing_joint("outward", 1, 4, [False, True, False, False])
    3
    """
    wanted = next_joint(order, low, high)
    seeing = [j for j in range(low + 1, high + 1) if not blind[j - 1]]
    return min(seeing, key=lambda j: abs(j - wanted)) if seeing else None
