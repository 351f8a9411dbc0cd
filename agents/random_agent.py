"""Random poses, joints, levels and record lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.base import Problem
from agents.belief_agent import Situation

__all__ = ["RandomPolicy", "random_moves"]


class RandomPolicy:
    """One joint at a random level and for a random time, every joint moved at random.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Draw an action from the episode's generator."""
        problem, rng = self.problem, situation.rng
        moves = random_moves(problem, situation)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[rng.integers(problem.arm.n)] = rng.integers(1, 1 + len(problem.arm.levels))
        duration = int(rng.integers(len(problem.settings.durations)))
        return problem.actions.encode(moves=moves, levels=levels, duration=duration)


def random_moves(problem: Problem, situation: Situation) -> NDArray[np.intp]:
    """One of the moves each joint's range allows, drawn for every joint (n,)."""
    allowed = problem.actions.allowed_moves(situation.pose)
    return np.array([situation.rng.choice(np.flatnonzero(row)) for row in allowed])
