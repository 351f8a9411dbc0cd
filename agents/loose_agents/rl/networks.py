"""Policy networks in torch: the actor for play, its stored weights, the record-set extractor.

Weights are read without running code: safetensors, or the tensors of a model file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import nn

from loose_agents.rl.model_files import one_line
from loose_env.envs import RecordLayout
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import write_bytes

WEIGHTS = "policy.safetensors"
"""File of a policy's weights."""
FORMAT = "loose-policy/2"
SET_CLIP = 5.0
"""Standardised elements of a record are cut off here."""
_LARGEST_WEIGHT = 1e6
_ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU}
_HIDDEN, _EXTRACTOR, _HEAD = "mlp_extractor.policy_net.", "features_extractor.", "action_net."
_NOMINAL = "nominal_"
_SMALLEST_SPREAD = 1e-3


class PolicyNetwork:
    """Actor of a stable-baselines3 policy: the most probable option of every choice."""

    def __init__(
        self,
        actor: nn.Module,
        tensors: Mapping[str, torch.Tensor],
        nvec: NDArray[np.int64],
        *,
        activation: str,
        masked: bool,
    ) -> None:
        self.actor, self.tensors, self.nvec = actor.eval(), dict(tensors), nvec
        self.activation, self.masked = activation, masked

    def choose(
        self, features: NDArray[np.float32], mask: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """Most probable option of every choice, among those that the mask (options,) allows."""
        with torch.inference_mode():
            seen = torch.from_numpy(np.asarray(features, dtype=np.float32))
            logits = self.actor(seen[None])[0].numpy()
        if self.masked and mask is not None:
            logits = np.where(mask, logits, -np.inf)
        parts = np.split(logits, np.cumsum(self.nvec)[:-1])
        return np.array([int(np.argmax(part)) for part in parts])


def choices_of(space: Any) -> NDArray[np.int64]:
    """Options of each choice of a `MultiDiscrete` or `Discrete` action."""
    return np.atleast_1d(space.nvec if hasattr(space, "nvec") else space.n)


def network_of(model: Any, layout: RecordLayout | None = None) -> PolicyNetwork:
    """Copy the actor of a stable-baselines3 or sb3-contrib model."""
    name = model.policy.activation_fn.__name__.lower()
    if name not in _ACTIVATIONS:
        raise InvalidSetting(f"a policy ships with the activations Tanh or ReLU, not {name}")
    tensors = {k: v.detach().cpu().clone() for k, v in model.policy.state_dict().items()}
    masked = type(model).__name__ == "MaskablePPO"
    nvec = choices_of(model.action_space)
    return network_from_tensors(tensors, nvec, activation=name, masked=masked, layout=layout)


def network_from_tensors(
    tensors: Mapping[str, torch.Tensor],
    nvec: NDArray[np.int64],
    *,
    activation: str,
    masked: bool,
    layout: RecordLayout | None = None,
) -> PolicyNetwork:
    """Build the actor from tensors under stable-baselines3's names."""
    if activation not in _ACTIVATIONS:
        raise ValueError(f"the activation is one of {list(_ACTIVATIONS)}, got {activation!r}")
    names = sorted(
        {k.rpartition(".")[0] for k in tensors if k.startswith(_HIDDEN)},
        key=lambda name: int(name.rpartition(".")[2]),
    )
    parts: list[nn.Module] = []
    size = None
    if f"{_EXTRACTOR}mean" in tensors:
        assert layout is not None
        extractor = _extractor_of(tensors, layout)
        parts.append(extractor)
        size = extractor.features_dim
    for name in [*names, _HEAD[:-1]]:
        weight, bias = tensors[f"{name}.weight"], tensors[f"{name}.bias"]
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"a layer of shapes {tuple(weight.shape)} and {tuple(bias.shape)}")
        if size is not None and weight.shape[1] != size:
            raise ValueError(f"a layer that takes {weight.shape[1]} numbers is given {size}")
        layer, size = nn.Linear(weight.shape[1], weight.shape[0]), weight.shape[0]
        layer.load_state_dict({"weight": weight, "bias": bias})
        parts += [layer, _ACTIVATIONS[activation]()]
    if size != nvec.sum():
        raise ValueError(f"it has {size} options, the problem {nvec.sum()}")
    own = {k: v for k, v in tensors.items() if k.startswith((_HIDDEN, _EXTRACTOR, _HEAD))}
    actor = nn.Sequential(*parts[:-1])
    return PolicyNetwork(actor, own, nvec, activation=activation, masked=masked)


