"""Policies that choose poses at one common excitation: pose sets, greedy, copied moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_agents.base import Agent, Problem
from loose_agents.belief import Situation
from loose_env.diagnosis import (
    LinkPosterior,
    ToolFrames,
    candidate_poses,
    choose_open_move,
    fault_locations,
)
from loose_env.errors import InvalidSetting

Excited = Literal["all", "first"]
"""Joints that are shaken, at the top level: all of them, or joint 1."""


def levels_for(problem: Problem, excited: Excited) -> NDArray[np.intp]:
    """Level of every joint (n,)."""
    if excited not in ("all", "first"):
        raise InvalidSetting(f"excited joints are 'all' or 'first', got {excited!r}")
    top = len(problem.arm.levels)
    levels = np.full(problem.arm.n, top, dtype=np.intp)
    if excited == "first":
        levels[1:] = 0
    return levels


def nearest_moves(problem: Problem, pose: ArrayLike, target: ArrayLike) -> NDArray[np.intp]:
    """Move of each joint that brings it nearest to a target, within limits (n,)."""
    q, wanted = np.asarray(pose, dtype=float), np.asarray(target, dtype=float)
    actions = problem.actions
    miss = q[:, None] + actions.steps - wanted[:, None]
    for j, limits in enumerate(problem.arm.joint_ranges):
        if limits is None:  # turns without end
            miss[j] = (miss[j] + np.pi) % (2 * np.pi) - np.pi
    # Of equals the smaller move, so that a joint which is there stays there.
    away = np.abs(miss) + 1e-9 * np.abs(actions.steps)
    return np.asarray(np.argmin(np.where(actions.allowed_moves(q), away, np.inf), axis=1))


class PoseSetPolicy:
    """Visits a set of poses in order, by the nearest reachable moves.

    After the last pose it begins again.
    """

    def __init__(self, problem: Problem, poses: ArrayLike, *, excited: Excited = "all") -> None:
        rows = np.asarray(poses, dtype=float)
        n = problem.arm.n
        if rows.ndim != 2 or len(rows) < 1 or rows.shape[1] != n or not np.isfinite(rows).all():
            raise InvalidSetting(
                f"a pose set of {problem.arm.name!r} is one or more rows of {n} finite joint "
                f"positions [rad or m], got shape {rows.shape}"
            )
        self.problem, self.poses = problem, rows
        self.levels = levels_for(problem, excited)

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Go to the next pose of the set."""
        target = self.poses[situation.records % len(self.poses)]
        moves = nearest_moves(self.problem, situation.pose, target)
        return self.problem.actions.encode(moves=moves, levels=self.levels)


class GreedySeparation:
    """Maximises the posterior-weighted separation of the hypotheses' images.

    The first record is taken where the arm stands.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        excited: Excited = "all",
        sd: float = np.radians(8.0),
        candidates: int = 512,
        sight: Callable[[Problem, Situation], LinkPosterior] | None = None,
    ) -> None:
        self.problem, self.sd, self.candidates = problem, sd, candidates
        self.frames = ToolFrames(problem.arm)
        self.levels = levels_for(problem, excited)
        self.sight = image_posterior if sight is None else sight

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Score the reachable moves and choose the best."""
        problem = self.problem
        if situation.records == 0:
            return problem.actions.encode(levels=self.levels)
        where = candidate_poses(
            problem.arm,
            situation.pose,
            problem.actions.moves,
            joints="all",
            sliding=self.frames.slides,
            most=self.candidates,
            rng=situation.rng,
        )
        target = choose_open_move(
            self.frames,
            problem.linear,
            self.sight(problem, situation),
            where,
            sd=self.sd,
            level=problem.arm.levels[-1],
        )
        moves = nearest_moves(problem, situation.pose, target)
        return problem.actions.encode(moves=moves, levels=self.levels)


def image_posterior(problem: Problem, situation: Situation) -> LinkPosterior:
    """Convert the tracker's belief to the input of the move selection."""
    belief = getattr(situation.memory, "belief", None)
    if belief is None:
        raise InvalidSetting(
            "the estimator's memory holds no belief about directions; use "
            "loose_agents.belief.Tracker or give another `sight`"
        )
    names, n = fault_locations(problem.arm), problem.arm.n
    weights = dict(zip(problem.hypotheses, situation.probabilities, strict=True))
    probabilities = np.array([weights.get(name, 0.0) for name in names])
    if probabilities.sum() <= 0:  # all weight on what has no direction
        probabilities = np.ones(len(names))
    axes = belief.directions
    shares = np.array([belief.by_direction(link) for link in range(1, n + 1)])
    values, vectors = np.linalg.eigh(np.einsum("ka,ai,aj->kij", shares, axes, axes))
    across = vectors[:, :, :-1]
    return LinkPosterior(
        names=names,
        probabilities=probabilities / probabilities.sum(),
        log_likelihoods=np.log(np.maximum(probabilities, 1e-300)),
        directions=vectors[:, :, -1],
        covariances=np.einsum("kia,ka,kja->kij", across, values[:, :-1], across),
    )


class MovesOf:
    """Copies another agent's moves, at the common excitation.

    Where that agent would give a verdict the arm stays. One instance plays one episode.
    """

    def __init__(self, problem: Problem, agent: Agent, *, excited: Excited = "all") -> None:
        self.problem, self.agent = problem, agent
        self.levels = levels_for(problem, excited)
        self._state: Sequence[Any] | None = None

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Query the other agent and use its moves."""
        start = np.array([situation.records == 0])
        actions, self._state = self.agent.predict(
            situation.observation[None], self._state, start, deterministic=True
        )
        moves = self.problem.actions.decode(np.asarray(actions)[0]).moves
        return self.problem.actions.encode(moves=moves, levels=self.levels)
