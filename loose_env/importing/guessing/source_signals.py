"""Channels of log files read with their signals for a proposal; those that it leaves over."""

from __future__ import annotations

import tomllib
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.describe import list_sources
from loose_env.importing.guessing.channel_names import meaning_of
from loose_env.importing.guessing.roles import Candidate
from loose_env.importing.guessing.signals import on_one_base
from loose_env.importing.mapping.mapping import SourceEntry, TimeSource
from loose_env.importing.mapping.mapping_file import source_of
from loose_env.importing.readers.csv_list import quoted, time_unit
from loose_env.importing.readers.sources import given_files, read_source
from loose_env.importing.samples import Channel, ChannelKey, FileList, Samples
from loose_env.typing import Array

_MOST_CHANNELS = 500
_JITTER = 0.2
"""Part of the median step by which most steps of a column of times may differ [1]."""


@dataclass(frozen=True)
class LogSource:
    """A file, and the lines of a mapping that say how to read it."""

    file: FileList
    lines: tuple[str, ...]
    time: str
    """Column of its times; "" where it has none."""


def read_signals(
    sources: Sequence[str], rate_hz: float | None
) -> tuple[dict[str, LogSource], list[Candidate], float, list[str]]:
    """Read all channels of files, of the first episode where they have some."""
    logs: dict[str, LogSource] = {}
    samples: dict[str, Samples] = {}
    found: list[tuple[str, ChannelKey, str]] = []
    notes: list[str] = []
    paths = given_files(sources).values()
    for (name, file), path in zip(list_sources(sources).items(), paths, strict=True):
        entry, lines = _entry(name, file, path, rate_hz)
        logs[name] = LogSource(file, lines, entry.time.column)
        for topic in dict.fromkeys(stream.topic for stream in file.streams):
            channels = [c for s in file.streams if s.topic == topic for c in s.channels if c.first]
            channels = [c for c in channels if c.key.channel != entry.time.column]
            if len(channels) > _MOST_CHANNELS:
                notes.append(f"{file.name} {topic}: only its first {_MOST_CHANNELS} channels")
                channels = channels[:_MOST_CHANNELS]
            try:
                own = read_source(path, entry, [c.key for c in channels], file.episodes[:1])
            except InvalidData as error:
                if len(file.streams) == 1:
                    raise
                notes.append(f"not read: {error}")
                continue
            for channel in channels:
                each = own[file.episodes[0] if file.episodes else "", channel.key]
                key = f"{len(found)}"
                samples[key] = each
                found.append((name, channel.key, each.unit or channel.unit))
    meanings = {str(i): meaning_of(key) for i, (_, key, _) in enumerate(found)}
    usable = {k: s for k, s in samples.items() if meanings[k].role != "other"}
    step, signals = on_one_base(usable)
    if not signals:
        raise InvalidData(
            f"{', '.join(sources)}: no channels of numbers that have 10 samples in common; give "
            "one file of a motion"
        )
    candidates = [
        Candidate(source=name, key=key, unit=unit, meaning=meanings[str(i)], values=signals[str(i)])
        for i, (name, key, unit) in enumerate(found)
        if str(i) in signals
    ]
    return logs, candidates, step, notes


def other_channels(
    logs: Mapping[str, LogSource], taken: Container[tuple[str, ChannelKey]]
) -> tuple[tuple[str, Channel], ...]:
    """Sources and channels that are neither times nor taken."""
    return tuple(
        (name, channel)
        for name, log in logs.items()
        for stream in log.file.streams
        for channel in stream.channels
        if (name, channel.key) not in taken and channel.key.channel != log.time
    )


def _entry(
    name: str, file: FileList, path: Path, rate_hz: float | None
) -> tuple[SourceEntry, tuple[str, ...]]:
    """Entry of a source, and its lines; its times are found in the file where it names none."""
    lines = [f"file = {quoted(file.name)}", f'kind = "{file.kind}"', *file.options]
    if rate_hz is not None:
        lines = [line for line in lines if not line.lstrip("# ").startswith("time =")]
        lines.append(f"time = {{ rate_hz = {rate_hz:.12g} }}")
    entry = source_of(file.name, name, tomllib.loads("\n".join(lines)))
    if file.kind in ("csv", "hdf5") and not entry.time.column and entry.time.rate_hz is None:
        lines = [line for line in lines if not line.lstrip("# ").startswith(("time", "no column"))]
        column, unit = _time_column(file, path, entry)
        if not column:
            raise InvalidData(
                f"{file.name}: its times are not known: no column advances in even steps; give "
                "the sampling rate by --rate-hz, or a mapping with time = { column = ... }"
            )
        lines.append(
            f'time = {{ column = {quoted(column)}, unit = "{unit}" }}  # even steps, {unit} by '
            "their size"
        )
        entry = replace(entry, time=TimeSource(column=column, unit=unit))
    return entry, tuple(lines)


def _time_column(file: FileList, path: Path, entry: SourceEntry) -> tuple[str, str]:
    """Name and unit of the first column that advances in even steps and is no count of rows."""
    keys = [c.key for stream in file.streams for c in stream.channels if c.first]
    trial = replace(entry, time=TimeSource(rate_hz=1.0))
    own = read_source(path, trial, keys, file.episodes[:1])
    for key in keys:
        values: Array = own[file.episodes[0] if file.episodes else "", key].values
        steps = np.diff(values)
        if not np.all(steps > 0):
            continue
        step = float(np.median(steps))
        even = np.mean(np.abs(steps - step) <= _JITTER * step) > 0.5
        if even and not np.all(steps == 1):
            return key.channel, time_unit(step)
    return "", ""
