"""Channels of demonstrations in an HDF5 file as robomimic writes it, read and listed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.readers.datasets.vector_entry import (
    as_matrix,
    entry_index,
    split_channel,
    vector_channels,
)
from loose_env.importing.samples import ChannelKey, FileList, Samples, Stream, checked
from loose_env.recording import MOST_VALUES, nearest
from loose_env.typing import Array

_MOST_DATASETS = 1000
_NUMBER = re.compile(r"(\d+)")
_NO_CLOCK = (
    "a demonstration has no times: give the rate of control, time = { rate_hz = ... } [Hz], or "
    "the dataset of times, time = { column = 'obs/time' }"
)


def hdf5_episodes(path: Path, name: str) -> tuple[str, ...]:
    """Names of the demonstrations of a file; errors as `read_hdf5`."""
    with _opened(path, name) as file:
        return tuple(_demos(file, name))


def read_hdf5(
    path: Path,
    name: str,
    keys: Sequence[ChannelKey],
    episodes: Sequence[str],
    time: TimeSource,
) -> dict[tuple[str, ChannelKey], Samples]:
    """Read channels of demonstrations."""
    found: dict[tuple[str, ChannelKey], Samples] = {}
    with _opened(path, name) as file:
        demos = _demos(file, name)
        for episode in episodes:
            place = f"{name}: {episode}"
            for key in keys:
                if key.topic:
                    raise InvalidData(f"{name}: an HDF5 file has no topics; leave out topic")
                dataset, entry = split_channel(key.channel, name)
                own = f"{place}, channel {key.channel!r}"
                values = _values(demos[episode], dataset, own)
                index = entry_index(entry, values.shape[1], (), own)
                at = _times(demos[episode], len(values), time, place)
                found[episode, key] = checked(own, at, values[:, index], row_word="sample")
    return found


def list_hdf5(path: Path, name: str) -> FileList:
    """List the datasets of the first demonstration; errors as `read_hdf5`."""
    with _opened(path, name) as file:
        demos = _demos(file, name)
        demo = next(iter(demos.values()))
        channels, samples = [], 0
        for dataset in _datasets(demo):
            try:
                first = _values(demo, dataset, name, most=3)
            except InvalidData:  # images and the like
                continue
            samples = max(samples, len(demo[dataset]))
            channels += vector_channels(dataset, first)
        rate = _control_rate(file)
    stream = Stream(
        kind=f"{len(demos)} demonstrations",
        samples=samples,
        seconds=(samples - 1) / rate if rate else None,
        channels=tuple(channels),
    )
    option = (
        f"time = {{ rate_hz = {rate:.9g} }}  # control_freq of env_args"
        if rate
        else "# time = { rate_hz = ... }  # [Hz]; the file gives no times"
    )
    return FileList(
        name=name,
        kind="hdf5",
        words="HDF5",
        streams=(stream,),
        options=(option,),
        episodes=tuple(demos),
    )


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Any]:
    try:
        import h5py
    except ImportError:
        raise MissingExtra("HDF5 files need h5py: pip install 'loose-env[import]'") from None
    try:
        with h5py.File(path, "r") as file:
            yield file
    except LooseEnvError:
        raise
    except Exception as error:  # h5py raises OSError, KeyError, RuntimeError on damaged bytes
        words = " ".join(str(error).split())[:120]
        raise InvalidData(f"{name}: no whole HDF5 file, cut short or damaged ({words})") from None


def _demos(file: Any, name: str) -> dict[str, Any]:
    """Groups of ``data`` by their names, in the order of their numbers."""
    data = _own(file, "data")
    if data is None or not hasattr(data, "keys"):
        raise InvalidData(
            f"{name}: it has no group 'data' of demonstrations, data/demo_0 and so on; it has "
            f"{', '.join(map(repr, list(file)[:20])) or 'nothing'}"
        )

    def order(key: str) -> list[tuple[int, str]]:
        return [(int(p), "") if p.isdigit() else (0, p) for p in _NUMBER.split(key)]

    found = {key: _own(data, key) for key in sorted(data, key=order)}
    demos = {key: each for key, each in found.items() if hasattr(each, "keys")}
    if not demos:
        raise InvalidData(f"{name}: the group 'data' has no demonstrations, data/demo_0 and so on")
    return demos


def _own(group: Any, path: str) -> Any:
    """Member of a group that lies in this file; None where there is none.

    Links to other files are not followed: no file is read that the user did not give.
    """
    import h5py

    here = group
    for part in path.split("/"):
        if not isinstance(here, h5py.Group) or not part:
            return None
        if not isinstance(here.get(part, getlink=True), h5py.HardLink):
            return None
        here = here[part]
    return here


def _datasets(demo: Any) -> list[str]:
    """Paths of the datasets of a demonstration, two levels deep at most."""
    found = []
    for key in demo:
        here = _own(demo, key)
        if hasattr(here, "keys"):
            found += [f"{key}/{inner}" for inner in here if hasattr(_own(here, inner), "shape")]
        elif hasattr(here, "shape"):
            found.append(key)
    return found[:_MOST_DATASETS]


def _values(demo: Any, dataset: str, place: str, most: int | None = None) -> Array:
    here = _own(demo, dataset)
    if here is None or not hasattr(here, "shape"):
        there = _datasets(demo)
        raise InvalidData(
            f"{place}: there is no dataset {dataset[:60]!r}; there are "
            f"{', '.join(map(repr, there))[:600] or 'none'}{nearest(dataset, there)}"
        )
    if here.is_virtual or here.external:
        raise InvalidData(f"{place}: its values lie in another file; copy them into this one")
    if len(here.shape) not in (1, 2) or here.dtype.kind not in "fiub":
        raise InvalidData(f"{place}: {here.dtype} of shape {here.shape}; no numbers or vectors")
    if here.size > MOST_VALUES:
        raise InvalidData(f"{place}: {here.size} values; at most {MOST_VALUES} are read")
    if most is None and len(here) < 2:
        raise InvalidData(
            f"{place}: it has {len(here)} samples; choose others by episodes of the run, such as "
            "episodes = '0, 2-5'"
        )
    return as_matrix(here[:most] if most else here[()], place)


def _times(demo: Any, samples: int, time: TimeSource, place: str) -> Array:
    if time.rate_hz is not None:
        return np.arange(samples) / time.rate_hz
    if not time.column:
        raise InvalidData(f"{place}: {_NO_CLOCK}")
    times = _values(demo, time.column, f"{place}, time")[:, 0]
    if len(times) != samples:
        raise InvalidData(f"{place}: {len(times)} times for {samples} samples")
    return times * unit_named(time.unit, f"{place}: time.unit").factor


def _control_rate(file: Any) -> float | None:
    """Rate of control that ``env_args`` gives [Hz], where it does."""
    try:
        kwargs = json.loads(file["data"].attrs["env_args"])["env_kwargs"]
        rate = float(kwargs["control_freq"])
    except (KeyError, TypeError, ValueError, RecursionError):
        return None
    return rate if 0 < rate < 1e6 else None
