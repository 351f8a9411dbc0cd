"""Agents from model files of stable-baselines3, read without executing code."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import EpisodeAgent, Problem
from loose_agents.core.belief_agent import records_taken
from loose_agents.core.estimators import feature_size, make_estimator
from loose_agents.rl.checkpoint import (
    TRAINED_ON,
    StoredModel,
    network_arguments,
    read_model,
)
from loose_agents.rl.learned_policy import CONFIGURATION, LearnedAgent, PolicyForm
from loose_agents.rl.network import PolicyNetwork, network_from_tensors
from loose_agents.rl.set_network import SetNetwork, is_set_network, set_network
from loose_env.errors import InvalidData

__all__ = ["ModelAgent", "model_agent"]


@dataclass
class _Memory:
    """State of one episode: that of the network."""

    state: Any


class ModelAgent(EpisodeAgent):
    """Plays a policy trained on the environment's own observation and action.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules; must be those of the training.
    network : PolicyNetwork
        The policy.
    """

    def __init__(
        self, problem: Problem, network: PolicyNetwork | SetNetwork, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        self.network = network

    def begin(self, rng: np.random.Generator) -> Any:
        """Start from the network's own beginning."""
        return _Memory(state=self.network.begin())

    def act(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.int64]:
        """Evaluate the policy."""
        problem = self.problem
        measured = int(np.count_nonzero(problem.layout.slots_of(observation)[:, 0]))
        mask = problem.actions.mask(
            problem.layout.pose_of(observation), records_taken(problem, observation), measured
        )
        choice, memory.state = self.network.choose(observation, memory.state, mask)
        return choice


def model_agent(path: str | Path, problem: Problem, *, seed: int = 0) -> EpisodeAgent:
    """Make an agent of a model file: of the rl-zoo, of one's own training, or of train.py.

    What it was trained on shows in the size of its input: the environment's observation, or that
    of `PolicyForm` on a posterior. Which posterior says ``configuration.json`` beside the file.
    The arm is told by the file itself where this package trained it, else by the file beside it;
    of a model that has neither only the sizes are checked.

    Parameters
    ----------
    path : str or Path
        A ``.zip`` of PPO, RecurrentPPO or MaskablePPO.
    problem : Problem
        The nominal arm and the rules; must be those of the training.

    Raises
    ------
    InvalidData
        If it is no such model, or was trained on something else.
    """
    stored = read_model(path)
    _require_same_problem(stored, problem)
    state = {name: value.numpy() for name, value in stored.parameters["policy"].items()}
    layout, actions = problem.layout, problem.actions
    if is_set_network(state):
        return ModelAgent(problem, _set_network(stored, state, problem), seed=seed)
    seen = _input(stored, state)
    # The layers of a policy without memory see the observation itself.
    if seen == layout.size:
        return ModelAgent(problem, _network(stored, state, actions.nvec), seed=seed)
    estimator = make_estimator(str(_beside(stored).get("estimator", "posterior")), problem)
    form = PolicyForm(problem, feature_size(estimator))
    sees = form.observation_space.shape[0]
    if seen != sees:
        raise InvalidData(
            f"{path} sees {seen} numbers; the observation of arm {problem.arm.name!r} has "
            f"{layout.size}, and that on a posterior {sees}: it was trained on another arm, other "
            "settings or through a wrapper"
        )
    return LearnedAgent(problem, _network(stored, state, form.nvec), estimator, seed=seed)


def _input(stored: StoredModel, state: dict[str, NDArray[Any]]) -> int:
    """Number of inputs of a policy."""
    for name in ("lstm_actor.weight_ih_l0", "mlp_extractor.policy_net.0.weight"):
        if name in state and state[name].ndim == 2:
            return int(state[name].shape[1])
    raise InvalidData(f"{stored.path}: only MlpPolicy and MlpLstmPolicy are read")


def _set_network(
    stored: StoredModel, state: dict[str, NDArray[Any]], problem: Problem
) -> SetNetwork:
    given = stored.described.get("policy_kwargs")
    plain = given if isinstance(given, dict) else {}
    # Both are in the tensors: the extractor's layers, and the rewards of the verdicts.
    inside = ("features_extractor", "verdict_rewards")
    described = {k: v for k, v in plain.items() if not k.startswith(inside)}
    rest = replace(stored, described={**stored.described, "policy_kwargs": described})
    activation, masked = _kind(rest)
    nvec = problem.actions.nvec
    try:
        network = set_network(state, problem.layout, nvec, activation=activation, masked=masked)
        # What does not fit together fails here, not in an episode.
        network.choose(np.zeros(problem.layout.size, dtype=np.float32), network.begin())
        if network.head.layers[-1].weight.shape[0] != nvec.sum():
            raise ValueError(f"the problem has {nvec.sum()} options")
    except (KeyError, IndexError, ValueError) as error:
        raise InvalidData(
            f"{stored.path} holds no set network for arm {problem.arm.name!r}: "
            f"{type(error).__name__}: {error!s:.200}"
        ) from error
    return network


def _kind(stored: StoredModel) -> tuple[str, bool]:
    """Activation, and whether the policy was trained with masks."""
    activation = network_arguments(stored).get("activation_fn")
    kind = stored.described.get("policy_class")
    module = kind.get("__module__", "") if isinstance(kind, dict) else ""
    return "tanh" if activation is None else activation.__name__.lower(), "maskable" in str(module)


def _network(
    stored: StoredModel, state: dict[str, NDArray[Any]], nvec: NDArray[np.int64]
) -> PolicyNetwork:
    activation, masked = _kind(stored)
    try:
        network = network_from_tensors(state, nvec, activation=activation, masked=masked)
        options = network.layers[-1].weight.shape[0]
        if options != nvec.sum():
            raise ValueError(f"it has {options} options, the problem {nvec.sum()}")
    except (KeyError, IndexError, ValueError) as error:
        raise InvalidData(
            f"{stored.path} holds no policy of this kind: {type(error).__name__}: {error!s:.200}"
        ) from error
    return network


def _require_same_problem(stored: StoredModel, problem: Problem) -> None:
    """Refuse a model of another arm or other spaces, whose sizes may be the same."""
    trained_on = stored.described.get(TRAINED_ON, problem.fingerprint)
    arm = _beside(stored).get("arm", problem.arm.name)
    if trained_on != problem.fingerprint or arm != problem.arm.name:
        raise InvalidData(
            f"{stored.path} was trained on {arm!r:.60}, fingerprint {trained_on!r:.20}, not on arm "
            f"{problem.arm.name!r} under these rules, fingerprint {problem.fingerprint!r}; play it "
            "with the environment and the arguments of its training"
        )


def _beside(stored: StoredModel) -> dict[str, Any]:
    """Configuration of the run that a model file lies in; empty where there is none."""
    try:
        found = json.loads((stored.path.parent / CONFIGURATION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
