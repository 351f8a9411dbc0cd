"""Set network over records as a features extractor of stable-baselines3 (Zaheer et al. 2017)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from loose_agents.rl.set_network import SET_CLIP
from loose_env.envs import ObservationLayout
from loose_env.errors import InvalidSetting

__all__ = ["RecordSetExtractor", "record_set_arguments"]

_NOMINAL = "nominal_"
_SMALLEST_SPREAD = 1e-3


def record_set_arguments(layout: ObservationLayout) -> dict[str, Any]:
    """Arguments of `RecordSetExtractor` for an environment's observation.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Vera-v0").unwrapped
    >>> given = record_set_arguments(env.layout)
    >>> given["slots"], given["slot_size"], len(given["pairs"])
    (12, 58, 20)
    """
    names = [each.name for each in layout.slot_elements]
    twins = [(k, names.index(_NOMINAL + n)) for k, n in enumerate(names) if _NOMINAL + n in names]
    return {"slots": layout.slots, "slot_size": len(names), "pairs": twins}


class RecordSetExtractor(BaseFeaturesExtractor):
    """Sum over the records of an embedding of each, beside the global elements.

    Records are a set: exchanging two slots changes nothing, and an empty slot adds nothing. A sum,
    because evidence adds up: the log-posterior of a hypothesis is a sum over independent records.
    An embedding sees a record's elements and the differences from their nominal twins, each
    standardised as `standardise` has measured it.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Box
        Flat observation: global elements, then slots of equal layout.
    slots, slot_size : int
        Number of slots, and of elements of each; the first of them is 1 where a record was
        measured, 0 in an empty slot.
    pairs : sequence of (int, int)
        Elements of a slot and their nominal twins.
    width : int
        Units of each layer of the embedding.

    Raises
    ------
    InvalidSetting
        If the observation has fewer elements than the slots.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> from stable_baselines3 import PPO
    >>> env = gymnasium.make("loose_env/Vera-v0", engine="reduced")
    >>> kwargs = dict(
    ...     features_extractor_class=RecordSetExtractor,
    ...     features_extractor_kwargs=record_set_arguments(env.unwrapped.layout),
    ... )
    >>> PPO("MlpPolicy", env, policy_kwargs=kwargs, device="cpu").policy.features_dim
    72
    """

    own: torch.Tensor
    nominal: torch.Tensor
    mean: torch.Tensor
    gain: torch.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        *,
        slots: int,
        slot_size: int,
        pairs: Sequence[tuple[int, int]] = (),
        width: int = 64,
    ) -> None:
        start = int(np.prod(observation_space.shape)) - slots * slot_size
        if start < 0:
            raise InvalidSetting(
                f"an observation of shape {observation_space.shape} has no {slots} slots of "
                f"{slot_size} elements; give record_set_arguments(env.layout)"
            )
        super().__init__(observation_space, features_dim=start + width)
        self.slots, self.slot_size, self.start, self.width = slots, slot_size, start, width
        seen = slot_size + len(pairs)
        twins = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self.register_buffer("own", torch.from_numpy(twins[:, 0].copy()))
        self.register_buffer("nominal", torch.from_numpy(twins[:, 1].copy()))
        self.register_buffer("mean", torch.zeros(seen))
        self.register_buffer("gain", torch.ones(seen))
        self.embedding = nn.Sequential(
            nn.Linear(seen, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (batch, features_dim) of observations (batch, elements)."""
        which, seen = self._records(observations)
        embedded = self.embedding(((seen - self.mean) * self.gain).clamp(-SET_CLIP, SET_CLIP))
        total = embedded.new_zeros(len(observations), embedded.shape[1])
        return torch.cat([observations[:, : self.start], total.index_add(0, which, embedded)], 1)

    def standardise(self, observations: NDArray[np.float32]) -> None:
        """Measure mean and standard deviation of a record's elements (batch, elements).

        Before the training and never again: what the policy sees of a record stays the same.
        """
        with torch.no_grad():
            given = torch.as_tensor(observations, device=self.mean.device)
            _, seen = self._records(given)
            if len(seen) > 1:
                self.mean.copy_(seen.mean(0))
                spread = seen.std(0)
                # What never changed is left out rather than blown up.
                self.gain.copy_(torch.where(spread > _SMALLEST_SPREAD, 1.0 / spread, 0.0))

    def _records(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Row in the batch of each measured record (M,), and what is seen of it (M, seen)."""
        slots = observations[:, self.start :].reshape(-1, self.slots, self.slot_size)
        which, slot = torch.nonzero(slots[:, :, 0] > 0.5, as_tuple=True)
        records = slots[which, slot]  # only these are embedded: most slots are empty
        return which, torch.cat([records, records[:, self.own] - records[:, self.nominal]], 1)
