"""Blind rows: one verdict on every arm, as soon as it counts. What no agent may fall below."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import EpisodeAgent, Problem
from loose_agents.core.belief_agent import records_taken
from loose_env.faults import UNSURE

__all__ = ["BlindAgent"]


class BlindAgent(EpisodeAgent):
    """Gives the same verdict on every arm, whatever the record shows.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    verdict : str
        A hypothesis, or "unsure".
    """

    def __init__(self, problem: Problem, verdict: str, *, seed: int = 0) -> None:
        super().__init__(problem, seed=seed)
        self.verdict = verdict

    def begin(self, rng: np.random.Generator) -> Any:
        """Keep nothing."""
        return ()

    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Take the cheapest records until the verdict counts; then give it."""
        problem = self.problem
        taken = records_taken(problem, observation)
        unsure = problem.actions.allows_unsure(taken, taken)
        if taken and (self.verdict != UNSURE or unsure):
            return problem.verdict(self.verdict)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[0] = 1
        shortest = int(np.argmin(problem.settings.durations))
        return problem.actions.encode(levels=levels, duration=shortest)
