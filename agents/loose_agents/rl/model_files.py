"""Safe reading and writing of stable-baselines3 models without executing code.

A model's ``.zip`` holds tensors, and settings of which some are pickled objects: unpickling runs
whatever the file says. So only the tensors and plain JSON are read here. The rest of a model, its
algorithm and its hyperparameters, is made anew from the run's own options. What a run needs
besides, its counters, evaluations and generators, is a JSON member of the same file.
"""

from __future__ import annotations

import base64
import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from loose_env.errors import InvalidData

RUN = "loose_run.json"
"""Member of the zip file with what the run remembers."""
TRAINED_ON = "loose_problem"
"""Attribute of a model, and so entry of its settings: fingerprint of the problem it learnt."""
FORMAT = "loose-run/1"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_NOT_KEPT = ("_last_obs", "_last_original_obs", "_last_episode_starts")
"""State of the environments: a resumed run begins new episodes."""
_MOST_BYTES = 2**31
_ACTIVATIONS = ("Tanh", "ReLU")
_NETWORK = (
    "net_arch",
    "ortho_init",
    "log_std_init",
    "share_features_extractor",
    "normalize_images",
)
"""Plain arguments of a policy's network; ``activation_fn`` besides."""


@dataclass(frozen=True, kw_only=True)
class StoredModel:
    """Contents read from a model file."""

    path: Path
    parameters: Mapping[str, Any]
    """State dictionaries by name, tensors throughout."""
    described: Mapping[str, Any]
    """Settings as JSON; a pickled one is left as the text it is."""
    run: Mapping[str, Any] | None
    """State of the run; None in a file of another program."""


def zipped(model: Any, state: Any) -> bytes:
    """Serialise a stable-baselines3 model with the state of its run."""
    buffer = io.BytesIO()
    model.save(buffer, exclude=_NOT_KEPT)
    remembered = {
        "format": FORMAT,
        "counters": {name: int(getattr(model, name, 0)) for name in _COUNTERS},
        "state": _plain(asdict(state)),
    }
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr(RUN, json.dumps(remembered))
    return buffer.getvalue()


def read_model(path: str | Path, device: str = "cpu") -> StoredModel:
    """Read tensors and plain settings; only torch's restricted unpickler is used."""
    where = Path(path)
    try:
        with zipfile.ZipFile(where) as archive:
            members = {each.filename: each.file_size for each in archive.infolist()}
            if sum(members.values()) > _MOST_BYTES:
                raise InvalidData(f"{where} unpacks to more than {_MOST_BYTES} bytes")
            parameters = {}
            for name in members:
                if name.endswith(".pth") and name != "pytorch_variables.pth":
                    stored = io.BytesIO(archive.read(name))
                    loaded = torch.load(stored, map_location=device, weights_only=True)
                    parameters[name.removesuffix(".pth")] = loaded
            described = json.loads(archive.read("data"))
            run = json.loads(archive.read(RUN)) if RUN in members else None
    except InvalidData:
        raise
    except Exception as error:  # zipfile, zlib, json and torch raise a dozen kinds
        raise InvalidData(f"{where} holds no model that can be read: {_one_line(error)}") from error
    if not isinstance(described, dict) or "policy" not in parameters:
        raise InvalidData(f"{where} holds no model of stable-baselines3: no policy is in it")
    if run is not None and (not isinstance(run, dict) or run.get("format") != FORMAT):
        raise InvalidData(f"{where}: {RUN} is not of the format {FORMAT!r}")
    return StoredModel(path=where, parameters=parameters, described=described, run=run)


def restore(stored: StoredModel, model: Any, kind: type[Any]) -> Any:
    """Load tensors and counters into a new model; return the run state."""
    if stored.run is None:
        raise InvalidData(f"{stored.path} is no checkpoint of this version: it has no {RUN}")
    put_parameters(stored, model)
    try:
        counters, given = stored.run["counters"], _restored(stored.run["state"])
        for name in _COUNTERS:
            setattr(model, name, _count(counters[name]))
        return kind(**{each.name: given[each.name] for each in fields(kind)})
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidData(f"{stored.path}: {RUN}: {_one_line(error)}") from error


def put_parameters(stored: StoredModel, model: Any) -> None:
    """Load a file's tensors into a model."""
    for name, value in stored.parameters["policy"].items():
        if not isinstance(value, torch.Tensor) or not bool(torch.isfinite(value).all()):
            raise InvalidData(f"{stored.path}: the weights {name!r} are not finite numbers")
    try:
        model.set_parameters(dict(stored.parameters), exact_match=True, device=model.device)
    except Exception as error:  # torch and stable-baselines3 raise several kinds
        raise InvalidData(f"{stored.path} does not fit: {_one_line(error)}") from error


def network_arguments(stored: StoredModel) -> dict[str, Any]:
    """Keyword arguments of the policy's network that are plain values."""
    given = stored.described.get("policy_kwargs") or {}
    if not isinstance(given, dict):
        raise InvalidData(f"{stored.path}: policy_kwargs is no object")
    found: dict[str, Any] = {}
    for name, value in given.items():
        if name.startswith(":"):
            continue  # the pickled form of the same
        if name == "activation_fn":
            kind = str(value).rpartition(".")[2].rstrip("'>")
            if kind not in _ACTIVATIONS:
                raise InvalidData(f"{stored.path}: activation_fn is one of {list(_ACTIVATIONS)}")
            found[name] = getattr(nn, kind)
        elif name in _NETWORK and not isinstance(value, str):
            found[name] = value
        else:
            raise InvalidData(
                f"{stored.path}: the network was made with {name!r}, which is not read; known are "
                f"{[*_NETWORK, 'activation_fn']}"
            )
    return found


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _plain(value: Any) -> Any:
    """Convert to JSON-compatible values; generator states become bytes."""
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
        return {"array": data, "dtype": str(value.dtype)}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {"items": [[str(k), _plain(v)] for k, v in value.items()]}
    if isinstance(value, tuple):
        return {"tuple": [_plain(v) for v in value]}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {"number": repr(value)}
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, list):
        return [_restored(v) for v in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        dtype = np.dtype(str(value["dtype"]))
        if dtype.kind not in "biuf":
            raise ValueError(f"an array of {dtype}")
        return np.frombuffer(base64.b64decode(value["array"]), dtype=dtype).copy()
    if "items" in value:
        return {k: _restored(v) for k, v in value["items"]}
    if "tuple" in value:
        return tuple(_restored(v) for v in value["tuple"])
    return float(value["number"])


def _one_line(error: Exception) -> str:
    # What torch says goes on for a page, and advises to load without a check.
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words[:200]}" if words else type(error).__name__
