"""Posterior over the faults by neural ratio estimation, with the library `sbi`.

What a general library for simulation-based inference gives: a network tells records of a fault from
records of any fault, which makes its output the likelihood ratio (B. K. Miller, C. Weniger and
P. Forré, Contrastive Neural Ratio Estimation, NeurIPS 2022; NRE-B of C. Durkan, I. Murray and
G. Papamakarios, ICML 2020). It sees the observation alone, knows nothing of mechanics, and weighs
all records of an episode at once, in any order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import PROBABILITY_FLOOR, Problem, hypothesis_prior
from loose_env.diagnosis import read_network
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidData, MissingExtra
from loose_env.typing import Array

__all__ = ["FORMAT", "RatioPosterior", "RatioSettings", "hypothesis_codes", "ratio_network"]


FORMAT = "loose-ratio/1"
"""Format of trained networks."""


@dataclass(frozen=True, kw_only=True)
class RatioSettings:
    """Size of the network."""

    hidden: int = 128
    """Hidden units of each layer."""
    features: int = 64
    """Features of a record, summed over the records."""


def hypothesis_codes(count: int) -> NDArray[np.float32]:
    """Parameter of the simulator for each hypothesis: one of as many axes (count, count)."""
    return np.eye(count, dtype=np.float32)


def ratio_network(problem: Problem, settings: RatioSettings) -> Any:
    """Build sbi's classifier for a problem: records in any order, and a hypothesis.

    Raises
    ------
    MissingExtra
        Without the package `sbi`.
    """
    try:
        from sbi.neural_nets import classifier_nn
        from sbi.neural_nets.embedding_nets import FCEmbedding, PermutationInvariantEmbedding
    except ImportError as error:
        raise MissingExtra(
            "neural ratio estimation needs the package sbi; install it with: "
            "pip install -e '.[sbi]'"
        ) from error
    import torch

    slots, elements = problem.layout.slots, len(problem.layout.slot_elements)
    of_record = FCEmbedding(
        elements, output_dim=settings.features, num_layers=2, num_hiddens=settings.hidden
    )
    # a record that was not taken is zero and adds a constant: no gaps that need counting
    of_records = PermutationInvariantEmbedding(
        of_record,
        settings.features,
        aggregation_fn="sum",
        num_hiddens=settings.hidden,
        output_dim=settings.features,
    )
    build = classifier_nn(
        "resnet",
        z_score_theta="none",
        z_score_x="none",
        hidden_features=settings.hidden,
        embedding_net_x=of_records,
    )
    count = len(problem.hypotheses)
    return build(torch.zeros(2, count), torch.zeros(2, slots, elements))


class RatioPosterior:
    """Estimator: probabilities of the hypotheses from likelihood ratios and the prior.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules that it was trained for.
    network : sbi.neural_nets.ratio_estimators.RatioEstimator
        The trained classifier.
    """

    def __init__(self, problem: Problem, network: Any) -> None:
        import torch

        self.problem, self._network = problem, network.eval()
        difficulty = difficulty_named(problem.settings.difficulty)
        shares = difficulty.probabilities(problem.settings.kinds)
        prior = hypothesis_prior(problem.hypotheses, shares)
        self._log_prior = np.log(np.maximum(prior, PROBABILITY_FLOOR))
        self._codes = torch.from_numpy(hypothesis_codes(len(problem.hypotheses)))

    @classmethod
    def load(cls, folder: Path, problem: Problem) -> RatioPosterior:
        """Read a trained network.

        Raises
        ------
        InvalidData
            If there is none, it cannot be read, or it was trained for another problem.
        MissingExtra
            Without the package `sbi`.
        """
        import torch

        configuration, tensors = read_network(
            folder,
            format=FORMAT,
            needs=("fingerprint", "network"),
            trainer="scripts/agents/train_ratio.py",
        )
        if configuration["fingerprint"] != problem.fingerprint:
            raise InvalidData(
                f"the network in {folder} was trained for other observations or hypotheses than "
                f"those of arm {problem.arm.name!r} here; train one with "
                "scripts/agents/train_ratio.py"
            )
        if not all(np.isfinite(values).all() for values in tensors.values()):
            raise InvalidData(
                f"the network in {folder} holds numbers that are not finite; train it again with "
                "scripts/agents/train_ratio.py"
            )
        network = ratio_network(problem, _settings_of(configuration, folder))
        try:
            network.load_state_dict({name: torch.from_numpy(v) for name, v in tensors.items()})
        except RuntimeError as error:
            raise InvalidData(
                f"the network in {folder} has other layers than its configuration says; train it "
                "again with scripts/agents/train_ratio.py"
            ) from error
        return cls(problem, network)

    def begin(self) -> None:
        """Return the initial state of an episode: none is kept."""

    def follow(self, observation: NDArray[np.float32], memory: None) -> Array:
        """Probabilities of the hypotheses from all records of an observation (hypotheses,)."""
        return np.asarray(self.probabilities(self.problem.layout.slots_of(observation)[None])[0])

    def probabilities(self, slots: NDArray[np.float32]) -> Array:
        """Probabilities for several episodes (E, hypotheses).

        Parameters
        ----------
        slots : ndarray (E, records, elements)
            Records of each episode, zero where none was taken.
        """
        import torch

        count, episodes = len(self._codes), len(slots)
        with torch.no_grad():
            ratios = self._network(
                self._codes.repeat(episodes, 1),
                torch.from_numpy(np.repeat(slots, count, axis=0).astype(np.float32)),
            )
        log = ratios.numpy().astype(float).reshape(episodes, count) + self._log_prior
        weights = np.exp(log - log.max(axis=1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _settings_of(configuration: Mapping[str, Any], folder: Path) -> RatioSettings:
    """Size of the network of a configuration."""
    given = configuration["network"]
    names: Sequence[str] = tuple(vars(RatioSettings()))
    if not isinstance(given, dict) or not all(
        type(given.get(name)) is int and 0 < given[name] <= 4096 for name in names
    ):
        raise InvalidData(
            f"the configuration of the network in {folder} does not say {', '.join(names)}; train "
            "it again with scripts/agents/train_ratio.py"
        )
    return RatioSettings(**{name: given[name] for name in names})
