"""Candidate records of a policy: pose, excited joints and duration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_env.excitation import at_levels

__all__ = ["Candidate", "candidate_at", "excitations", "poses"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A record that could be taken next."""

    action: NDArray[np.int64]
    """The action that takes it."""
    pose: NDArray[np.float64]
    """Where the joints will be (n,) [rad or m]."""
    torque: NDArray[np.float64]
    """Rms torque of every joint, within the drives' limits (n,) [N·m or N]."""
    duration: float
    """Its length [s]."""
    price: float
    """What it costs."""


def poses(
    problem: Problem, situation: Situation, count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sample moves uniformly from the allowed ranges, with the resulting poses.

    Returns
    -------
    moves : ndarray of int (K, n)
        Without repetition, at most ``count``.
    poses : ndarray (K, n)
        Where they lead [rad or m].
    """
    allowed = problem.actions.allowed_moves(situation.pose)
    options = [np.flatnonzero(row) for row in allowed]
    total = int(np.prod([len(o) for o in options], dtype=np.int64))
    if total <= count:
        moves = np.stack(np.meshgrid(*options, indexing="ij"), -1).reshape(-1, len(options))
    else:
        drawn = [situation.rng.choice(o, 2 * count) for o in options]
        moves = np.unique(np.stack(drawn, 1), axis=0)
        moves = situation.rng.permutation(moves)[:count]
    steps = problem.actions.steps[np.arange(problem.arm.n), moves]
    where = np.array([problem.arm.wrap(situation.pose + step) for step in steps])
    return moves.astype(np.intp), np.round(where, 9)


def excitations(problem: Problem) -> list[tuple[NDArray[np.intp], int]]:
    """Enumerate excitation levels of the joints and indices of the duration.

    All joints together at the top level for the longest time comes first; then they at the lower
    levels and for shorter times, and each joint alone at the two highest levels.
    """
    n, top = problem.arm.n, len(problem.arm.levels)
    durations = problem.settings.durations
    longest = int(np.argmax(durations))
    every = np.ones(n, dtype=np.intp)
    found = [(level * every, longest) for level in range(top, 0, -1)]
    found += [(top * every, k) for k in range(len(durations)) if k != longest]
    for level in range(top, max(top - 2, 0), -1):
        found += [(level * one, longest) for one in np.eye(n, dtype=np.intp)]
    return found


def candidate_at(
    problem: Problem,
    moves: NDArray[np.intp],
    pose: NDArray[np.float64],
    levels: NDArray[np.intp],
    duration: int,
) -> Candidate:
    """Build a candidate: the torque of the levels in a pose, and its cost."""
    seconds = problem.settings.durations[duration]
    wanted = np.array([0.0, *problem.arm.levels])[levels]
    excitation, _ = at_levels(problem.linear.at(pose), wanted, duration=seconds)
    prices = problem.settings.prices
    return Candidate(
        action=problem.actions.encode(moves=moves, levels=levels, duration=duration),
        pose=pose,
        torque=np.array(excitation.torque_rms),
        duration=seconds,
        price=prices.record + prices.second * seconds + prices.level * int(levels.sum()),
    )
