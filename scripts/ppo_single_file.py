"""PPO in one file, against Gymnasium's API alone: a wrapped environment in, a learning curve out.

Usage: python scripts/ppo_single_file.py --env loose_env/Vera-v0 --wrapper MacroActions
--steps 20000

It knows nothing of this package but its wrappers, so that it shows what any library needs: vector
environments that reset in the next step, and masks of allowed choices in ``info["action_mask"]``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from loose_agents.evaluation import arguments_of
from loose_agents.execution.command import command, option
from torch import nn

import loose_env.wrappers
from loose_env.errors import UnknownName
from loose_env.io import Checked, Count, NonNegativeCount

OBSERVATIONS = ("PosteriorObservation", "LatestRecord", "MeasuredMinusNominal")
ACTIONS = ("MacroActions", "SeparateVerdict")


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    """Options of the training."""

    env: str = option("loose_env/Vera-v0", "environment id")
    arguments: str = option('{"engine": "reduced"}', "its arguments, as JSON")
    wrapper: tuple[str, ...] = option((), f"of {[*OBSERVATIONS, *ACTIONS]}, innermost first")
    steps: Count = option(20_000, "steps in all")
    num_envs: Count = option(16, "environments side by side")
    length: Count = option(32, "steps of each environment between updates")
    seed: NonNegativeCount = option(1, "seed of episodes and network")


class Network(nn.Module):
    """Policy over one or several discrete choices, and value."""

    def __init__(self, observations: int, choices: Sequence[int]) -> None:
        super().__init__()
        self.choices = list(choices)

        def body(last: int, gain: float) -> nn.Sequential:
            layers = [nn.Linear(observations, 64), nn.Linear(64, 64), nn.Linear(64, last)]
            for layer, size in zip(layers, (np.sqrt(2), np.sqrt(2), gain), strict=True):
                nn.init.orthogonal_(layer.weight, size)
                nn.init.zeros_(layer.bias)
            return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])

        self.policy, self.critic = body(sum(self.choices), 0.01), body(1, 1.0)

    def distributions(self, seen: torch.Tensor, mask: torch.Tensor) -> list[Any]:
        """One categorical distribution for each entry of the action."""
        logits = self.policy(seen).masked_fill(~mask, -1e8)
        return [
            torch.distributions.Categorical(logits=part)
            for part in torch.split(logits, self.choices, dim=-1)
        ]

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """Expected return."""
        found: torch.Tensor = self.critic(seen)[:, 0]
        return found


def log_probability(parts: Sequence[Any], action: torch.Tensor) -> torch.Tensor:
    """Log-probability of actions whose entries are independent."""
    return torch.stack([d.log_prob(a) for d, a in zip(parts, action.T, strict=True)]).sum(0)


def make(options: Options) -> Any:
    """Build the wrapped environments, with Gymnasium's own means."""
    known = {name: getattr(loose_env.wrappers, name) for name in (*OBSERVATIONS, *ACTIONS)}
    for name in options.wrapper:
        if name not in known:
            raise UnknownName(f"there is no wrapper {name!r} here; known are {list(known)}")
    envs = gymnasium.make_vec(
        options.env,
        num_envs=options.num_envs,
        vectorization_mode="sync",
        wrappers=[known[name] for name in options.wrapper],
        **arguments_of(options.arguments),
    )
    return gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)


def train(options: Options) -> list[float]:
    """Train; return the return of every episode."""
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    envs = make(options)
    space = envs.single_action_space
    single = isinstance(space, gymnasium.spaces.Discrete)
    choices = [int(space.n)] if single else space.nvec.tolist()
    network = Network(envs.single_observation_space.shape[0], choices)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3, eps=1e-5)
    shape = (options.length, options.num_envs)
    seen = torch.zeros(*shape, envs.single_observation_space.shape[0])
    masks = torch.zeros(*shape, sum(choices), dtype=torch.bool)
    actions = torch.zeros(*shape, len(choices), dtype=torch.long)
    logs, rewards, values, ends, fresh = (torch.zeros(shape) for _ in range(5))
    observation, infos = envs.reset(seed=loose_env.envs.batch_seeds(options.seed, shape[1]))
    over = np.zeros(shape[1], dtype=bool)
    returns: list[float] = []
    updates = max(1, options.steps // (shape[0] * shape[1]))
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = 1e-3 * (1 - update / updates)
        for t in range(options.length):
            seen[t] = torch.as_tensor(observation)
            masks[t] = torch.as_tensor(infos["action_mask"])
            with torch.no_grad():
                parts = network.distributions(seen[t], masks[t])
                actions[t] = torch.stack([d.sample() for d in parts], dim=1)
                logs[t] = log_probability(parts, actions[t])
                values[t] = network.value(seen[t])
            chosen = actions[t].numpy()
            fresh[t] = torch.as_tensor(over)  # this step only resets: nothing is learned from it
            observation, reward, terminated, truncated, infos = envs.step(
                chosen[:, 0] if single else chosen
            )
            over = terminated | truncated
            rewards[t], ends[t] = torch.as_tensor(reward), torch.as_tensor(over)
            if "episode" in infos:
                returns += infos["episode"]["r"][infos["_episode"]].tolist()
        with torch.no_grad():
            following = network.value(torch.as_tensor(observation))
        advantages = torch.zeros(shape)
        gained = torch.zeros(shape[1])
        for t in reversed(range(options.length)):
            going = 1.0 - ends[t]
            error = rewards[t] + going * following - values[t]
            gained = error + 0.95 * going * gained
            advantages[t], following = gained, values[t]
        used = fresh.flatten() == 0
        flat = [x.flatten(0, 1)[used] for x in (seen, masks, actions, logs, advantages, values)]
        for _ in range(4):
            for some in torch.split(torch.randperm(len(flat[0])), 128):
                s, m, a, before, advantage, value = (x[some] for x in flat)
                parts = network.distributions(s, m)
                ratio = (log_probability(parts, a) - before).exp()
                scaled = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-8)
                gain = torch.min(ratio * scaled, ratio.clamp(0.8, 1.2) * scaled).mean()
                miss = (network.value(s) - advantage - value).square().mean()
                entropy = torch.stack([d.entropy() for d in parts]).sum(0).mean()
                optimiser.zero_grad()
                torch.autograd.backward(0.5 * miss - gain - 0.003 * entropy)
                nn.utils.clip_grad_norm_(network.parameters(), 0.5)
                optimiser.step()
        if update % max(1, updates // 10) == 0 or update == updates - 1:
            steps, latest = (update + 1) * shape[0] * shape[1], np.mean(returns[-500:] or [np.nan])
            print(f"{steps} steps, {len(returns)} episodes, return {latest:+.3f}", file=sys.stderr)
    envs.close()
    return returns


def run(options: Options) -> None:
    """Train and print the mean return of the last episodes."""
    returns = train(options)
    print(f"mean return of the last {len(returns[-500:])} episodes: {np.mean(returns[-500:]):+.3f}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    command("ppo_single_file", __doc__, Options, run, arguments)


if __name__ == "__main__":
    main()
