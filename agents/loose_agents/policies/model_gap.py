"""Agents for loose_env/Gap-v0: random motions, fixed batteries, greedy by expected reward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent
from loose_env.envs import GapObservation, ModelGapEnv
from loose_env.errors import UnknownName
from loose_env.typing import Array

GAP_AGENTS = ("random", "battery", "brief", "greedy")
"""Names of the agents."""
STOPPING = {"random": 0.6, "battery": 0.8, "brief": 0.8, "greedy": 0.8, "ppo": 2.0}
"""Probability of the best set from which each agent names it; scripts/model_gap/evaluate.py finds
the best one on development episodes. Above 1: it stops by itself."""
_REPEATS = 2
"""Times that greedy takes a motion: a repetition does not average out the linearisation error."""
SETUP_S = 0.5
"""Time to set up a motion [s], so that motions of almost no length are not preferred."""
NAT = 1e-3
"""Reward that a nat of information counts as: it decides where no motion changes the verdict."""
_BRIEF = ("slow_triangle", "multisine", "steps")
"""Kinds of the battery in its brief form."""


@dataclass(eq=False)
class _Memory:
    """State of an episode."""

    rng: np.random.Generator
    taken: int = 0


class GapAgent(EpisodeAgent):
    """Agent that takes motions by a rule and names the most probable set once it is sure enough."""

    def __init__(
        self, rule: str, layout: GapObservation, seconds: Array, order: Sequence[int], *,
        sure: float, most: int, seed: int = 0, prices: Array | None = None,
    ) -> None:  # fmt: skip
        if rule not in GAP_AGENTS:
            raise UnknownName(f"an agent of Gap-v0 is one of {list(GAP_AGENTS)}, got {rule!r}")
        self.rule, self.layout, self.seconds = rule, layout, seconds
        self.order, self.sure, self.most, self.seed = tuple(order), sure, most, seed
        self.prices = np.zeros(len(seconds)) if prices is None else prices

    def begin(self, rng: np.random.Generator) -> _Memory:
        """Return the initial state of an episode."""
        return _Memory(rng)

    def act(self, observation: NDArray[np.float32], memory: Any) -> Any:
        """Choose a motion, or name the most probable set."""
        best = 10.0 ** float(observation[self.layout.sets][0])
        worth = float(np.max(observation[self.layout.gain] - self.prices))
        enough = best >= self.sure or (self.rule == "greedy" and worth <= 0 and self.sure <= 1)
        if memory.taken and (enough or memory.taken >= self.most):
            return np.int64(self.layout.motions)
        memory.taken += 1
        return np.int64(self._motion(observation, memory))

    def _motion(self, observation: NDArray[np.float32], memory: _Memory) -> int:
        if self.rule in ("battery", "brief"):
            return self.order[(memory.taken - 1) % len(self.order)]
        if self.rule == "random":
            return int(memory.rng.integers(self.layout.motions))
        if not memory.taken - 1:  # no verdict to gain from yet
            worth = observation[self.layout.information]
        else:
            worth = observation[self.layout.gain] + NAT * observation[self.layout.information]
        rate = worth / (self.seconds + SETUP_S)
        fresh = observation[self.layout.taken] < _REPEATS
        return int(np.argmax(np.where(fresh, rate, rate - 1e3)))


def make_gap_agent(
    name: str, env: ModelGapEnv, *, sure: float | None = None, seed: int = 0
) -> GapAgent:
    """Make an agent for an environment."""
    order = _briefest(env) if name == "brief" else env.bank.reference
    return GapAgent(
        name, env.layout, env.bank.seconds, order,
        sure=STOPPING.get(name, 0.9) if sure is None else sure,
        most=env.settings.max_motions, seed=seed, prices=env.motion_prices,
    )  # fmt: skip


def _briefest(env: ModelGapEnv) -> list[int]:
    """The shortest motion of all joints of each kind in the battery."""
    every, found = len(env.bank.arm.joints), []
    for kind in _BRIEF:
        own = [k for k, m in enumerate(env.motions) if m.kind == kind and len(m.joints) == every]
        found.append(min(own, key=lambda k: float(env.bank.seconds[k])))
    return found
