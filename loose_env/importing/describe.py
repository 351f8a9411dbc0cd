"""Channels of files listed, and written as a mapping file to fill in."""

from __future__ import annotations

import re
import time
from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.clocks import chosen_time, named_times, samples_of, time_line
from loose_env.importing.mapping import (
    MAPPING_FORMAT,
    TimeSource,
    channel_keys,
    printable,
    quoted,
)
from loose_env.importing.reading import given_files, open_log
from loose_env.importing.samples import ChannelKey, Log, Table
from loose_env.importing.units import column_quantity
from loose_env.recording import ModelColumns, joint_sensors

_WIDE = 300
_UNKNOWN = "sensor.?"
_OF_JOINT = re.compile(r"(position|velocity|effort)\[(.+)\]")
_DOWN = re.compile(r"\d+-R?[XYZ]")
_MOST_LISTED = 500
"""Channels listed of one topic."""


class Channel(NamedTuple):
    """One channel."""

    key: ChannelKey
    first: tuple[float, ...]
    """First values, as the file holds them."""
    unit: str
    """Unit that the file itself gives."""
    words: str
    """Further description in the file."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Table of a file, and when it was recorded."""

    table: Table
    start_ns: int | None = None
    """First sample [ns since 1970], where the file knows the date."""
    seconds: float | None = None
    """From the first to the last sample [s], where that is known."""

    @property
    def samples(self) -> int:
        """Number of rows."""
        return len(self.table) if self.table.columns else 0

    @property
    def rate_hz(self) -> float | None:
        """Mean rate [Hz]."""
        return (self.samples - 1) / self.seconds if self.seconds and self.samples > 1 else None

    @property
    def channels(self) -> list[Channel]:
        """Channels of the table."""
        own = self.table
        return [
            Channel(
                ChannelKey(name, own.topic),
                tuple(np.asarray(own.columns.get(name, ())[:3], dtype=float).tolist()),
                own.units.get(name, ""),
                own.words.get(name, ""),
            )
            for name in [*own.columns, *own.texts][:_MOST_LISTED]
        ]


@dataclass(frozen=True, kw_only=True)
class FileList:
    """One file."""

    log: Log
    streams: tuple[Stream, ...]
    options: tuple[str, ...]
    """Lines of a mapping that say how to read it."""


def describe_sources(sources: Sequence[str], model: mujoco.MjModel | None = None) -> str:
    r"""Describe files as a mapping file: known entries as TOML, channels as comments.

    Every channel is a line to be uncommented; in it ``sensor.?`` is to be replaced by a column of
    the model. The text reads as TOML as it stands.

    Parameters
    ----------
    sources : sequence of str
        Files, or ``NAME=PATH``.
    model : mujoco.MjModel, optional
        The model, whose columns are listed too.

    Raises
    ------
    InvalidData
        If a file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = Path(folder, "daq.csv")
    ...     _ = log.write_text("time [s],elbow [rad]\n0.0,0.10\n0.1,0.12\n0.2,0.15\n")
    ...     "elbow" in describe_sources([str(log)])
    True
    """
    lists = list_sources(sources)
    lines = [f"format = {quoted(MAPPING_FORMAT)}", 'model = "model.xml"  # MJCF, beside this file']
    if model is not None:
        lines += ["", "# Columns that the model allows:"]
        for column in ModelColumns.of(model).known:
            quantity = column_quantity(model, column)
            lines.append(f"#   {quoted(column)}{f'  {quantity}' if quantity else ''}")
    for name, each in lists.items():
        lines += ["", f"[sources.{name}]", f"file = {quoted(each.log.name)}"]
        lines.append(f'kind = "{each.log.kind}"')
        lines += each.options
    lines += [
        "",
        "# Columns of all runs; a run's own [runs.columns] come on top. Take the mark off",
    ]
    lines += ["# the lines that are wanted, and put the model's column in the place of sensor.?"]
    lines += ["[columns]"]
    for name, each in lists.items():
        for stream in each.streams:
            lines += _stream_lines(name, each, stream, model)
    lines += [
        "",
        "[[runs]]",
        'file = "run-01"',
        'condition = "suspect"  # or "healthy", a reference taken before the fault',
        '# excited = ["joint1"]',
        '# pose = "measured"  # or { joint1 = 0.1, joint2 = "30 deg" }',
        "# start = 0.0  # [s] after the first time that all columns have, or a date",
        "# stop = 10.0",
        "# rate_hz = 1000  # rows as the samples of the fastest channel without it",
    ]
    return "\n".join(lines) + "\n"


