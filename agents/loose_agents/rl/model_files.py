"""Safe reading and writing of stable-baselines3 models without executing code.

A model's ``.zip`` holds tensors, and settings of which some are pickled objects: unpickling runs
whatever the file says. So only the tensors and plain JSON are read here. The rest of a model, its
algorithm and its hyperparameters, is made anew from the run's own options. What a run needs
besides, its counters and evaluations, is a member of tensors and plain values.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch

from loose_env.errors import InvalidData

RUN = "loose_run.pt"
"""Member of the zip file with what the run remembers."""
TRAINED_ON = "loose_problem"
"""Attribute of a model, and so entry of its settings: fingerprint of the problem it learnt."""
FORMAT = "loose-run/2"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_NOT_KEPT = ("_last_obs", "_last_original_obs", "_last_episode_starts")
"""State of the environments: a resumed run begins new episodes."""
_MOST_BYTES = 2**31


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
    counters = {name: int(getattr(model, name, 0)) for name in _COUNTERS}
    remembered = io.BytesIO()
    torch.save({"format": FORMAT, "counters": counters, "state": asdict(state)}, remembered)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr(RUN, remembered.getvalue())
    return buffer.getvalue()


def read_model(path: str | Path, device: str = "cpu") -> StoredModel:
    """Read tensors and plain settings; only torch's restricted unpickler is used."""
    where = Path(path)
    try:
        with zipfile.ZipFile(where) as archive:
            members = {each.filename: each.file_size for each in archive.infolist()}
            if sum(members.values()) > _MOST_BYTES:
                raise InvalidData(f"{where} unpacks to more than {_MOST_BYTES} bytes")

            def load(name: str, where: str = device) -> Any:
                stored = io.BytesIO(archive.read(name))
                return torch.load(stored, map_location=where, weights_only=True)

            parameters = {
                name.removesuffix(".pth"): load(name)
                for name in members
                if name.endswith(".pth") and name != "pytorch_variables.pth"
            }
            described = json.loads(archive.read("data"))
            run = load(RUN, "cpu") if RUN in members else None
    except InvalidData:
        raise
    except Exception as error:  # zipfile, zlib, json and torch raise a dozen kinds
        raise InvalidData(f"{where} holds no model that can be read: {one_line(error)}") from error
    if not isinstance(described, dict) or "policy" not in parameters:
        raise InvalidData(f"{where} holds no model of stable-baselines3: no policy is in it")
    if run is not None and (not isinstance(run, dict) or run.get("format") != FORMAT):
        raise InvalidData(f"{where}: {RUN} is not of the format {FORMAT!r}")
    return StoredModel(path=where, parameters=parameters, described=described, run=run)


def restore(stored: StoredModel, model: Any, kind: type[Any]) -> Any:
    """Load tensors and counters into a new model; return the run state."""
    if stored.run is None:
        raise InvalidData(f"{stored.path} is no checkpoint of this version: it has no {RUN}")
    for name, value in stored.parameters["policy"].items():
        if not isinstance(value, torch.Tensor) or not bool(torch.isfinite(value).all()):
            raise InvalidData(f"{stored.path}: the weights {name!r} are not finite numbers")
    try:
        model.set_parameters(dict(stored.parameters), exact_match=True, device=model.device)
    except Exception as error:  # torch and stable-baselines3 raise several kinds
        raise InvalidData(f"{stored.path} does not fit: {one_line(error)}") from error
    try:
        counters, given = stored.run["counters"], stored.run["state"]
        for name in _COUNTERS:
            setattr(model, name, int(counters[name]))
        return kind(**{each.name: given[each.name] for each in fields(kind)})
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidData(f"{stored.path}: {RUN}: {one_line(error)}") from error


def activation_of(stored: StoredModel) -> str:
    """Name of the network's activation in small letters; pickled arguments are not read."""
    given = stored.described.get("policy_kwargs")
    kind = given.get("activation_fn", "Tanh") if isinstance(given, dict) else "Tanh"
    return str(kind).rpartition(".")[2].rstrip("'>").lower()


def one_line(error: Exception) -> str:
    """Kind and beginning of an error."""
    # What torch says goes on for a page, and advises to load without a check.
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words[:200]}" if words else type(error).__name__
