"""Plays episodes of loose_env/Gap-v0, and keeps the belief after every motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from loose_agents.base import EpisodeAgent
from loose_agents.policies.model_gap import make_gap_agent

from loose_env.envs import ModelGapEnv
from loose_env.registration import GAP_ID

__all__ = ["COUNTS", "EVALUATION_SEED", "TUNING_SEED", "agent_of", "made", "played"]

EVALUATION_SEED, TUNING_SEED = 20_261_126, 20_081_000
"""Seeds of the judging episodes and of those on which stopping is tuned."""
COUNTS = (1, 2, 1, 0, 1, 2, 1, 2, 1, 0)
"""Hidden effects of the episodes, in turn."""
_CERTAIN = 0.9999
"""Probability of a set after which an episode's belief is taken not to change: evidence grows with
every motion."""
_CERTAIN_MOTIONS = 2


@dataclass(frozen=True, kw_only=True)
class Step:
    """State of the belief after a motion."""

    motion: int
    seconds: float
    wear: float
    right: bool
    probability: float
    parameter_error: float
    covered: float
    worth: float


def made(model: str | Path | None = None, **settings: Any) -> ModelGapEnv:
    """Make the environment of an arm, with fields of its settings."""
    env = gymnasium.make(GAP_ID, model=model, **settings)
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, ModelGapEnv)
    return unwrapped


def agent_of(env: ModelGapEnv, name: str, number: int, weights: Path | None) -> EpisodeAgent:
    """Make an agent that does not stop, but for ``ppo``, which has the weights and stops itself.

    Parameters
    ----------
    env : ModelGapEnv
        The environment.
    name : str
        Name of the agent.
    number : int
        Number of the episode: seed of what it draws.
    weights : Path, optional
        Weights of ``ppo``.
    """
    if name != "ppo":
        return make_gap_agent(name, env, sure=2.0, seed=number)
    from loose_agents.rl.motion_policy import LearnedGapAgent  # torch where it is used

    assert weights is not None
    return LearnedGapAgent(weights, env)


def played(
    env: ModelGapEnv, agent: Any, *, seed: int, number: int, names: tuple[str, ...] = (),
    most: int = 12,
) -> dict[str, Any]:  # fmt: skip
    """Play one episode, and keep the belief after every motion.

    The agent is one that never stops: when it would have is read off the probabilities.

    Parameters
    ----------
    env : ModelGapEnv
        The environment.
    agent : object
        An agent with ``predict``.
    seed : int
        Seed of the episodes: it and the number make the machine, whatever the agent.
    number : int
        Number of the episode; `COUNTS` says how many effects it has.
    names : tuple of str
        Hidden effects instead.
    most : int
        Motions.
    """
    options = {"names": names} if names else {"count": COUNTS[number % len(COUNTS)]}
    observation, info = env.reset(seed=int(seed + 1000 * number), options=options)
    assert env.machine is not None
    truth, certain = env.machine.names, 0
    steps: list[Step] = []
    state, start = None, True
    while len(steps) < most and certain < _CERTAIN_MOTIONS:
        action, state = agent.predict(observation, state, np.array([start]))
        start = False
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
        best = env.belief.posterior.best
        certain = certain + 1 if best.probability > _CERTAIN else 0
        hidden = {e.name: e.value for e in env.machine.effects}
        inside = [e.low <= hidden[e.name] <= e.high for e in best.effects if e.name in hidden]
        steps.append(
            Step(
                motion=int(action),
                seconds=float(info["seconds"]),
                wear=float(info["wear"]),
                right=best.names == truth,
                probability=best.probability,
                parameter_error=env.parameter_error(best),
                worth=float(np.max(observation[env.layout.gain] - env.motion_prices)),
                covered=float(np.mean(inside)) if inside else float("nan"),
            )
        )
    named = env.belief.posterior.best.names if steps else ()
    return {
        "episode": number,
        "effects": len(truth),
        "truth": " + ".join(truth),
        "named": " + ".join(named),
        "failure": info.get("failure", ""),
        "motion": [s.motion for s in steps],
        "seconds": [s.seconds for s in steps],
        "wear": [s.wear for s in steps],
        "right": [int(s.right) for s in steps],
        "probability": [s.probability for s in steps],
        "worth": [s.worth for s in steps],
        "parameter_error": [s.parameter_error for s in steps],
        "covered": [-1.0 if np.isnan(s.covered) else s.covered for s in steps],
    }
