"""Agent learned for loose_env/Gap-v0, and its policy: a network for motions, one for verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from torch import nn

from loose_agents.base import EpisodeAgent
from loose_agents.policies.model_gap import NAT, SETUP_S
from loose_env.envs import GapObservation, ModelGapEnv
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

_TEMPERATURE = 0.05
"""Temperature of the first policy [reward]: how much worse an action is that falls 1/e as often."""
_FIRST = 8.0
"""First motion: logit of the largest expected information a second over that of none."""
_WIDTH = 32
"""Units of each layer."""
_UNKNOWN = 1.1e-6
"""Probability up to which a rank of the posterior counts as empty."""


class _Scores(nn.Module):
    """Logits of motions and verdicts, and features of the value."""

    seconds: torch.Tensor
    prices: torch.Tensor

    def __init__(self, layout: GapObservation, seconds: Array, prices: Array) -> None:
        super().__init__()
        self.layout = layout
        # not stored with the weights, which serve any library
        for name, given in (("seconds", seconds), ("prices", prices)):
            found = torch.as_tensor(given, dtype=torch.float32)
            self.register_buffer(name, found, persistent=False)
        seen = 2 * layout.ranks + 4 + 3
        self.motion = _network(8 + seen, 1)
        self.verdict = _network(3 + layout.ranks + seen, 1)
        self.state = _network(seen, _WIDTH)
        self.scale = nn.Parameter(torch.zeros(2))
        self.latent_dim_pi, self.latent_dim_vf = layout.motions + layout.ranks, _WIDTH

    def forward(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (batch, M + R), and features of the value (batch, width)."""
        return self.forward_actor(observations), self.forward_critic(observations)

    def forward_critic(self, observations: torch.Tensor) -> torch.Tensor:
        """Features of the value (batch, width)."""
        return torch.relu(self.state(self._seen(observations)))

    def forward_actor(self, observations: torch.Tensor) -> torch.Tensor:
        """Logits of the motions and of the verdicts (batch, M + R)."""
        at = self.layout
        probability, members = 10.0 ** observations[:, at.sets], observations[:, at.members]
        information, gain = observations[:, at.information], observations[:, at.gain]
        taken, rest = observations[:, at.taken], observations[:, at.rest]
        worth = gain - self.prices
        time = self.seconds + SETUP_S
        rate = information / time
        relative = rate / rate.amax(1, keepdim=True).clamp(min=1e-6)
        begun = (taken.sum(1, keepdim=True) > 0).float()
        seen = self._seen(observations)
        # The first policy: by expected reward, as greedy; before any motion by information.
        named = 2.0 * probability - 1.0
        go_on = named.amax(1, keepdim=True) + worth + NAT * information
        reward = torch.exp(self.scale[0]) / _TEMPERATURE
        # Many motions, one verdict each: what all motions together weigh is one more action.
        first_motion = begun * (go_on * reward - np.log(at.motions))
        first_motion = first_motion + (1 - begun) * relative * _FIRST * torch.exp(self.scale[1])
        motions = torch.stack(
            [taken, rest.clamp(-1, 5), information, relative, 10 * gain, 10 * worth,
             self.seconds.expand_as(gain) / 5, worth / time], 2,
        )  # fmt: skip
        rank = torch.eye(at.ranks, device=seen.device).expand(len(seen), -1, -1)
        own = torch.stack([probability, observations[:, at.sets] / 3, members], 2)
        verdicts = torch.cat([own, rank], 2)
        return torch.cat(
            [
                first_motion + self.motion(_beside(motions, seen))[:, :, 0],
                named * reward + self.verdict(_beside(verdicts, seen))[:, :, 0],
            ],
            1,
        )

    def _seen(self, observations: torch.Tensor) -> torch.Tensor:
        """What every score depends on: the leading sets, what was spent, the best outlook."""
        at = self.layout
        logs = observations[:, at.sets]
        return torch.cat(
            [
                10.0**logs,
                observations[:, at.members],
                observations[:, at.spent],
                observations[:, at.information].amax(1, keepdim=True),
                10 * observations[:, at.gain].amax(1, keepdim=True),
                10 * (observations[:, at.gain] - self.prices).amax(1, keepdim=True),
            ],
            1,
        )


