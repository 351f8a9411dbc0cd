"""Signals of time series that ``mujoco.sysid`` saves as ``.npz``, read and listed."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.readers.datasets.vector_entry import entry_index, split_channel
from loose_env.importing.samples import Channel, ChannelKey, FileList, Samples, Stream, checked
from loose_env.recording import nearest
from loose_env.typing import Array

_MOST_BYTES = 2**30
_PARTS = ("control", "sensordata", "state")
_WORDS = ("sensor", "observation", "position", "velocity", "activation", "control")
"""Kinds of signals, by the numbers of ``mujoco.sysid.SignalType``."""


@dataclass(frozen=True)
class _Series:
    times: Array
    """Shape (T,)."""
    data: Array
    """Shape (T, N)."""
    signals: dict[str, tuple[str, tuple[int, ...]]]
    """Name of a signal -> kind in words, and its columns."""


def read_sysid(
    path: Path, name: str, keys: Sequence[ChannelKey], time: TimeSource
) -> dict[ChannelKey, Samples]:
    """Read signals of a ``TimeSeries`` or a ``SystemTrajectory``."""
    parts = _parts(path, name)
    found = {}
    for key in keys:
        series = parts.get(key.topic)
        if series is None:
            raise InvalidData(
                f"{name}: channel {key.channel!r}: it has no part {key.topic[:40]!r}; topic is "
                f"one of {', '.join(map(repr, parts))}"
            )
        place = f"{name}: {key}"
        if key.channel.startswith("#") and key.channel[1:].isdigit():
            column = int(key.channel[1:6]) - 1
            if not 0 <= column < series.data.shape[1]:
                raise InvalidData(f"{place}: there are {series.data.shape[1]} columns")
        else:
            signal, entry = split_channel(key.channel, name)
            if signal not in series.signals:
                raise InvalidData(
                    f"{place}: there is no signal {signal[:60]!r}; there are "
                    f"{', '.join(map(repr, series.signals))[:600] or 'numbers only, #1 and so on'}"
                    f"{nearest(signal, list(series.signals))}"
                )
            _, columns = series.signals[signal]
            column = columns[entry_index(entry, len(columns), (), place)]
        at = series.times
        if time.rate_hz is not None:
            at = np.arange(len(at)) / time.rate_hz
        found[key] = checked(place, at, series.data[:, column])
    return found


def list_sysid(path: Path, name: str) -> FileList:
    """List the signals of a file; errors as `read_sysid`."""
    streams = []
    for part, series in _parts(path, name).items():
        channels = []
        named = [
            (f"{signal}[{i}]" if len(columns) > 1 else signal, column, kind)
            for signal, (kind, columns) in series.signals.items()
            for i, column in enumerate(columns)
        ]
        nameless = [(f"#{i + 1}", i, "") for i in range(series.data.shape[1])]
        for words, column, kind in named or nameless:
            first = tuple(series.data[:3, column].tolist())
            channels.append(Channel(key=ChannelKey(words, part), first=first, words=kind))
        streams.append(
            Stream(
                topic=part,
                kind="time series",
                samples=len(series.times),
                seconds=float(series.times[-1] - series.times[0]),
                channels=tuple(channels),
            )
        )
    return FileList(name=name, kind="sysid", words="mujoco.sysid", streams=tuple(streams))


def _parts(path: Path, name: str) -> dict[str, _Series]:
    arrays = _arrays(path, name)
    if "times" in arrays and "data" in arrays:
        return {"": _series(arrays, "", name)}
    found = {p: _series(arrays, f"{p}_", name) for p in _PARTS if f"{p}_times" in arrays}
    if not found:
        raise InvalidData(
            f"{name}: neither a TimeSeries (times, data) nor a SystemTrajectory (control_times, "
            f"sensordata_times) of mujoco.sysid; it has {', '.join(map(repr, list(arrays)[:12]))}"
        )
    return found


def _series(arrays: dict[str, Any], prefix: str, name: str) -> _Series:
    place = f"{name}: {prefix}data"
    times, data = arrays[f"{prefix}times"], arrays.get(f"{prefix}data")
    if data is None:
        raise InvalidData(f"{place} is missing")
    if data.ndim == 1:
        data = data[:, None]
    if times.dtype.kind not in "fiu" or data.dtype.kind not in "fiub":
        raise InvalidData(f"{place}: {data.dtype} at times of {times.dtype}; both are numbers")
    if times.ndim != 1 or data.ndim != 2 or len(times) != len(data) or len(times) < 2:
        raise InvalidData(
            f"{place}: shape {data.shape} at times of shape {times.shape}; a series has one row "
            "for each time, and two at least"
        )
    encoded = arrays.get(f"{prefix}signal_mapping")
    signals: dict[str, tuple[str, tuple[int, ...]]] = {}
    if encoded is not None:
        try:
            for signal, (kind, columns) in json.loads(str(encoded)).items():
                signals[signal] = (_WORDS[kind], tuple(int(c) for c in columns))
        except (ValueError, TypeError, IndexError, AttributeError, RecursionError):
            raise InvalidData(f"{name}: {prefix}signal_mapping is damaged") from None
        if any(not 0 <= c < data.shape[1] for _, own in signals.values() for c in own):
            raise InvalidData(f"{name}: {prefix}signal_mapping names columns that are not there")
    return _Series(times.astype(np.float64), data.astype(np.float64), signals)


def _arrays(path: Path, name: str) -> dict[str, Any]:
    """Arrays of an archive. Their headers are checked before memory is taken for them."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = [each for each in archive.infolist() if each.filename.endswith(".npy")]
            if sum(each.file_size for each in members) > _MOST_BYTES:
                raise InvalidData(f"{name}: more than {_MOST_BYTES} bytes once expanded")
            found = {}
            for each in members:
                with archive.open(each) as file:
                    version = npy.read_magic(file)
                    header = npy.read_array_header_1_0 if version == (1, 0) else None
                    shape, _, kind = (header or npy.read_array_header_2_0)(file)
                if kind.hasobject or kind.itemsize * np.prod(shape, dtype=float) > each.file_size:
                    raise InvalidData(f"{name}: {each.filename} is damaged, or holds objects")
                with archive.open(each) as file:
                    found[each.filename.removesuffix(".npy")] = npy.read_array(file)
    except InvalidData:
        raise
    except Exception as error:  # zipfile, zlib and numpy each raise their own
        words = " ".join(str(error).split())[:100]
        raise InvalidData(f"{name}: no whole .npz file, cut short or damaged ({words})") from None
    return found
