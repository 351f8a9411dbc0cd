"""The trained policy's network: weights without code, forward pass in numpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["PolicyNetwork", "load_network", "save_network"]

WEIGHTS = "policy.safetensors"
_LAYERS = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")


class _Form(Protocol):
    nvec: NDArray[np.int64]
    observation_space: Any


class PolicyNetwork:
    """The actor of a stable-baselines3 `MlpPolicy`: two tanh layers and a head a choice.

    Parameters
    ----------
    layers : list of (weight (out, in), bias (out,))
        Weights of the three layers.
    nvec : ndarray
        Number of options of every choice.
    """

    def __init__(
        self, layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]], nvec: NDArray[np.int64]
    ) -> None:
        self.layers, self.nvec = layers, nvec

    def predict(
        self, features: NDArray[np.float32], deterministic: bool = True
    ) -> tuple[NDArray[np.int64], None]:
        """Choose the most probable option of every choice."""
        y = np.asarray(features, dtype=np.float32)
        for weight, bias in self.layers[:-1]:
            y = np.tanh(np.einsum("oi,i->o", weight, y) + bias)
        weight, bias = self.layers[-1]
        logits = np.einsum("oi,i->o", weight, y) + bias
        parts = np.split(logits, np.cumsum(self.nvec)[:-1])
        return np.array([int(np.argmax(p)) for p in parts]), None


def save_network(model: Any, folder: str | Path) -> None:
    """Write the actor of a stable-baselines3 model; beside it first, then renamed."""
    from safetensors.numpy import save_file

    state = model.policy.state_dict()
    tensors = {
        f"{layer}.{part}": state[f"{layer}.{part}"].cpu().numpy()
        for layer in _LAYERS
        for part in ("weight", "bias")
    }
    target = Path(folder) / WEIGHTS
    beside = target.with_suffix(".part")
    save_file(tensors, str(beside))
    beside.replace(target)


def load_network(folder: str | Path, form: _Form) -> PolicyNetwork:
    """Load the actor. Nothing is unpickled.

    Raises
    ------
    ValueError
        If the file is missing, or its shapes do not fit what the policy sees and chooses.
    """
    from safetensors.numpy import load_file

    path = Path(folder) / WEIGHTS
    if not path.is_file():
        raise ValueError(f"no trained policy at {path}; train one with scripts/train.py")
    tensors = load_file(str(path))
    layers = [(tensors[f"{layer}.weight"], tensors[f"{layer}.bias"]) for layer in _LAYERS]
    sizes = (layers[0][0].shape[1], layers[-1][0].shape[0])
    wanted = (form.observation_space.shape[0], int(form.nvec.sum()))
    if sizes != wanted:
        raise ValueError(
            f"the policy at {path} takes {sizes[0]} features and has {sizes[1]} options; this "
            f"problem has {wanted[0]} and {wanted[1]}"
        )
    return PolicyNetwork(layers, form.nvec)
