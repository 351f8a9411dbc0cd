"""LeRobot datasets, versions 2.0, 2.1 and 3.0, read by episode."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.importing.array_files import parquet_columns, vector_columns
from loose_env.importing.samples import ChannelKey, Log, Table, damaged
from loose_env.recording import read_text
from loose_env.typing import Array

INFO = "meta/info.json"
"""File that makes a folder a LeRobot dataset."""
_UNITS = (
    "a LeRobot dataset does not say the unit of its states and actions, which depends on the "
    "robot's settings: unit = 'deg', unit = 'rad', or, where they are normalised to -100..100, "
    "unit = 'rad' with scale = (upper - lower) / 200 and offset = (upper + lower) / 2 of the "
    "calibrated range [rad]; 'loose import --guess' proposes one"
)

_MOST_BYTES = 2**28
_VERSIONS = ("v2.0", "v2.1", "v3.0")
_INDICES = ("episode_index", "frame_index", "index", "task_index")
_NORMALISED = ("gripper",)
"""Joints that the drivers of lerobot normalise to 0..100 whatever the others' unit."""


def open_lerobot(folder: Path, name: str) -> Log:
    """Open a dataset: its tables say which episodes it has, whatever is missing of ``meta``."""
    info = _info(folder, name)
    files = sorted((folder / "data").glob("*/*.parquet"))
    if not files:
        raise InvalidData(
            f"{name}/data: there are no Parquet files; download the dataset again, with its data"
        )
    where: dict[int, Path] = {}
    for path in files:
        numbers = _read(path, f"{name}/{path.relative_to(folder).as_posix()}", ("episode_index",))
        where |= dict.fromkeys(np.unique(numbers["episode_index"]).astype(int).tolist(), path)
    names = {f"episode_{number:06d}": number for number in sorted(where)}
    told = info.get("total_episodes")
    lacking = isinstance(told, int) and told != len(names)
    words = f"{name}: {len(names)} episodes are there, and {INFO} says {told}" if lacking else ""

    @lru_cache(maxsize=2)
    def whole(path: Path) -> dict[str, Array]:
        return _read(path, f"{name}/{path.relative_to(folder).as_posix()}", None)

    def tables(episode: str, _: Sequence[ChannelKey] | None) -> list[Table]:
        path = where[names[episode]]
        place = f"{name}/{path.relative_to(folder).as_posix()}: {episode}"
        return [_table(whole(path), names[episode], place, info, (words,) if words else ())]

    return Log(name=name, tables=tables, episodes=tuple(names), ambiguous=_UNITS)


def _info(folder: Path, name: str) -> dict[str, Any]:
    place = f"{name}/{INFO}"
    if not (folder / INFO).is_file():
        raise InvalidData(
            f"{place}: there is no such file, which says the rate and the names; download the "
            "dataset again, with its meta"
        )
    try:
        info = json.loads(read_text(folder / INFO, place, _MOST_BYTES))
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"{place}: not JSON: {str(error)[:120]}") from None
    if not isinstance(info, dict):
        raise InvalidData(f"{place}: it is no table of keys")
    version = str(info.get("codebase_version"))
    if version not in _VERSIONS:
        raise InvalidData(
            f"{place}: codebase_version is {version[:40]!r}; read are {', '.join(_VERSIONS)}; "
            "scripts of lerobot convert between versions"
        )
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, (int, float)) or not 0 < fps < 1e6:
        raise InvalidData(f"{place}: fps is {fps!r:.40}; it is the rate of the frames [Hz]")
    if not isinstance(info.get("features"), dict):
        info["features"] = {}
    return info


def _table(whole: dict[str, Array], number: int, place: str, info: dict[str, Any],
           done: tuple[str, ...]) -> Table:  # fmt: skip
    """Frames of one episode."""
    rows = np.flatnonzero(whole["episode_index"][:, 0] == number)
    if len(rows) < 2:
        raise InvalidData(
            f"{place}: it has {len(rows)} frames; choose others by episodes of the run, such as "
            "episodes = '0, 2-5'"
        )
    columns: dict[str, NDArray[Any]] = {}
    for key, values in whole.items():
        if key not in _INDICES:
            feature = info["features"].get(key)
            named = feature.get("names") if isinstance(feature, dict) else None
            columns |= vector_columns(key, values[rows], _labels(named, values.shape[1]))
    units = {name: "%" for name in columns if any(w in name.lower() for w in _NORMALISED)}
    fps = float(info["fps"])
    times = np.arange(len(rows)) / fps
    if "timestamp" in columns:
        stored = columns["timestamp"]
        digits = float(np.spacing(np.float32(np.max(np.abs(stored)))))
        if digits > 0.5 / fps:
            done = (
                *done,
                f"{place}: its timestamps are float32 of {stored[0]:.10g} s, which has steps of "
                f"{digits:.3g} s; the frames are taken at {fps:g} Hz instead",
            )
            columns["timestamp"] = times
        else:
            columns["timestamp"] = _exact(stored, fps)
    else:
        columns["timestamp"] = times
    return Table(place=place, columns=columns, units=units, row_word="frame", done=done,
                 time="timestamp")  # fmt: skip


def _exact(stamps: Array, fps: float) -> Array:
    """Times of frames; those that are whole frames rounded to float32 are taken without rounding.

    At ten minutes the rounding is 0.03 ms, which would make even frames uneven.
    """
    frames = np.round(stamps * fps) / fps
    rounding = np.finfo(np.float32).eps * np.maximum(np.abs(stamps), 1.0)
    return frames if np.all(np.abs(frames - stamps) <= rounding) else stamps


def _labels(names: Any, width: int) -> tuple[str, ...]:
    """Names of the entries of a vector, a list or a table that holds one; else none.

    Examples
    --------
    >>> _labels({"motors": ["hip", "knee"]}, 2), _labels(["state"], 2)
    (('hip', 'knee'), ())
    """
    if isinstance(names, dict):
        inside = [_labels(each, width) for each in names.values()]
        if any(inside):
            return next(filter(None, inside))
        names = list(names)  # names as keys, numbers as values
    if not isinstance(names, list) or len(names) != width or len(set(map(str, names))) < width:
        return ()
    plain = all(
        isinstance(n, str) and n.isprintable() and n and not set(n) & set("[]") for n in names
    )
    return tuple(names) if plain else ()


def _read(path: Path, place: str, columns: Sequence[str] | None) -> dict[str, Array]:
    """Columns of numbers of a Parquet table, each of shape (T, N)."""
    try:
        found = parquet_columns(path, columns)
    except Exception as error:  # pyarrow raises OSError, ValueError and its own
        raise damaged(place, "Parquet file", error, "; download it again") from None
    if "episode_index" not in found:
        raise InvalidData(f"{place}: there is no column 'episode_index'; it is no LeRobot table")
    return {
        key: np.asarray(values.reshape(len(values), -1), dtype=np.float64)
        for key, values in found.items()
    }
