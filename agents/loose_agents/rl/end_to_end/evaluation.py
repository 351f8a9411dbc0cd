"""Evaluation of a policy in training on held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import records_taken
from loose_agents.core.seeds import CURVE_SEED
from loose_agents.evaluation.evaluate import EpisodeRow, evaluate
from loose_env.arms import Arm

__all__ = ["evaluate_policy"]


def evaluate_policy(
    model: Any, problem: Problem, episodes: int, threads: int, true_arm: Arm
) -> list[EpisodeRow]:
    """Play the first held-out episodes with the most probable actions, on the true arm."""
    agent: Any = _BatchPolicy(model, problem)
    if hasattr(model.policy, "lstm_actor"):
        from loose_agents.rl.model_agent import ModelAgent
        from loose_agents.rl.network import network_of

        agent = ModelAgent(problem, network_of(model))
    return evaluate(
        agent,
        "learner",
        problem.arm,
        problem.settings,
        episodes=episodes,
        seed=CURVE_SEED,
        width=min(episodes, 128),
        threads=threads,
        true_arm=true_arm,
    )


class _BatchPolicy:
    """A policy without memory as an agent: all observations at once, masks where it has them."""

    def __init__(self, model: Any, problem: Problem) -> None:
        self.model, self.problem = model, problem
        self.masked = type(model).__name__ == "MaskablePPO"

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Sequence[Any] | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], None]:
        """Choose actions (num, choices) for observations (num, size)."""
        further = {"action_masks": self._masks(observation)} if self.masked else {}
        actions, _ = self.model.predict(observation, deterministic=deterministic, **further)
        return actions, None

    def _masks(self, observations: NDArray[np.float32]) -> NDArray[np.bool_]:
        layout, actions = self.problem.layout, self.problem.actions
        return np.stack(
            [
                actions.mask(
                    layout.pose_of(row),
                    records_taken(self.problem, row),
                    int(np.count_nonzero(layout.slots_of(row)[:, 0])),
                )
                for row in observations
            ]
        )
