"""The environment as the learned policy trains on it: posterior in, short choices out."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

from agents.base import Problem
from agents.belief import Tracker
from agents.learned import PolicyForm
from loose_env.envs.sb3 import Sb3VecEnv
from loose_env.envs.vector import DiagnosisVectorEnv

__all__ = ["TrackedVecEnv"]


class TrackedVecEnv(VecEnvWrapper):
    """Puts the posterior between the environments and the learner.

    Parameters
    ----------
    env : DiagnosisVectorEnv
        The environments.
    problem : Problem
        The nominal arm and the rules, as the agent will have them.
    """

    def __init__(self, env: DiagnosisVectorEnv, problem: Problem) -> None:
        self.form = PolicyForm(problem)
        self.tracker = Tracker(problem)
        super().__init__(Sb3VecEnv(env), self.form.observation_space, self.form.action_space)
        self._memories = [self.tracker.begin() for _ in range(self.num_envs)]
        self._probabilities = np.zeros((self.num_envs, len(problem.hypotheses)))

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        observations = self.venv.reset()
        self._memories = [self.tracker.begin() for _ in range(self.num_envs)]
        return self._features(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Translate the policy's choices and step."""
        self.venv.step_async(
            np.array(
                [
                    self.form.action(choice, self._probabilities[i], self._memories[i].records)
                    for i, choice in enumerate(actions)
                ]
            )
        )

    def step_wait(self) -> Any:
        """Update the posteriors; an episode that ended starts from the prior again."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            seen = self.tracker.follow(last, self._memories[i])
            infos[i]["terminal_observation"] = self.form.features(last, seen)
            self._memories[i] = self.tracker.begin()
        return self._features(observations), rewards, dones, infos

    def _features(self, observations: np.ndarray) -> np.ndarray:
        for i, row in enumerate(observations):
            self._probabilities[i] = self.tracker.follow(row, self._memories[i])
        return np.stack(
            [
                self.form.features(row, p)
                for row, p in zip(observations, self._probabilities, strict=True)
            ]
        )