def list_sources(sources: Sequence[str]) -> dict[str, FileList]:
    """List the channels of files, by the names that a mapping may give the files.

    Parameters
    ----------
    sources : sequence of str
        Files, or ``NAME=PATH``.

    Returns
    -------
    dict of str to FileList
        Name of the source -> its streams and channels.

    Raises
    ------
    InvalidData
        If a file cannot be read.
    """
    lists: dict[str, FileList] = {}
    for given, path in given_files(sources).items():
        lists[source_name(given, lists)] = _listed(open_log(path))
    return lists


def _listed(log: Log) -> FileList:
    streams, options = [], list(log.options)
    for table in log.first():
        offered = named_times(table)
        time, words = offered[0] if offered else TimeSource(), ""
        try:
            if offered:
                time, words = chosen_time(table)
        except InvalidData as error:
            words = str(error)
        if log.kind in ("csv", "arrays", "hdf5") and not any("time =" in line for line in options):
            none = (
                "# no column of time was found; name it, or give the recorder's rate: "
                "time = { rate_hz = ... } [Hz]"
            )
            options.append(time_line(time, printable(words)) if offered else none)
        streams.append(_stream(table, time))
    return FileList(log=log, streams=tuple(streams), options=tuple(options))


def _stream(table: Table, time: TimeSource) -> Stream:
    """Table with its beginning and length, where its time can be read."""
    for name in [n for n in table.columns if n != time.column][:1]:
        try:
            own = samples_of(table, name, time)
        except InvalidData:
            continue
        start = own.origin_ns if own.origin_ns > 10**17 else None
        return Stream(table=table, start_ns=start, seconds=float(own.time[-1] - own.time[0]))
    return Stream(table=table)


def _stream_lines(
    name: str, file: FileList, stream: Stream, model: mujoco.MjModel | None
) -> list[str]:
    about = [printable(stream.table.topic), printable(stream.table.kind)]
    if stream.samples:
        about.append(f"{stream.samples} samples")
    if stream.rate_hz is not None:
        about.append(f"{stream.rate_hz:.6g} Hz over {stream.seconds:.3f} s")
    if stream.start_ns is not None:
        about.append(f"from {_date(stream.start_ns)}")
    about.append(printable(stream.table.note))
    lines = ["", f"# {file.log.words}: {', '.join(filter(None, about))}"[:_WIDE]]
    for channel in stream.channels:
        lines.append("# " + _channel_line(name, channel, _likely(channel, model)))
    return lines


def _likely(channel: Channel, model: mujoco.MjModel | None) -> str:
    """Column of the model that a channel means by its name, or one to be replaced."""
    if model is None:
        return _UNKNOWN
    words = channel.key.channel
    if words in ModelColumns.of(model).known:
        return words
    found = _OF_JOINT.fullmatch(words)
    joints = joint_sensors(model)
    if found is None or found.group(2) not in joints:
        return _UNKNOWN
    kind, joint = found.groups()
    own = joints[joint]
    if kind == "effort":
        return f"torque.{joint}"
    sensors = own.position if kind == "position" else own.velocity
    return f"sensor.{sensors[0]}" if sensors else _UNKNOWN


def _channel_line(name: str, channel: Channel, column: str) -> str:
    parts = channel_keys(name, channel.key)
    if channel.unit:
        parts.append(f"unit = {quoted(channel.unit)}")
    if _DOWN.fullmatch(channel.key.channel):
        parts.append("sign = -1")  # the recorder counts it against the axis
    seen = ", ".join(f"{value:.6g}" for value in channel.first)
    note = "; ".join(filter(None, (seen, printable(channel.words))))
    return f"{quoted(column)} = {{ {', '.join(parts)} }}{f'  # {note}' if note else ''}"


def source_name(given: str, taken: Container[str]) -> str:
    """Name of a source from that of its file."""
    stem = Path(given).stem
    plain = "".join(c if (c.isascii() and c.isalnum()) or c in "-_" else "-" for c in stem)
    name = first = plain.strip("-_") or "source"
    count = 2
    while name in taken:  # run-01.mcap and run-01.csv
        name, count = f"{first}-{count}", count + 1
    return name


def _date(ns: int) -> str:
    try:
        whole = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(ns // 10**9))
    except (OverflowError, ValueError, OSError):
        return f"{ns} ns"
    return f"{whole}.{ns % 10**9:09d}Z"
