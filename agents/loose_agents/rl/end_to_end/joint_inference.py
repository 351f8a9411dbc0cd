"""Inference trained together with the policy that chooses the records it learns from."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from torch import nn

from loose_agents.rl.end_to_end.record_set import RecordSetExtractor
from loose_agents.rl.set_network import LOG_FLOOR, LOG_SCALE

__all__ = [
    "ConcurrentVecEnv",
    "EpisodeStore",
    "InferenceCallback",
    "PosteriorPolicy",
    "PosteriorSetExtractor",
]

_TEMPERATURE = 0.2
"""Temperature of the verdicts [reward]: how much worse one is that falls 1/e as often."""
_FIRST_VALUE = 0.2
"""Value of going on that the policy starts with [reward]; naming a probability of 0.6 has it."""
_WEIGHT_DECAY = 0.3
"""Of the posterior: every episode is seen many times before it leaves the store."""


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
    """Layers of policy and value; the policy's last layer sees the posterior beside them."""

    def __init__(self, hypotheses: int, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.hypotheses = hypotheses
        self.latent_dim_pi += hypotheses

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Latent of the policy (batch, latent_dim_pi)."""
        posterior = torch.exp(features[:, -self.hypotheses :] / LOG_SCALE)
        return torch.cat([self.policy_net(features), posterior], 1)


class PosteriorPolicy(ActorCriticPolicy):
    """Policy whose verdicts start from the posterior of a `PosteriorSetExtractor`.

    At the start the logit of a verdict is its expected reward under the posterior, over a
    temperature: the most probable verdict is Bayes' decision. Going on starts as worth trying, so
    that the first episodes are long and the posterior learns from many records, and a policy that
    cannot use a second record yet does not settle on stopping after the first. Everything after
    that is learned from rewards, so that a posterior surer than it is right is not trusted.

    Parameters
    ----------
    *args, **arguments
        Those of stable-baselines3's policy.
    verdict_rewards : sequence of sequences of float
        Reward of each verdict under each hypothesis (hypotheses + 1, hypotheses); the last verdict
        is "unsure".
    """

    features_extractor: PosteriorSetExtractor

    def __init__(
        self, *args: Any, verdict_rewards: Sequence[Sequence[float]], **arguments: Any
    ) -> None:
        self.verdict_rewards = verdict_rewards
        super().__init__(*args, **arguments)

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
        head: Any = self.action_net
        rewards = torch.tensor(self.verdict_rewards, dtype=torch.float32)
        verdicts, hypotheses = rewards.shape
        with torch.no_grad():
            # The last entry of the action: go on, the hypotheses, unsure.
            head.weight[-verdicts:] = 0.0
            head.weight[-verdicts:, -hypotheses:] = rewards / _TEMPERATURE
            head.bias[-verdicts:] = 0.0
            head.bias[-verdicts - 1] += _FIRST_VALUE / _TEMPERATURE


class EpisodeStore:
    """Last observations and truths of the latest episodes, on the device that learns from them.

    Parameters
    ----------
    size : int
        Episodes that are kept.
    elements : int
        Elements of an observation.
    device : torch.device or str
        Where they lie.
    """

    def __init__(self, size: int, elements: int, device: torch.device | str = "cpu") -> None:
        self.observations = torch.empty((size, elements), dtype=torch.float32, device=device)
        self.truths = torch.empty(size, dtype=torch.int64, device=device)
        self.count = 0

    def add(self, observations: NDArray[np.float32], truths: Sequence[int]) -> None:
        """Keep episodes (num, elements), each in place of the oldest one if the store is full."""
        size, device = len(self.truths), self.truths.device
        places = (self.count + np.arange(len(truths))) % size
        where = torch.from_numpy(places).to(device)
        self.observations[where] = torch.from_numpy(observations).to(device)
        self.truths[where] = torch.tensor(truths, dtype=torch.int64, device=device)
        self.count += len(truths)

    def sample(
        self, size: int, rng: np.random.Generator, *, start: int, slot_size: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Episodes cut after a number of records, uniform from 1 to all of theirs.

        Only the first records: which ones the policy took later depends on them.
        """
        device = self.truths.device
        places = rng.integers(min(self.count, len(self.truths)), size=size)
        chosen = torch.from_numpy(places).to(device)
        observations = self.observations[chosen]
        slots = observations[:, start:].view(size, -1, slot_size)
        order = torch.arange(1, slots.shape[1] + 1, device=device)
        last = ((slots != 0.0).any(2) * order).amax(1)
        kept = 1 + torch.floor(torch.from_numpy(rng.random(size)).to(device) * last)
        slots[order > kept[:, None]] = 0.0
        return observations, self.truths[chosen]


class ConcurrentVecEnv(VecEnvWrapper):
    """Environments that do other work in each step while the arms are simulated."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.work: Callable[[], None] | None = None
        """Called between the actions and the wait for what they bring."""

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Do the other work, then wait for the step."""
        if self.work is not None:
            self.work()
        return self.venv.step_wait()


class InferenceCallback(BaseCallback):
    """Trains the posterior of a `PosteriorSetExtractor` while the arms of a rollout are simulated.

    What learns is a copy; the policy takes its weights over before each rollout, so that it acts
    and is updated on the same features.

    Parameters
    ----------
    env : ConcurrentVecEnv
        The environments.
    hypotheses : sequence of str
        Names of the hypotheses, in the posterior's order.
    rate : callable
        Learning rate, given the share of the budget that is left.
    seed : int
        Seed of the episodes that are drawn.
    batches : int
        Gradient steps a rollout, of as many episodes as a minibatch of the policy's update has
        steps.
    rollouts : int
        The episodes that are kept are as many as so many rollouts have steps.
    """

    model: Any

    def __init__(
        self,
        env: ConcurrentVecEnv,
        hypotheses: Sequence[str],
        *,
        rate: Callable[[float], float],
        seed: int,
        batches: int = 24,
        rollouts: int = 20,
    ) -> None:
        super().__init__()
        self.env, self.names = env, {name: k for k, name in enumerate(hypotheses)}
        self.rate, self.rng = rate, np.random.default_rng(seed)
        self.batches, self.rollouts = batches, rollouts

    def _on_training_start(self) -> None:
        self.network = self.model.policy.features_extractor
        self.learning = copy.deepcopy(self.network)
        elements = int(np.prod(self.model.observation_space.shape))
        steps = self.model.n_steps * self.model.n_envs
        self.store = EpisodeStore(self.rollouts * steps, elements, self.model.device)
        own = [*self.learning.embedding.parameters(), *self.learning.posterior.parameters()]
        self.optimiser = torch.optim.AdamW(own, lr=1e-3, weight_decay=_WEIGHT_DECAY)
        self.env.work = self._learn

    def _on_step(self) -> bool:
        # What fits no hypothesis teaches none.
        known = [
            (info["terminal_observation"], self.names[info["fault"]])
            for info in self.locals["infos"]
            if info.get("fault") in self.names
        ]
        if known:
            observations, truths = zip(*known, strict=True)
            self.store.add(np.stack(observations), truths)
        return True

    def _on_rollout_start(self) -> None:
        self.network.load_state_dict(self.learning.state_dict())
        self.steps = 0

    def _on_training_end(self) -> None:
        self.network.load_state_dict(self.learning.state_dict())
        self.env.work = None

    def _learn(self) -> None:
        """Take this step's share of the rollout's gradient steps."""
        before, self.steps = self.steps, self.steps + 1
        size, share = self.model.batch_size, self.batches / self.model.n_steps
        if self.store.count < size:
            return
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate(self.model._current_progress_remaining)
        for _ in range(int(self.steps * share) - int(before * share)):
            observations, truths = self.store.sample(
                size, self.rng, start=self.network.start, slot_size=self.network.slot_size
            )
            loss = self.learning.loss(observations, truths)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
