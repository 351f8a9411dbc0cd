"""Forward pass of the trained policy network in numpy, with code-free weights."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import write_bytes

__all__ = [
    "Cell",
    "Layer",
    "PolicyNetwork",
    "load_network",
    "network_from_tensors",
    "network_of",
    "save_network",
]

WEIGHTS = "policy.safetensors"
_LARGEST_WEIGHT = 1e6
FORMAT = "loose-policy/2"

Weights = NDArray[np.float32]
State = tuple[tuple[Weights, Weights], ...]
_ACTIVATIONS = {"tanh": np.tanh, "relu": lambda y: np.maximum(y, 0.0)}
_EXTRACTOR = "mlp_extractor.policy_net"


class _Form(Protocol):
    nvec: NDArray[np.int64]
    observation_space: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """One affine layer: ``weight @ x + bias``."""

    weight: Weights
    """(out, in)."""
    bias: Weights
    """(out,)."""

    def __call__(self, x: Weights) -> Weights:
        """Apply the layer to (in,)."""
        # A plain sum: the same to the last bit whatever the number of threads.
        return np.asarray(np.einsum("oi,i->o", self.weight, x) + self.bias)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """LSTM layer with torch's parameter layout.

    The rows are input gate, forget gate, candidate and output gate, ``size`` of each
    (Hochreiter & Schmidhuber 1997, with the forget gate of Gers et al. 2000).
    """

    on_input: Layer
    """(4 size, in)."""
    on_state: Layer
    """(4 size, size)."""

    @property
    def size(self) -> int:
        """Number of units."""
        return self.on_state.weight.shape[1]  # type: ignore[no-any-return]

    def __call__(self, x: Weights, hidden: Weights, cell: Weights) -> tuple[Weights, Weights]:
        """Apply to (in,); return the next hidden and cell state, (size,) each."""
        gates = self.on_input(x) + self.on_state(hidden)
        enter, keep, candidate, show = np.split(gates, 4)
        after = _sigmoid(keep) * cell + _sigmoid(enter) * np.tanh(candidate)
        return _sigmoid(show) * np.tanh(after), after


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyNetwork:
    """Actor of a stable-baselines3 policy: LSTM cells, layers, one head per choice."""

    layers: tuple[Layer, ...]
    """Layers with an activation between them; the last gives the logits."""
    nvec: NDArray[np.int64]
    """Number of options of every choice."""
    cells: tuple[Cell, ...] = ()
    """Memory cells before the layers; none in a policy without memory."""
    activation: str = "tanh"
    """Activation of all layers but the last: "tanh" or "relu"."""
    masked: bool = False
    """True if the policy was trained with action masks, and so needs them."""

    def __post_init__(self) -> None:
        if self.activation not in _ACTIVATIONS:
            raise InvalidSetting(
                f"the activation is one of {list(_ACTIVATIONS)}, got {self.activation!r}"
            )

    def begin(self) -> State:
        """Return the initial state of an episode."""
        return tuple(
            (np.zeros(c.size, dtype=np.float32), np.zeros(c.size, dtype=np.float32))
            for c in self.cells
        )

    def logits(self, features: NDArray[np.float32], state: State) -> tuple[Weights, State]:
        """Logits of all options, choice by choice, and the next state."""
        y = np.asarray(features, dtype=np.float32)
        after = []
        for cell, (hidden, kept) in zip(self.cells, state, strict=True):
            y, kept = cell(y, hidden, kept)
            after.append((y, kept))
        for layer in self.layers[:-1]:
            y = _ACTIVATIONS[self.activation](layer(y))  # type: ignore[operator]
        return self.layers[-1](y), tuple(after)

    def choose(
        self, features: NDArray[np.float32], state: State, mask: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.int64], State]:
        """Choose the most probable option of every choice.

        Parameters
        ----------
        features : ndarray (features,)
            What the policy sees.
        state : tuple
            From `begin`, or from the call before.
        mask : ndarray (options,) of bool, optional
            Which options are allowed; heeded by policies trained with masks.

        Returns
        -------
        choice : ndarray (choices,)
        state : tuple
        """
        logits, after = self.logits(features, state)
        if self.masked and mask is not None:
            logits = np.where(mask, logits, -np.inf)
        parts = np.split(logits, np.cumsum(self.nvec)[:-1])
        return np.array([int(np.argmax(p)) for p in parts]), after


def _sigmoid(x: Weights) -> Weights:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


def network_of(model: Any) -> PolicyNetwork:
    """Extract the actor from a stable-baselines3 or sb3-contrib model.

    Raises
    ------
    InvalidSetting
        If its activation is neither Tanh nor ReLU.
    """
    policy = model.policy
    name = policy.activation_fn.__name__.lower()
    if name not in _ACTIVATIONS:
        raise InvalidSetting(
            f"a policy ships with the activations Tanh or ReLU, not {policy.activation_fn.__name__}"
        )
    state = {key: value.cpu().numpy().copy() for key, value in policy.state_dict().items()}
    return network_from_tensors(
        state,
        np.array(model.action_space.nvec),
        activation=name,
        masked=type(model).__name__ == "MaskablePPO",
    )


def network_from_tensors(
    state: dict[str, Weights], nvec: NDArray[np.int64], *, activation: str, masked: bool
) -> PolicyNetwork:
    """Build the actor from tensors under torch's names; their sizes must fit each other.

    Raises
    ------
    KeyError, IndexError, ValueError
        If they make no such network.
    """

    def layer(weight: str, bias: str) -> Layer:
        return Layer(weight=state[weight], bias=state[bias])

    cells = []  # type: ignore[var-annotated]
    while f"lstm_actor.weight_ih_l{len(cells)}" in state:
        k = len(cells)
        cells.append(
            Cell(
                on_input=layer(f"lstm_actor.weight_ih_l{k}", f"lstm_actor.bias_ih_l{k}"),
                on_state=layer(f"lstm_actor.weight_hh_l{k}", f"lstm_actor.bias_hh_l{k}"),
            )
        )
    hidden = sorted(
        int(key.split(".")[2])
        for key in state
        if key.startswith(f"{_EXTRACTOR}.") and key.endswith(".weight")
    )
    names = [*(f"{_EXTRACTOR}.{k}" for k in hidden), "action_net"]
    layers = tuple(layer(f"{name}.weight", f"{name}.bias") for name in names)
    network = PolicyNetwork(
        layers=layers, nvec=nvec, cells=tuple(cells), activation=activation, masked=masked
    )
    _check_chain(network)
    return network


def _tensors(network: PolicyNetwork) -> dict[str, Weights]:
    """Return the weights under torch's parameter names."""
    tensors: dict[str, Weights] = {}
    for k, cell in enumerate(network.cells):
        for part, own in (("ih", cell.on_input), ("hh", cell.on_state)):
            tensors[f"lstm_actor.weight_{part}_l{k}"] = own.weight
            tensors[f"lstm_actor.bias_{part}_l{k}"] = own.bias
    *hidden, last = network.layers
    names = [f"{_EXTRACTOR}.{2 * k}" for k in range(len(hidden))]
    for name, own in zip([*names, "action_net"], [*hidden, last], strict=True):
        tensors[f"{name}.weight"], tensors[f"{name}.bias"] = own.weight, own.bias
    return tensors


