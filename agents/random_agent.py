"""Random actions, a posterior, and a verdict when it is sure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.base import EpisodeAgent, Problem
from agents.belief import Tracker

__all__ = ["RandomAgent"]


class RandomAgent(EpisodeAgent):
    """Moves, excites and measures at random; never gives a random verdict.

    One joint at a random level and for a random time, every joint moved at random, until the
    most probable hypothesis passes ``sure`` or the records run out. Then it names that one.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    sure : float
        Probability at which it stops measuring.
    """

    def __init__(self, problem: Problem, *, sure: float = 0.9, seed: int = 0) -> None:
        super().__init__(problem, seed=seed)
        self.sure = sure
        self.tracker = Tracker(problem)

    def begin(self, rng: np.random.Generator) -> Any:
        """Start from the prior."""
        return self.tracker.begin(rng)

    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Measure something, or name the most probable hypothesis."""
        problem = self.problem
        probabilities = self.tracker.follow(observation, memory)
        done = memory.records >= problem.settings.max_records
        if memory.records > 0 and (probabilities.max() >= self.sure or done):
            return problem.verdict(problem.hypotheses[int(np.argmax(probabilities))])
        rng, n = memory.rng, problem.arm.n
        allowed = problem.actions.allowed_moves(problem.layout.pose_of(observation))
        moves = np.array([rng.choice(np.flatnonzero(row)) for row in allowed])
        levels = np.zeros(n, dtype=np.intp)
        levels[rng.integers(n)] = rng.integers(1, 1 + len(problem.arm.levels))
        duration = int(rng.integers(len(problem.settings.durations)))
        return problem.actions.encode(moves=moves, levels=levels, duration=duration)
