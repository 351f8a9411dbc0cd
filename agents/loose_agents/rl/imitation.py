"""Imitation of a planner before the training by reward: its choices, and what they returned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from loose_agents.belief import BeliefAgent
from loose_agents.rl.training_env import TrackedVecEnv

WANDERING = 0.2
"""Share of records at random [1]: the learner will come where the planner itself does not."""
EPOCHS, BATCH, RATE, DECAY = 60, 256, 1e-3, 0.03
"""Passes over the data, states of a step, rate of learning, decay of weights [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstration:
    """States of M steps, what the planner chose in them, and what was returned from there on."""

    seen: Tensor
    """Observations (M, features)."""
    masks: Tensor
    """Options that were allowed (M, options)."""
    choices: Tensor
    """The planner's choices (M, entries), the last one whether to stop."""
    returns: Tensor
    """Rewards from there to the end of the episode (M,); NaN where it has not ended."""


def demonstrate(
    vec: TrackedVecEnv, planner: BeliefAgent, steps: int, rng: np.random.Generator,
    show: Callable[[int, str], None],
) -> Demonstration:  # fmt: skip
    """Let a planner play a batch for a number of steps of every arm."""
    seen, columns = vec.reset(), []
    for step in range(steps):
        masks = vec.action_masks()
        chosen = np.stack(planner.decide_all(vec.situations(rng)))
        chosen[:, -1] = chosen[:, -1] > 0  # any verdict is a stop
        taken = chosen.copy()
        for i in np.flatnonzero((rng.random(vec.num_envs) < WANDERING) & (chosen[:, -1] == 0)):
            options = np.split(masks[i], np.cumsum(vec.form.nvec)[:-1])[:-1]
            taken[i, :-1] = [rng.choice(np.flatnonzero(own)) for own in options]
        before = seen
        seen, rewards, over, _ = vec.step(taken)
        columns.append((before, masks, chosen, rewards, over))
        show((step + 1) * vec.num_envs, "steps of the planner")
    observed, allowed, choices, rewards, over = (np.array(c) for c in zip(*columns, strict=True))
    returns, after = np.zeros(rewards.shape), np.full(vec.num_envs, np.nan)
    for step in reversed(range(steps)):
        after = returns[step] = rewards[step] + np.where(over[step], 0.0, after)
    flat = [torch.as_tensor(np.concatenate(list(x))) for x in (observed, allowed, choices, returns)]
    return Demonstration(seen=flat[0], masks=flat[1], choices=flat[2], returns=flat[3])


def imitate(model: Any, shown: Demonstration, rng: np.random.Generator) -> None:
    """Fit the actor of a stable-baselines3 policy to choices, and its critic to returns.

    What is measured after a stop does not matter: there only the stop is imitated.
    """
    policy, entries = model.policy, model.action_space.nvec.tolist()
    ended, measures = ~shown.returns.isnan(), shown.choices[:, -1] == 0
    optimiser = torch.optim.AdamW(policy.parameters(), RATE, weight_decay=DECAY)
    steps = EPOCHS * len(measures) // BATCH
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    for _ in range(steps):
        some = torch.as_tensor(rng.integers(len(measures), size=BATCH))
        latent, valued = policy.mlp_extractor(policy.extract_features(shown.seen[some]))
        logits = policy.action_net(latent).masked_fill(~shown.masks[some], -1e8).split(entries, 1)
        misses = torch.stack(
            [
                nn.functional.cross_entropy(own, chosen, reduction="none")
                for own, chosen in zip(logits, shown.choices[some].T, strict=True)
            ]
        )
        told = shown.returns[some].nan_to_num().float()
        value = (policy.value_net(valued)[:, 0] - told).square()[ended[some]].mean()
        loss = misses[-1].mean() + (misses[:-1].sum(0) * measures[some]).mean() + 0.5 * value
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
