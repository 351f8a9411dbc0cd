"""Forward pass of a trained set network in numpy, from the tensors of its model file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.rl.network import Layer, PolicyNetwork
from loose_env.envs import ObservationLayout

__all__ = ["LOG_FLOOR", "LOG_SCALE", "SET_CLIP", "SetNetwork", "is_set_network", "set_network"]

LOG_FLOOR = -8.0
"""Lowest log-probability that the policy sees."""
LOG_SCALE = 0.25
"""Log-probabilities are shown times this, of the order of one."""
SET_CLIP = 5.0
"""Standardised elements of a record are cut off here."""

_EXTRACTOR = "features_extractor"
Weights = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class SetNetwork:
    """Actor on the sum of the records' embeddings (`loose_agents.rl.end_to_end.record_set`)."""

    layout: ObservationLayout
    """Layout of the observation."""
    own: NDArray[np.int64]
    """Elements of a record whose differences from their nominal twins are seen."""
    nominal: NDArray[np.int64]
    """Their twins."""
    mean: Weights
    """Mean of what is seen of a record."""
    gain: Weights
    """One over its standard deviation."""
    embedding: tuple[Layer, ...]
    """Layers on one record, each followed by a rectifier."""
    posterior: tuple[Layer, ...]
    """Layers from the sum to the logits of the hypotheses; none without a posterior."""
    hidden: tuple[Layer, ...]
    """Layers of the policy, each followed by the activation."""
    head: PolicyNetwork
    """Its last layer, which sees the posterior besides."""

    def begin(self) -> Any:
        """Return the initial state of an episode."""
        return self.head.begin()

    def choose(
        self, features: NDArray[np.float32], state: Any, mask: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.int64], Any]:
        """Choose the most probable option of every choice for an observation (size,)."""
        slots = self.layout.slots_of(features)
        y = slots[slots[:, 0] > 0.5]
        y = np.concatenate([y, y[:, self.own] - y[:, self.nominal]], axis=1)
        y = np.clip((y - self.mean) * self.gain, -SET_CLIP, SET_CLIP)
        for layer in self.embedding:
            y = np.maximum(np.einsum("oi,bi->bo", layer.weight, y) + layer.bias, 0.0)
        total = y.sum(0)
        seen = [features[: len(self.layout.global_elements)], total]
        logs, posterior = [], []
        if self.posterior:
            first, last = self.posterior
            logits = last(np.maximum(first(total), 0.0))
            logits = logits - logits.max()
            found = logits - np.log(np.exp(logits).sum())
            logs = [np.maximum(found, LOG_FLOOR) * LOG_SCALE]
            posterior = [np.exp(logs[0] / LOG_SCALE)]
        y = np.concatenate([*seen, *logs])
        for layer in self.hidden:
            y = layer(y)
            y = np.tanh(y) if self.head.activation == "tanh" else np.maximum(y, 0.0)
        return self.head.choose(np.concatenate([y, *posterior]), state, mask)


def is_set_network(state: dict[str, NDArray[Any]]) -> bool:
    """Return whether tensors are those of a policy on a set network."""
    return f"{_EXTRACTOR}.embedding.0.weight" in state


def set_network(
    state: dict[str, NDArray[Any]],
    layout: ObservationLayout,
    nvec: NDArray[np.int64],
    *,
    activation: str,
    masked: bool,
) -> SetNetwork:
    """Build a set network from the tensors of its model, under torch's names.

    Raises
    ------
    KeyError, ValueError
        If they make no such network, or one of another layout.
    """

    def layers(name: str) -> tuple[Layer, ...]:
        found = sorted(
            int(key.removeprefix(f"{name}.").partition(".")[0])
            for key in state
            if key.startswith(f"{name}.") and key.endswith(".weight")
        )
        return tuple(layer(f"{name}.{k}") for k in found)

    def layer(name: str) -> Layer:
        return Layer(weight=state[f"{name}.weight"], bias=state[f"{name}.bias"])

    own, nominal, mean, gain = (
        state[f"{_EXTRACTOR}.{name}"] for name in ("own", "nominal", "mean", "gain")
    )
    size = len(layout.slot_elements)
    inside = all(((each >= 0) & (each < size)).all() for each in (own, nominal))
    embedding = layers(f"{_EXTRACTOR}.embedding")
    if not inside or mean.shape != (size + len(own),) or embedding[0].weight.shape[1] != len(mean):
        raise ValueError(f"it was trained on records of other than {size} elements")
    return SetNetwork(
        layout=layout,
        own=own,
        nominal=nominal,
        mean=mean,
        gain=gain,
        embedding=embedding,
        posterior=layers(f"{_EXTRACTOR}.posterior"),
        hidden=layers("mlp_extractor.policy_net"),
        head=PolicyNetwork(
            layers=(layer("action_net"),), nvec=nvec, activation=activation, masked=masked
        ),
    )
