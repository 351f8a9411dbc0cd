"""Baseline policies: random records, and constant excitation in random poses.

The constant policy: always the same excitation, in random poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_env.errors import InvalidSetting

__all__ = ["ConstantPolicy", "RandomPolicy", "random_moves"]


class RandomPolicy:
    """Excites one random joint at a random level and duration, in random poses.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Sample an action from the episode's generator."""
        problem, rng = self.problem, situation.rng
        moves = random_moves(problem, situation)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[rng.integers(problem.arm.n)] = rng.integers(1, 1 + len(problem.arm.levels))
        duration = int(rng.integers(len(problem.settings.durations)))
        return problem.actions.encode(moves=moves, levels=levels, duration=duration)


def random_moves(problem: Problem, situation: Situation) -> NDArray[np.intp]:
    """Sample an allowed move for every joint (n,)."""
    allowed = problem.actions.allowed_moves(situation.pose)
    return np.array([situation.rng.choice(np.flatnonzero(row)) for row in allowed])


class ConstantPolicy:
    """Applies a constant excitation in random poses.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    levels : sequence of int
        Level of every joint, 0 for off.
    duration : int, optional
        Index of the record length; the longest by default.
    """

    def __init__(
        self, problem: Problem, levels: tuple[int, ...], *, duration: int | None = None
    ) -> None:
        if len(levels) != problem.arm.n or not any(levels):
            raise InvalidSetting(
                f"a constant policy needs a level for each of {problem.arm.n} joints, at least one "
                f"of them above 0; got {levels}"
            )
        self.problem, self.levels, self.duration = problem, np.array(levels), duration

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Move at random and apply the constant excitation."""
        return self.problem.actions.encode(
            moves=random_moves(self.problem, situation),
            levels=self.levels,
            duration=self.duration,
        )
