"""Checkpoints of finished stages on disk, and the hash of all inputs that names them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import BadZipFile

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import files_of
from loose_env.errors import InvalidSetting
from loose_env.io import written_beside
from loose_env.recording import Recording

Tree: TypeAlias = "bool | int | float | str | NDArray[Any] | list[Tree] | dict[str, Tree] | None"
"""What a stage may return: plain values, arrays of numbers, lists and dictionaries of them."""
Stage: TypeAlias = Callable[[str, Callable[[], Any]], Any]
"""Called with a stage's name and what makes it; returns what it made, now or earlier."""

_FORMAT = 3
"""Of the stored files; raised when what a stage returns changes its meaning."""
_ARRAY = "__array__"
_NUMBER = "__number__"
_BROKEN = (OSError, ValueError, KeyError, EOFError, BadZipFile)


def fresh(name: str, make: Callable[[], Any]) -> Any:
    """Compute a stage without checkpointing."""
    return make()


def key_of(recording: Recording, settings: Mapping[str, Any]) -> str:
    """Hash all inputs of a result: the recording, the model, settings and versions.

    Checkpoints of an older version of this package or of MuJoCo are recomputed.

    Parameters
    ----------
    recording : Recording
        The recording as read.
    settings : mapping
        Plain values.
    """
    digest = hashlib.sha256()
    digest.update(
        json.dumps([_FORMAT, _versions(), settings], sort_keys=True, default=str).encode()
    )
    files = [recording.folder / "recording.json", *sorted(files_of(recording.model_path))]
    files += [recording.folder / run.name for run in recording.runs]
    for file in files:
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{file.name} {content}\n".encode())
    return digest.hexdigest()


def _versions() -> dict[str, str]:
    """Versions of the packages that compute the stages."""
    try:
        own = version("loose-env")
    except PackageNotFoundError:  # run from its sources
        own = ""
    return {"loose-env": own, "mujoco": mujoco.__version__}


class Stages:
    """Checkpoints the results of stages; an existing stage is not recomputed.

    Parameters
    ----------
    folder : Path
        Folder of the checkpoint files.
    key : str
        Hash of the inputs, as of `key_of`; files of another key are recomputed.

    Examples
    --------
    >>> import tempfile
    >>> made = []
    >>> def costly():
    ...     made.append(1)
    ...     return {"free": np.arange(3.0), "names": ["a"]}
    >>> with tempfile.TemporaryDirectory() as place:
    ...     first = Stages(Path(place), "k")("fit", costly)
    ...     again = Stages(Path(place), "k")("fit", costly)
    ...     other = Stages(Path(place), "l")("fit", costly)
    >>> len(made), again
    (2, {'free': array([0., 1., 2.]), 'names': ['a']})
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.folder, self.key = folder, key
        self.taken_up: list[str] = []
        """Stages that were there already."""

    def __call__(self, name: str, make: Callable[[], Any]) -> Any:
        """Return a stage, computed now or in an earlier run."""
        file = self._file(name)
        try:
            found = _read(file, self.key)
        except _BROKEN:  # truncated, of another version, or of other data
            pass
        else:
            self.taken_up.append(name)
            return found
        made = make()
        arrays: list[NDArray[Any]] = []
        tree = {"key": self.key, "tree": _taken_apart(made, arrays, name)}
        text = np.frombuffer(json.dumps(tree).encode("utf-8"), dtype=np.uint8)

        named: dict[str, Any] = {"tree": text} | {f"a{k}": a for k, a in enumerate(arrays)}

        def write(beside: Path) -> None:
            with beside.open("wb") as target:
                np.savez(target, **named)
                target.flush()
                os.fsync(target.fileno())

        written_beside(file, write)
        return made

    def _file(self, name: str) -> Path:
        safe = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
        if safe != name:  # two names never share a file
            safe += "-" + hashlib.sha256(name.encode()).hexdigest()[:8]
        return self.folder / f"{safe}.npz"


def _read(file: Path, key: str) -> Any:
    with file.open("rb") as source, np.load(source, allow_pickle=False) as stored:
        tree = json.loads(bytes(stored["tree"]).decode("utf-8"))
        if tree["key"] != key:
            raise KeyError("made from other data or with other settings")
        return _put_together(tree["tree"], stored)


def _taken_apart(value: Any, arrays: list[NDArray[Any]], place: str) -> Any:
    """Convert a tree to JSON values, with arrays replaced by their index."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufc":
            raise InvalidSetting(f"stage {place!r} returns an array of {value.dtype}, not numbers")
        arrays.append(value)
        return {_ARRAY: len(arrays) - 1}
    if isinstance(value, dict):
        if not all(isinstance(k, str) and k not in (_ARRAY, _NUMBER) for k in value):
            raise InvalidSetting(
                f"stage {place!r} returns a dictionary with keys that are no names"
            )
        return {k: _taken_apart(v, arrays, f"{place}.{k}") for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_taken_apart(v, arrays, place) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return {_NUMBER: repr(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InvalidSetting(
        f"stage {place!r} returns {type(value).__name__}; it may return plain values, arrays of "
        "numbers, lists and dictionaries"
    )


def _put_together(value: Any, stored: Mapping[str, NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        if _ARRAY in value:
            return stored[f"a{value[_ARRAY]}"]
        if _NUMBER in value:
            return float(value[_NUMBER])
        return {k: _put_together(v, stored) for k, v in value.items()}
    if isinstance(value, list):
        return [_put_together(v, stored) for v in value]
    return value