def save_network(network: PolicyNetwork, folder: str | Path) -> None:
    """Write the weights atomically, by renaming a temporary file."""
    from safetensors.numpy import save

    described = {
        "format": FORMAT,
        "activation": network.activation,
        "masked": json.dumps(network.masked),
    }
    data = save(
        {k: np.ascontiguousarray(v) for k, v in _tensors(network).items()}, metadata=described
    )
    write_bytes(Path(folder) / WEIGHTS, data)


def _check_chain(network: PolicyNetwork) -> None:
    """Check that the dimensions of consecutive layers agree."""
    size = None
    for cell in network.cells:
        size = _width(cell.on_input, size)
        if size % 4 or _width(cell.on_state, size // 4) != size:
            raise ValueError("the shapes of a memory cell do not fit each other")
        size //= 4
    for layer in network.layers:
        size = _width(layer, size)


def _width(layer: Layer, given: int | None) -> int:
    """Output dimension of a layer with a given input dimension."""
    weight, bias = layer.weight, layer.bias
    if weight.ndim != 2 or bias.shape != weight.shape[:1] or not weight.shape[0]:
        raise ValueError(f"a layer of shapes {weight.shape} and {bias.shape}")
    if given is not None and weight.shape[1] != given:
        raise ValueError(f"a layer that takes {weight.shape[1]} numbers is given {given}")
    return int(weight.shape[0])


def load_network(folder: str | Path, form: _Form) -> PolicyNetwork:
    """Load the weights without unpickling.

    Raises
    ------
    InvalidData
        If the file is missing or of another format, or its shapes do not fit what the policy
        sees and chooses.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(folder) / WEIGHTS
    if not path.is_file():
        raise InvalidData(f"no trained policy at {path}; train one with scripts/agents/train.py")
    try:
        with safe_open(str(path), framework="numpy") as file:
            described = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        reason = " ".join(str(error).split())[:200]
        raise InvalidData(f"{path} is no safetensors file: {reason}") from error
    if described.get("format") != FORMAT:
        raise InvalidData(
            f"{path} has the format {described.get('format', 'loose-policy/1')!r}, this version "
            f"reads {FORMAT!r}; train the policy anew with scripts/agents/train.py"
        )
    for name, values in tensors.items():
        # Beyond it a layer's sum would not fit into float32.
        if values.dtype.kind != "f" or not (np.abs(values) <= _LARGEST_WEIGHT).all():
            raise InvalidData(
                f"{path}: tensor {name!r:.60} holds what is no finite weight below "
                f"{_LARGEST_WEIGHT:g}; train the policy anew with scripts/agents/train.py"
            )
    masked = described.get("masked")
    if masked not in ("true", "false"):
        raise InvalidData(f"{path}: masked is 'true' or 'false', got {masked!r:.60}")
    try:
        network = network_from_tensors(
            tensors, form.nvec, activation=described.get("activation", ""), masked=masked == "true"
        )
    except (KeyError, IndexError, ValueError) as error:
        raise InvalidData(
            f"{path} holds no policy of this kind: {type(error).__name__}: {str(error)[:200]}"
        ) from error
    first = network.cells[0].on_input if network.cells else network.layers[0]
    sizes = (first.weight.shape[1], network.layers[-1].weight.shape[0])
    wanted = (form.observation_space.shape[0], int(form.nvec.sum()))
    if sizes != wanted:
        raise InvalidData(
            f"the policy at {path} takes {sizes[0]} features and has {sizes[1]} options; this "
            f"problem has {wanted[0]} and {wanted[1]}"
        )
    return network