def input_size(tensors: Mapping[str, torch.Tensor]) -> int | None:
    """Numbers that the first layer of a plain actor takes; None of a set network."""
    if f"{_EXTRACTOR}mean" in tensors:
        return None
    return int(tensors[f"{_HIDDEN}0.weight"].shape[1])


def save_network(network: PolicyNetwork, folder: str | Path) -> None:
    """Write the weights atomically, as safetensors."""
    from safetensors.torch import save

    described = {
        "format": FORMAT,
        "activation": network.activation,
        "masked": json.dumps(network.masked),
    }
    tensors = {name: value.contiguous() for name, value in network.tensors.items()}
    write_bytes(Path(folder) / WEIGHTS, save(tensors, metadata=described))


def load_network(folder: str | Path, form: Any) -> PolicyNetwork:
    """Read the weights that `save_network` wrote, for what a policy sees and chooses."""
    from safetensors import SafetensorError, safe_open

    path = Path(folder) / WEIGHTS
    again = "train the policy anew with scripts/agents/train.py"
    if not path.is_file():
        raise InvalidData(f"no trained policy at {path}; train one with scripts/agents/train.py")
    try:
        with safe_open(str(path), framework="pt") as file:
            described = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise InvalidData(f"{path} is no safetensors file: {one_line(error)}") from error
    if described.get("format") != FORMAT:
        raise InvalidData(
            f"{path} has the format {described.get('format', 'loose-policy/1')!r}, this version "
            f"reads {FORMAT!r}; {again}"
        )
    for name, values in tensors.items():
        # Beyond it a layer's sum would not fit into float32.
        if not values.is_floating_point() or not bool((values.abs() <= _LARGEST_WEIGHT).all()):
            raise InvalidData(
                f"{path}: tensor {name!r:.60} holds what is no finite weight below "
                f"{_LARGEST_WEIGHT:g}; {again}"
            )
    masked = described.get("masked")
    if masked not in ("true", "false"):
        raise InvalidData(f"{path}: masked is 'true' or 'false', got {masked!r:.60}")
    activation = described.get("activation", "")
    try:
        size, sees = input_size(tensors), form.observation_space.shape[0]
        if size != sees:
            raise ValueError(f"it takes {size} features, this problem has {sees}")
        return network_from_tensors(
            tensors, form.nvec, activation=activation, masked=masked == "true"
        )
    except (KeyError, IndexError, ValueError, RuntimeError) as error:
        raise InvalidData(f"{path} holds no policy of this kind: {one_line(error)}") from error


def record_set_arguments(layout: RecordLayout) -> dict[str, Any]:
    """Arguments of the set network for an environment's observation."""
    names = [each.name for each in layout.slot_elements]
    twins = [(k, names.index(_NOMINAL + n)) for k, n in enumerate(names) if _NOMINAL + n in names]
    return {"slots": layout.slots, "slot_size": len(names), "pairs": twins}


class RecordSetExtractor(nn.Module):
    """Sum over the records of an embedding of each, beside the global elements.

    A features extractor for policies of stable-baselines3 (Zaheer et al., Deep Sets, 2017).
    Exchanging two slots changes nothing, and an empty slot adds nothing. A sum, because evidence
    adds up: the log-posterior of a hypothesis is a sum over independent records. An embedding sees
    a record's elements and the differences from their nominal twins, each standardised as
    `standardise` has measured it.
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
        super().__init__()
        start = int(np.prod(observation_space.shape)) - slots * slot_size
        if start < 0:
            raise InvalidSetting(
                f"an observation of shape {observation_space.shape} has no {slots} slots of "
                f"{slot_size} elements; give record_set_arguments(env.layout)"
            )
        self.slots, self.slot_size, self.start = slots, slot_size, start
        self.features_dim = start + width
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


def _extractor_of(tensors: Mapping[str, torch.Tensor], layout: RecordLayout) -> RecordSetExtractor:
    """Set network of a model's tensors."""
    own = {k.removeprefix(_EXTRACTOR): v for k, v in tensors.items() if k.startswith(_EXTRACTOR)}
    space = spaces.Box(-1.0, 1.0, (layout.size,))
    width = own["embedding.0.weight"].shape[0]
    extractor = RecordSetExtractor(space, **record_set_arguments(layout), width=width)
    for name in ("own", "nominal"):
        if not torch.equal(own[name], getattr(extractor, name)):
            raise ValueError(
                f"it was trained on records of other than {extractor.slot_size} elements"
            )
    try:
        extractor.load_state_dict(own)
    except RuntimeError as error:
        raise ValueError(one_line(error)) from error
    return extractor
