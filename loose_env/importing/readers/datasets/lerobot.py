"""Channels of a LeRobot dataset, versions 2.0, 2.1 and 3.0, read by episode and listed."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.readers.datasets.vector_entry import (
    as_matrix,
    entry_index,
    split_channel,
    usable_labels,
    vector_channels,
)
from loose_env.importing.samples import (
    ChannelKey,
    FileList,
    Samples,
    Stream,
    checked,
    file_within,
)
from loose_env.recording import MOST_VALUES, nearest, read_text
from loose_env.typing import Array

INFO = "meta/info.json"
"""File that makes a folder a LeRobot dataset."""
UNITS = (
    "a LeRobot dataset does not say the unit of its states and actions, which depends on the "
    "robot's settings: unit = 'deg', unit = 'rad', or, where they are normalised to -100..100, "
    "unit = 'rad' with scale = (upper - lower) / 200 and offset = (upper + lower) / 2 of the "
    "calibrated range [rad]; 'loose import --guess' proposes one"
)
"""The choices of unit for a column, as the error for a missing one gives them."""

_MOST_BYTES = 2**28
_VERSIONS = {"v2.0": 2, "v2.1": 2, "v3.0": 3}
_FIELD = re.compile(r"\{(\w+)(?::0(\d)d)?\}")
_NUMBERS = re.compile(r"(float|int|uint)\d+|bool")
_PER_FILE = ("episode_index", "data/chunk_index", "data/file_index", "length")


@dataclass(frozen=True)
class _Feature:
    """A feature of each frame: its number of values and their names."""

    width: int
    labels: tuple[str, ...]


@dataclass(frozen=True)
class _Episode:
    number: int
    file: str
    """Path of its table in the dataset."""
    length: int

    @property
    def name(self) -> str:
        return f"episode_{self.number:06d}"


@dataclass(frozen=True)
class _Dataset:
    folder: Path
    name: str
    version: str
    fps: float
    robot: str
    features: dict[str, _Feature]
    episodes: tuple[_Episode, ...]


def lerobot_episodes(folder: Path, name: str) -> tuple[str, ...]:
    """Names of the episodes of a dataset; errors as `read_lerobot`."""
    return tuple(each.name for each in _dataset(folder, name).episodes)


def read_lerobot(
    folder: Path,
    name: str,
    keys: Sequence[ChannelKey],
    episodes: Sequence[str],
    time: TimeSource,
) -> dict[tuple[str, ChannelKey], Samples]:
    """Read channels of episodes; each table is read once, with the columns asked for."""
    data = _dataset(folder, name)
    chosen: dict[ChannelKey, tuple[str, int]] = {}
    for key in keys:
        chosen[key] = _chosen(data, key)
    stamps = time.column or "timestamp"
    columns = list(dict.fromkeys(feature for feature, _ in chosen.values()))
    if time.rate_hz is None:
        columns = list(dict.fromkeys([*columns, stamps]))
    wanted = [each for each in data.episodes if each.name in set(episodes)]
    found: dict[tuple[str, ChannelKey], Samples] = {}
    for file in dict.fromkeys(each.file for each in wanted):
        place = f"{name}/{file}"
        table = _table(file_within(folder, file, f"{name}/{INFO}: data_path"), place, columns)
        numbers = table.pop("episode_index")[:, 0]
        for episode in (each for each in wanted if each.file == file):
            rows = np.flatnonzero(numbers == episode.number)
            own = f"{place}: {episode.name}"
            if len(rows) < 2:
                raise InvalidData(
                    f"{own}: it has {len(rows)} frames; choose others by episodes of the run, such "
                    "as episodes = '0, 2-5'"
                )
            if episode.length not in (-1, len(rows)):
                raise InvalidData(
                    f"{own}: {len(rows)} frames, and meta/ says {episode.length}; the dataset is "
                    "incomplete, download it again"
                )
            for key, (feature, entry) in chosen.items():
                at = (
                    np.arange(len(rows)) / time.rate_hz
                    if time.rate_hz is not None
                    else _exact(table[stamps][rows, 0], data.fps)
                )
                values = table[feature]
                if entry >= values.shape[1]:
                    raise InvalidData(
                        f"{place}: {feature!r} has {values.shape[1]} entries, and {INFO} says "
                        f"{data.features[feature].width}"
                    )
                found[episode.name, key] = checked(
                    f"{own}, channel {key.channel!r}", at, values[rows, entry], row_word="frame"
                )
    return found


def list_lerobot(folder: Path, name: str) -> FileList:
    """List the channels of a dataset by its first episode; errors as `read_lerobot`."""
    data = _dataset(folder, name)
    first = data.episodes[0]
    place = f"{name}/{first.file}"
    file = file_within(folder, first.file, f"{name}/{INFO}: data_path")
    features = list(data.features)
    table = _table(file, place, features)
    rows = np.flatnonzero(table["episode_index"][:, 0] == first.number)
    channels = []
    for each in features:
        if each not in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
            own = data.features[each]
            labels = own.labels if table[each].shape[1] == own.width else ()
            channels += vector_channels(each, table[each][rows], labels)
    count = len(data.episodes)
    stream = Stream(
        kind=f"{count} episode{'s' if count > 1 else ''}, robot {data.robot or 'unknown'}",
        samples=len(rows),
        seconds=(len(rows) - 1) / data.fps,
        channels=tuple(channels),
        note="every column needs a unit: deg, rad, or normalised values by scale and offset",
    )
    return FileList(
        name=name,
        kind="lerobot",
        words=f"LeRobot dataset {data.version}",
        streams=(stream,),
        episodes=tuple(each.name for each in data.episodes),
    )


def _dataset(folder: Path, name: str) -> _Dataset:
    place = f"{name}/{INFO}"
    path = folder / INFO
    if not path.is_file():
        raise InvalidData(f"{place}: there is no such file; a LeRobot dataset has one")
    info = _json(read_text(path, place, _MOST_BYTES), place)
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
    template = info.get("data_path")
    if not isinstance(template, str):
        raise InvalidData(f"{place}: data_path is missing, which says where the tables are")
    if _VERSIONS[version] == 2:
        episodes = _episodes_v2(folder, name, template, info.get("chunks_size", 1000))
    else:
        episodes = _episodes_v3(folder, name, template)
    if not episodes:
        raise InvalidData(f"{name}: the dataset has no episodes")
    return _Dataset(
        folder=folder,
        name=name,
        version=version,
        fps=float(fps),
        robot=str(info.get("robot_type") or "")[:40],
        features=_features(info.get("features"), place),
        episodes=tuple(sorted(episodes, key=lambda each: each.number)),
    )


def _features(given: Any, place: str) -> dict[str, _Feature]:
    """Features that are one number or a vector of them; images and texts are passed over."""
    if not isinstance(given, dict) or not given:
        raise InvalidData(f"{place}: features is missing, which says what a frame holds")
    found = {}
    for key, each in given.items():
        shape = each.get("shape") if isinstance(each, dict) else None
        if not isinstance(shape, list) or len(shape) != 1 or not isinstance(shape[0], int):
            continue
        if _NUMBERS.fullmatch(str(each.get("dtype"))) and shape[0] > 0:
            found[key] = _Feature(shape[0], usable_labels(each.get("names"), shape[0]))
    return found


def _episodes_v2(folder: Path, name: str, template: str, chunk: Any) -> list[_Episode]:
    place = f"{name}/meta/episodes.jsonl"
    if not isinstance(chunk, int) or chunk < 1:
        raise InvalidData(f"{name}/{INFO}: chunks_size is {chunk!r:.40}, no number of episodes")
    path = folder / "meta" / "episodes.jsonl"
    if not path.is_file():
        raise InvalidData(f"{place}: there is no such file; a dataset of version 2 has one")
    found = []
    for i, line in enumerate(read_text(path, place, _MOST_BYTES).splitlines(), 1):
        if not line.strip():
            continue
        each = _json(line, f"{place}: line {i}")
        number = each.get("episode_index") if isinstance(each, dict) else None
        if not isinstance(number, int) or number < 0:
            raise InvalidData(f"{place}: line {i}: it has no episode_index")
        length = each.get("length", -1)
        values = {"episode_index": number, "episode_chunk": number // chunk}
        file = _filled(template, values, f"{name}/{INFO}")
        found.append(_Episode(number, file, length if isinstance(length, int) else -1))
    return found


def _episodes_v3(folder: Path, name: str, template: str) -> list[_Episode]:
    files = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    if not files:
        raise InvalidData(
            f"{name}/meta/episodes: there are no Parquet files; a dataset of version 3 has them"
        )
    found = []
    for path in files:
        place = f"{name}/{path.relative_to(folder).as_posix()}"
        table = _table(path, place, list(_PER_FILE))
        for number, chunk, file, length in zip(*(table[c][:, 0] for c in _PER_FILE), strict=True):
            if not all(np.isfinite((number, chunk, file, length))):
                raise InvalidData(f"{place}: a value of {', '.join(_PER_FILE)} is missing")
            values = {"chunk_index": int(chunk), "file_index": int(file)}
            own = _filled(template, values, f"{name}/{INFO}")
            found.append(_Episode(int(number), own, int(length)))
    return found


def _filled(template: str, values: dict[str, int], place: str) -> str:
    """Path of a template such as ``data/file-{file_index:03d}.parquet``."""

    def one(found: re.Match[str]) -> str:
        key, digits = found.groups()
        if key not in values:
            raise InvalidData(f"{place}: data_path names {key[:40]!r}; known are {list(values)}")
        return f"{values[key]:0{int(digits or 1)}d}"

    return _FIELD.sub(one, template)


def _exact(stamps: Array, fps: float) -> Array:
    """Times of frames; those that are whole frames rounded to float32 are taken without rounding.

    At ten minutes the rounding is 0.03 ms, which would make even frames uneven.
    """
    frames = np.round(stamps * fps) / fps
    rounding = np.finfo(np.float32).eps * np.maximum(np.abs(stamps), 1.0)
    return frames if np.all(np.abs(frames - stamps) <= rounding) else stamps


def _chosen(data: _Dataset, key: ChannelKey) -> tuple[str, int]:
    place = f"{data.name}: channel {key.channel!r}"
    if key.topic:
        raise InvalidData(f"{place}: a LeRobot dataset has no topics; leave out topic")
    feature, entry = split_channel(key.channel, data.name)
    if feature not in data.features:
        raise InvalidData(
            f"{place}: there is no feature {feature[:60]!r} of numbers; there are "
            f"{', '.join(map(repr, data.features))[:600]}{nearest(feature, list(data.features))}"
        )
    own = data.features[feature]
    return feature, entry_index(entry, own.width, own.labels, place)


def _table(path: Path, place: str, columns: Sequence[str]) -> dict[str, Array]:
    """Columns of a Parquet table by name, and ``episode_index``, each of shape (T, N)."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    wanted = list(dict.fromkeys([*columns, "episode_index"]))
    try:
        with pq.ParquetFile(path) as file:
            there, rows = file.schema_arrow.names, file.metadata.num_rows
            missing = [each for each in wanted if each not in there]
            table = None if missing else file.read(columns=wanted, use_threads=False)
    except Exception as error:  # pyarrow raises OSError, ValueError and its own
        words = " ".join(str(error).split())[:100]
        raise InvalidData(
            f"{place}: no whole Parquet file, cut short or damaged ({words}); download it again"
        ) from None
    if table is None:
        raise InvalidData(
            f"{place}: there is no column {missing[0]!r}; there are "
            f"{', '.join(map(repr, there))[:600]}"
        )
    found = {}
    for each in wanted:
        column = table.column(each)
        own = f"{place}: column {each!r}"
        if hasattr(column.type, "value_type"):
            widths = set(pc.list_value_length(column).unique().to_pylist())
            if len(widths) > 1 or None in widths:
                raise InvalidData(f"{own}: its vectors are not all of one length")
            flat = pc.list_flatten(column)
            width = next(iter(widths), 1)
        else:
            flat, width = column, 1
        if len(flat) > MOST_VALUES:
            raise InvalidData(f"{own}: more than {MOST_VALUES} values; take fewer episodes a file")
        values = as_matrix(flat.to_numpy(), own)
        if len(values) != rows * width:
            raise InvalidData(f"{own}: {len(values)} values in {rows} rows of {width}")
        found[each] = values.reshape(rows, width)
    return found


def _json(text: str, place: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"{place}: not JSON: {str(error)[:120]}") from None
