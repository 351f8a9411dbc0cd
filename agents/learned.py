"""A policy trained by reinforcement learning on top of the posterior.

The policy chooses moves, the excited joint, its level, the record length, and when to stop;
what it names is the posterior's most probable hypothesis.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from agents.base import EpisodeAgent, Problem
from agents.belief import Tracker, tracker_features

__all__ = ["LearnedAgent", "PolicyForm"]


class PolicyForm:
    """What the policy sees and chooses, and how its choice becomes an action.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        n, settings = problem.arm.n, problem.settings
        self.nvec = np.array(
            [len(settings.moves)] * n + [n, len(problem.arm.levels), len(settings.durations), 2]
        )
        size = 2 * len(problem.hypotheses) + 2 + len(problem.layout.global_elements)
        self.observation_space = spaces.Box(-3.0, 3.0, (size,), dtype=np.float32)
        self.action_space = spaces.MultiDiscrete(self.nvec)

    def features(
        self, observation: NDArray[np.float32], probabilities: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """What the policy sees."""
        return tracker_features(self.problem, observation, probabilities)

    def action(
        self, choice: NDArray[np.int64], probabilities: NDArray[np.float64], records: int
    ) -> NDArray[np.int64]:
        """Turn a choice into an action of the environment."""
        problem = self.problem
        n = problem.arm.n
        joint, level, duration, stop = (int(c) for c in choice[n:])
        done = records >= problem.settings.max_records
        if records > 0 and (stop == 1 or done):
            return problem.verdict(problem.hypotheses[int(np.argmax(probabilities))])
        levels = np.zeros(n, dtype=np.intp)
        levels[joint] = level + 1
        return problem.actions.encode(moves=choice[:n], levels=levels, duration=duration)


class LearnedAgent(EpisodeAgent):
    """Plays a trained policy.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules; must be those of the training.
    policy : object
        Anything with ``predict(features, deterministic=...)``, such as a stable-baselines3
        model.
    """

    def __init__(self, problem: Problem, policy: Any, *, seed: int = 0) -> None:
        super().__init__(problem, seed=seed)
        self.form = PolicyForm(problem)
        self.tracker = Tracker(problem)
        self.policy = policy

    @classmethod
    def load(cls, problem: Problem, folder: str | Path) -> LearnedAgent:
        """Load the weights that `scripts/train.py` wrote.

        Raises
        ------
        ValueError
            If they were trained for another arm or other spaces.
        """
        from agents.network import load_network

        where = Path(folder)
        described = where / "configuration.json"
        if not described.is_file():
            raise ValueError(
                f"no trained policy for arm {problem.arm.name!r} in {where}; train one with "
                f"scripts/train.py --out {where}"
            )
        configuration = json.loads(described.read_text(encoding="utf-8"))
        form = PolicyForm(problem)
        if configuration["arm"] != problem.arm.name:
            raise ValueError(
                f"{where} was trained for arm {configuration['arm']!r}, not {problem.arm.name!r}"
            )
        return cls(problem, load_network(where, form))

    def begin(self, rng: np.random.Generator) -> Any:
        """Start from the prior."""
        return self.tracker.begin(rng)

    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Ask the policy."""
        probabilities = self.tracker.follow(observation, memory)
        features = self.form.features(observation, probabilities)
        choice, _ = self.policy.predict(features, deterministic=True)
        return self.form.action(np.asarray(choice), probabilities, memory.records)
