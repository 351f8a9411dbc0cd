"""Openness of seats under gravity, and moves that take it into account."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import LinearArm
from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.link_finding.moves import choose_move
from loose_env.diagnosis.link_finding.spatial import LinkPosterior
from loose_env.excitation import at_levels
from loose_env.typing import Array

__all__ = ["choose_open_move", "expected_openness"]

_LEAST = 0.05
"""Openness below which a seat counts as shut."""


def expected_openness(
    linear: LinearArm,
    posterior: LinkPosterior,
    poses: ArrayLike,
    *,
    level: float,
) -> Array:
    """Expected openness of seats in several poses, all joints excited.

    Gravity along a slide holds it shut until the excitation overcomes it. With F the rms force
    that the shut seat transmits along its slide and G the weight it carries along it, the share is
    F / sqrt(F² + G²). Friction is unknown, and the same in all poses.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    posterior : LinkPosterior
        Links in question and the direction in each; its joints count with their own load.
    poses : array_like (C, n)
        Poses.
    level : float
        Wanted rms acceleration of the tool from each joint [m/s²].

    Returns
    -------
    ndarray (C, 2 n)
        For each hypothesis in the order of `fault_locations`, from 0, held shut, to 1, free.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis.link_finding.direction_images import ToolFrames
    >>> from loose_env.diagnosis.link_finding.spatial import DirectionSighting, link_posterior
    >>> arm = planar(2)
    >>> seen = [DirectionSighting.of([0.0, 0.5], [1.0, 0.0], 0.1)]
    >>> known = link_posterior(ToolFrames(arm), seen)
    >>> float(expected_openness(LinearArm(arm), known, [[0.0, 0.5]], level=4.0).max())
    1.0
    """
    rows = np.atleast_2d(np.asarray(poses, dtype=float))
    n = linear.arm.n
    shares = np.empty((len(rows), 2 * n))
    for i, row in enumerate(rows):
        at = linear.at(row)
        excitation, _ = at_levels(at, np.full(n, level), duration=1.0)
        answer = at.response(excitation.excited)
        torque = np.array(excitation.torque_rms)[list(excitation.excited)]
        z = posterior.directions
        force = np.einsum("kias,ia->kis", answer.slide[..., : z.shape[1], :], z) * torque
        drive = np.sqrt(np.mean(np.sum(np.abs(force) ** 2, axis=-1), axis=0))
        weight = np.abs(np.einsum("ia,ia->i", at.seat_load[:, : z.shape[1]], z))
        play = np.sqrt(np.mean(np.sum(np.abs(answer.hinge * torque) ** 2, axis=-1), axis=0))
        load = np.abs(at.load[linear.hinge_dofs])
        drives, loads = np.concatenate([drive, play]), np.concatenate([weight, load])
        size = np.hypot(drives, loads)
        shares[i] = np.divide(drives, size, out=np.zeros_like(size), where=size > 0)
    return shares


def choose_open_move(
    frames: ToolFrames,
    linear: LinearArm,
    posterior: LinkPosterior,
    candidates: ArrayLike,
    *,
    sd: float,
    level: float,
    shortlist: int = 12,
) -> Array:
    """Choose the pose that discriminates best between seats, gravity considered.

    The best candidates by direction alone are looked at again with each hypothesis's standard
    deviation divided by how open its seat would be there.

    Parameters
    ----------
    frames, linear
        The arm's rotations and its linear model.
    posterior : LinkPosterior
        Prior knowledge.
    candidates : array_like (C, n)
        Poses to choose from.
    sd : float
        Standard deviation of the direction of an open seat [rad].
    level : float
        Excitation: rms acceleration of the tool from each joint [m/s²].
    shortlist : int
        Candidates that are looked at again.

    Returns
    -------
    ndarray (n,)
        The pose.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis.link_finding.moves import candidate_poses
    >>> from loose_env.diagnosis.link_finding.spatial import DirectionSighting, link_posterior
    >>> arm = planar(2)
    >>> frames = ToolFrames(arm)
    >>> known = link_posterior(frames, [DirectionSighting.of([0, 0.5], [0.6, 0.8], 0.05)])
    >>> where = candidate_poses(arm, [0, 0.5], [-1.0, 1.5], joints="one", sliding=frames.slides)
    >>> choose_open_move(frames, LinearArm(arm), known, where, sd=0.05, level=4.0).tolist()
    [0.0, 2.0]
    """
    rows = np.atleast_2d(np.asarray(candidates, dtype=float))
    best, _ = choose_move(frames, posterior, rows, sd=sd, count=shortlist)
    shares = expected_openness(linear, posterior, rows[best], level=level)
    again, _ = choose_move(frames, posterior, rows[best], sd=sd / np.maximum(shares, _LEAST))
    return np.asarray(rows[best[again[0]]])