class MotionPolicy(MaskableActorCriticPolicy):
    """Maskable policy whose scores of motions do not depend on their place in the library.

    One small network scores each motion by its own elements of the observation (repetitions,
    residual, expected information and gain, machine time, price), another each verdict by its rank
    and probability; both see the leading probabilities. So the weights serve any arm, candidates
    and library. It begins as a soft form of the greedy agent: the logit of a motion is the expected
    reward with it, that of a verdict the reward expected now, over a temperature. What the networks
    add begins at zero.
    """

    def __init__(
        self, *args: Any, layout: GapObservation, seconds: Array, prices: Array, **arguments: Any
    ) -> None:
        self.layout = layout
        self.motion_seconds, self.motion_prices = seconds, prices
        super().__init__(*args, **arguments)

    def _build_mlp_extractor(self) -> None:
        scores: Any = _Scores(self.layout, self.motion_seconds, self.motion_prices)
        self.mlp_extractor = scores.to(self.device)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        # SB3 has initialised all layers anew, these too: nothing is added to the first policy.
        scores: Any = self.mlp_extractor
        for last in (scores.motion[-1], scores.verdict[-1]):
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        make: Any = self.optimizer_class
        self.optimizer = make(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def load_policy(weights: Path, policy: nn.Module) -> dict[str, Any]:
    """Load stored weights into a policy; return all that is stored beside them."""
    if not weights.is_file():
        raise InvalidSetting(f"no weights {weights}: scripts/model_gap/train.py writes them")
    try:
        stored: dict[str, Any] = torch.load(weights, map_location="cpu", weights_only=True)
        finite = all(bool(torch.isfinite(each).all()) for each in stored["policy"].values())
        policy.load_state_dict(stored["policy"])
    except Exception as error:  # torch, pickle and zipfile raise a dozen kinds
        raise InvalidSetting(
            f"{weights} is damaged, or not of a policy with as many ranks of verdicts: train anew "
            "with scripts/model_gap/train.py in another folder"
        ) from error
    if not finite:
        raise InvalidSetting(
            f"{weights} holds numbers that are not finite: train anew with "
            "scripts/model_gap/train.py in another folder"
        )
    return stored


class LearnedGapAgent(EpisodeAgent):
    """Agent that acts by a maskable PPO of sb3-contrib on the belief."""

    def __init__(self, weights: Path, env: ModelGapEnv) -> None:
        self.layout, self.most = env.layout, env.settings.max_motions
        self.seed = 0  # nothing is drawn
        self.policy = MotionPolicy(
            env.observation_space, env.action_space, lambda _: 0.0,
            layout=env.layout, seconds=env.bank.seconds, prices=env.motion_prices,
        )  # fmt: skip
        load_policy(weights, self.policy)

    def begin(self, rng: np.random.Generator) -> None:
        """Return the initial state of an episode: none."""

    def act(self, observation: NDArray[np.float32], memory: Any) -> Any:
        """Choose the most probable action among those that make sense."""
        taken = float(observation[self.layout.taken].sum())
        mask = np.full(self.layout.motions + self.layout.ranks, taken < self.most)
        known = 10.0 ** observation[self.layout.sets] > _UNKNOWN
        mask[self.layout.motions :] = known & (taken > 0)
        return np.int64(self.policy.predict(observation, action_masks=mask, deterministic=True)[0])


def _network(size: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, _WIDTH), nn.Tanh(), nn.Linear(_WIDTH, _WIDTH), nn.Tanh(),
        nn.Linear(_WIDTH, out),
    )  # fmt: skip


def _beside(own: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Own features (batch, K, F) with those that all see (batch, S) beside them."""
    return torch.cat([own, seen[:, None].expand(-1, own.shape[1], -1)], 2)
