"""Curriculum that takes verdicts only after a number of records, which falls to one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from loose_agents.rl.end_to_end.learning_curve import Budget
from loose_agents.rl.training_env import forced_records

__all__ = ["MinimumRecords", "MinimumRecordsCallback"]


class MinimumRecords(VecEnvWrapper):
    """Environments that ignore a verdict before ``least`` records of an episode.

    To name a fault after one record is a local optimum where one record tells little: a policy
    that cannot read two records yet loses the price of the second one, and one that always stops
    after the first never learns to read two. A verdict that comes too early is taken as going on,
    as the environment itself takes one before the first record.
    """

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.least = 1
        """Records before which a verdict is ignored."""
        self.meanwhile: Callable[[], None] | None = None
        """Called in each step while the arms are simulated."""
        self._records = np.zeros(venv.num_envs, dtype=np.int64)

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        self._records[:] = 0
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of the next step, early verdicts left out."""
        taken = np.array(actions)
        taken[self._records < self.least, -1] = 0
        self.venv.step_async(taken)

    def step_wait(self) -> Any:
        """Step all environments."""
        if self.meanwhile is not None:
            self.meanwhile()
        observation, reward, done, infos = self.venv.step_wait()
        self._records = np.where(done, 0, self._records + 1)
        return observation, reward, done, infos


class MinimumRecordsCallback(BaseCallback):
    """Sets the number before each rollout, by `loose_agents.rl.training_env.forced_records`.

    Parameters
    ----------
    env : MinimumRecords
        The environments.
    budget : Budget
        Budget of the training.
    first : int
        Records at the start.
    until : float
        Share of the training from which on one will do.
    """

    model: Any

    def __init__(self, env: MinimumRecords, budget: Budget, *, first: int, until: float) -> None:
        super().__init__()
        self.env, self.budget, self.first, self.until = env, budget, first, until

    def _on_rollout_start(self) -> None:
        left = self.budget.left(1.0 - self.model.num_timesteps / self.budget.steps)
        self.env.least = forced_records(1.0 - left, first=self.first, until=self.until)

    def _on_step(self) -> bool:
        return True
