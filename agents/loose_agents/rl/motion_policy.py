"""Policy of loose_env/Gap-v0 that scores every motion and every verdict by the same networks."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from torch import nn

from loose_env.envs import GapObservation
from loose_env.typing import Array

__all__ = ["MotionPolicy"]

_TEMPERATURE = 0.05
"""Temperature of the first policy [reward]: how much worse an action is that falls 1/e as often."""
_FIRST = 8.0
"""First motion: logit of the largest expected information a second over that of none."""
_SETUP_S = 0.5
"""Time to set up a motion [s], as for greedy."""
_NAT = 1e-3
"""Reward that a nat of information counts as at first, as for greedy."""
_WIDTH = 32


class _Scores(nn.Module):
    """Logits of motions and verdicts, and features of the value.

    Parameters
    ----------
    layout : GapObservation
        Layout of the observation.
    seconds, prices : ndarray (M,)
        Machine time [s] and price [reward] of each motion.
    """

    seconds: torch.Tensor
    prices: torch.Tensor

    def __init__(self, layout: GapObservation, seconds: Array, prices: Array) -> None:
        super().__init__()
        self.layout = layout
        self.register_buffer("seconds", torch.as_tensor(seconds, dtype=torch.float32))
        self.register_buffer("prices", torch.as_tensor(prices, dtype=torch.float32))
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
        time = self.seconds + _SETUP_S
        rate = information / time
        relative = rate / rate.amax(1, keepdim=True).clamp(min=1e-6)
        begun = (taken.sum(1, keepdim=True) > 0).float()
        seen = self._seen(observations)
        # The first policy: by expected reward, as greedy; before any motion by information.
        named = 2.0 * probability - 1.0
        go_on = named.amax(1, keepdim=True) + worth + _NAT * information
        reward = torch.exp(self.scale[0]) / _TEMPERATURE
        # Many motions, one verdict each: what all motions together weigh is one more action.
        first_motion = begun * (go_on * reward - np.log(at.motions))
        first_motion = first_motion + (1 - begun) * relative * _FIRST * torch.exp(self.scale[1])
        motions = torch.stack(
            [taken, rest.clamp(-1, 5), information, relative, 10 * gain, 10 * worth,
             self.seconds.expand_as(gain) / 5, worth / time], 2,
        )  # fmt: skip
        rank = torch.eye(at.ranks, device=seen.device).expand(len(seen), -1, -1)
        verdicts = torch.cat(
            [
                torch.stack([probability, torch.log10(probability.clamp(min=1e-6)) / 3, members], 2),
                rank,
            ],
            2,
        )
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
    residual, expected information and gain, machine time, price), another each verdict by its
    rank and probability; both see the leading probabilities. It begins as a soft form of the greedy agent:
    the logit of a motion is the expected reward with it, that of a verdict the reward expected now,
    over a temperature. What the networks add begins at zero.

    Parameters
    ----------
    *args, **arguments
        Those of sb3-contrib's policy.
    layout : GapObservation
        Layout of the observation.
    seconds, prices : ndarray (M,)
        Machine time [s] and price [reward] of each motion.
    """

    def __init__(
        self, *args: Any, layout: GapObservation, seconds: Array, prices: Array, **arguments: Any
    ) -> None:
        self.layout = layout
        self.motion_seconds = np.asarray(seconds, dtype=np.float32)
        self.motion_prices = np.asarray(prices, dtype=np.float32)
        super().__init__(*args, **arguments)

    def _build_mlp_extractor(self) -> None:
        scores: Any = _Scores(self.layout, self.motion_seconds, self.motion_prices)
        self.mlp_extractor = scores.to(self.device)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # type: ignore[assignment]
        # SB3 has initialised all layers anew, these too: nothing is added to the first policy.
        scores: Any = self.mlp_extractor
        for last in (scores.motion[-1], scores.verdict[-1]):
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )


def _network(size: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, _WIDTH), nn.Tanh(), nn.Linear(_WIDTH, _WIDTH), nn.Tanh(),
        nn.Linear(_WIDTH, out),
    )  # fmt: skip


def _beside(own: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Own features (batch, K, F) with those that all see (batch, S) beside them."""
    return torch.cat([own, seen[:, None].expand(-1, own.shape[1], -1)], 2)
