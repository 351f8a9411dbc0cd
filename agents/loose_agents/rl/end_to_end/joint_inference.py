"""Inference trained together with the policy that chooses the records it learns from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import nn

from loose_agents.rl.end_to_end.record_set import RecordSetExtractor
from loose_agents.rl.set_network import LOG_FLOOR, LOG_SCALE

__all__ = ["EpisodeStore", "InferenceCallback", "PosteriorPolicy", "PosteriorSetExtractor"]

_VERDICT_POWER = 2.0
"""Power of the posterior in the odds of naming a hypothesis, at the start."""
_UNSURE_BIAS = -2.0
"""Logit of "unsure" at the start."""


class PosteriorSetExtractor(RecordSetExtractor):
    """Set network with a posterior over the hypotheses, which is trained on the truth.

    The policy sees the log-posterior, the sum over the records, and the global elements. Its
    gradient ends there: embedding and posterior learn by `InferenceCallback` alone, from every
    record of the training, whatever came of the verdict.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        Flat observation.
    hypotheses : int
        Number of hypotheses.
    **arguments
        Those of `RecordSetExtractor`.
    """

    def __init__(self, observation_space: spaces.Box, *, hypotheses: int, **arguments: Any) -> None:
        super().__init__(observation_space, **arguments)
        width = self.width
        self.posterior = nn.Sequential(
            nn.Linear(width, width), nn.ReLU(), nn.Linear(width, hypotheses)
        )
        self.hypotheses = hypotheses
        self._features_dim += hypotheses

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (batch, features_dim) of observations (batch, elements)."""
        with torch.no_grad():
            seen = super().forward(observations)
            logs = torch.log_softmax(self.posterior(seen[:, self.start :]), 1)
            return torch.cat([seen, logs.clamp(min=LOG_FLOOR) * LOG_SCALE], 1)

    def loss(self, observations: torch.Tensor, truths: torch.Tensor) -> torch.Tensor:
        """Mean negative log-posterior of the truths (batch,) [nat]."""
        seen = super().forward(observations)[:, self.start :]
        return nn.functional.cross_entropy(self.posterior(seen), truths)


class _WithPosterior(MlpExtractor):
    """Layers of policy and value; the policy's last layer sees the log-posterior beside them."""

    def __init__(self, hypotheses: int, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.hypotheses = hypotheses
        self.latent_dim_pi += hypotheses

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Latent of the policy (batch, latent_dim_pi)."""
        return torch.cat([self.policy_net(features), features[:, -self.hypotheses :]], 1)


class PosteriorPolicy(ActorCriticPolicy):
    """Policy whose verdicts start from the posterior of a `PosteriorSetExtractor`.

    At the start, the odds of naming hypothesis h against going on are p_h squared: the verdict is
    mostly the most probable one, and the surer the posterior, the sooner it falls. Everything after
    that is learned.
    """

    features_extractor: PosteriorSetExtractor

    def _build_mlp_extractor(self) -> None:
        hypotheses = self.features_extractor.hypotheses
        self.mlp_extractor = _WithPosterior(
            hypotheses,
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        hypotheses = self.features_extractor.hypotheses
        head: Any = self.action_net
        with torch.no_grad():
            # The last entry of the action: go on, the hypotheses, unsure.
            named = head.weight[-1 - hypotheses : -1, -hypotheses:]
            named += _VERDICT_POWER / LOG_SCALE * torch.eye(hypotheses, device=named.device)
            head.bias[-1] += _UNSURE_BIAS


class EpisodeStore:
    """Last observations and truths of the latest episodes.

    Parameters
    ----------
    size : int
        Episodes that are kept.
    elements : int
        Elements of an observation.
    """

    def __init__(self, size: int, elements: int) -> None:
        self.observations = np.zeros((size, elements), dtype=np.float32)
        self.truths = np.zeros(size, dtype=np.int64)
        self.count = 0

    def add(self, observation: NDArray[np.float32], truth: int) -> None:
        """Keep an episode, in place of the oldest one if the store is full."""
        place = self.count % len(self.truths)
        self.observations[place], self.truths[place] = observation, truth
        self.count += 1

    def sample(
        self, size: int, rng: np.random.Generator, *, start: int, slot_size: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Episodes cut after a number of records, uniform from 1 to all of theirs.

        Only the first records: which ones the policy took later depends on them.
        """
        chosen = rng.integers(min(self.count, len(self.truths)), size=size)
        observations = self.observations[chosen]
        slots = observations[:, start:].reshape(size, -1, slot_size)  # a view
        taken = (slots != 0.0).any(2)
        last = np.where(taken.any(1), slots.shape[1] - np.argmax(taken[:, ::-1], 1), 0)
        kept = 1 + np.floor(rng.random(size) * last)
        slots[np.arange(slots.shape[1]) >= kept[:, None]] = 0.0
        return observations, self.truths[chosen]


class InferenceCallback(BaseCallback):
    """Trains the posterior of a `PosteriorSetExtractor` between the updates of the policy.

    Parameters
    ----------
    hypotheses : sequence of str
        Names of the hypotheses, in the posterior's order.
    rate : callable
        Learning rate, given the share of the budget that is left.
    seed : int
        Of the drawn batches.
    episodes : int
        Episodes that are kept to learn from.
    batches, batch_size : int
        Gradient steps after each rollout, and episodes of each.
    """

    model: Any

    def __init__(
        self,
        hypotheses: Sequence[str],
        *,
        rate: Callable[[float], float],
        seed: int,
        episodes: int = 20_000,
        batches: int = 48,
        batch_size: int = 256,
    ) -> None:
        super().__init__()
        self.names = {name: k for k, name in enumerate(hypotheses)}
        self.rate, self.rng = rate, np.random.default_rng(seed)
        self.episodes, self.batches, self.batch_size = episodes, batches, batch_size

    def _on_training_start(self) -> None:
        self.network = self.model.policy.features_extractor
        size = int(np.prod(self.model.observation_space.shape))
        self.store = EpisodeStore(self.episodes, size)
        own = [*self.network.embedding.parameters(), *self.network.posterior.parameters()]
        self.optimiser = torch.optim.Adam(own, lr=1e-3)

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"], strict=True):
            # What fits no hypothesis teaches none.
            if done and info["fault"] in self.names:
                self.store.add(info["terminal_observation"], self.names[info["fault"]])
        return True

    def _on_rollout_start(self) -> None:
        if self.store.count < self.batch_size:
            return
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate(self.model._current_progress_remaining)
        for _ in range(self.batches):
            observations, truths = self.store.sample(
                self.batch_size,
                self.rng,
                start=self.network.start,
                slot_size=self.network.slot_size,
            )
            loss = self.network.loss(
                torch.as_tensor(observations, device=self.model.device),
                torch.as_tensor(truths, device=self.model.device),
            )
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
