"""The constant policy: always the same excitation, in random poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.base import Problem
from agents.belief_agent import Situation
from agents.random_agent import random_moves
from loose_env.errors import InvalidSetting

__all__ = ["ConstantPolicy"]


class ConstantPolicy:
    """Shakes the same joints at the same level for the same time, in random poses.

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
        """Move at random and excite as always."""
        return self.problem.actions.encode(
            moves=random_moves(self.problem, situation),
            levels=self.levels,
            duration=self.duration,
        )
