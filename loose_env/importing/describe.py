"""Sources of a mapping: files of one kind, their times, and their channels as lines to fill in."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import gmtime, strftime

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.clocks import chosen_time, named_times, samples_of, time_line
from loose_env.importing.mapping import MAPPING_FORMAT, TimeSource, printable, quoted
from loose_env.importing.reading import given_files, open_log
from loose_env.importing.samples import ChannelKey, Log, Table
from loose_env.importing.units import column_quantity
from loose_env.recording import ModelColumns, joint_sensors

_WIDE = 300
_UNKNOWN = "sensor.?"
_OF_JOINT = re.compile(r"(position|velocity|effort)\[(.+)\]")
_MOST_LISTED = 500
"""Channels listed of one topic."""
_NO_TIME = (
    "# no column of time was found; name it, or give the recorder's rate: time = { rate_hz = ... } "
    "[Hz]"
)
_HEAD = (
    "# Columns of all runs; a run's own [runs.columns] come on top. Take the mark off",
    "# the lines that are wanted, and put the model's column in the place of sensor.?",
    "[columns]",
)
_RUNS = (
    "", "[[runs]]", 'file = "run-01"',
    'condition = "suspect"  # or "healthy", a reference taken before the fault',
    '# excited = ["joint1"]',
    '# pose = "measured"  # or { joint1 = 0.1, joint2 = "30 deg" }',
    "# start = 0.0  # [s] after the first time that all columns have, or a date",
    "# stop = 10.0",
    "# rate_hz = 1000  # rows as the samples of the fastest channel without it",
)  # fmt: skip

LogFile = tuple[str, Path, Log, list[Table]]
"""Name on the command line, path, log, and tables of its first episode."""


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
    def channels(self) -> dict[str, tuple[float, ...]]:
        """Channels of the table, with their first values as the file holds them."""
        own = self.table
        return {
            name: tuple(np.asarray(own.columns.get(name, ())[:3], dtype=float).tolist())
            for name in [*own.columns, *own.texts][:_MOST_LISTED]
        }


@dataclass(eq=False, kw_only=True)
class LogSource:
    """A source of the mapping: files of one kind, one in each run, and how they are read."""

    files: list[LogFile]
    lines: list[str] = field(default_factory=list)
    """Lines of the mapping that say how to read it."""
    times: dict[str, TimeSource] = field(default_factory=dict)
    """Time of each topic."""

    @property
    def log(self) -> Log:
        """The first of its files."""
        return self.files[0][2]

    @property
    def episodes(self) -> int:
        """Number of episodes of all files."""
        return sum(len(log.episodes) for _, _, log, _ in self.files)

    @property
    def streams(self) -> list[Stream]:
        """Tables of the first file, with beginning and length where their times can be read."""
        return [_stream(table, self.times.get(table.topic)) for table in self.files[0][3]]

    def take_times(self, rate_hz: float | None = None, *, strict: bool = True) -> None:
        """Choose the time of each topic by all files, and write how they are read.

        A file of one table without a time is refused, unless ``strict`` is false.
        """
        options = [o for o in self.log.options if rate_hz is None or not o.startswith("time =")]
        lines = [f'kind = "{self.log.kind}"', *options]
        chosen: dict[str, tuple[TimeSource, str]] = {}
        for call, _, _, tables in self.files:
            for table in tables:
                told = TimeSource(rate_hz=rate_hz), ""
                try:
                    if rate_hz is None and (strict or table.has_times or named_times(table)):
                        told = chosen_time(table)
                    elif rate_hz is None:
                        raise InvalidData("no name tells a time")
                except InvalidData as error:
                    if strict and len(tables) == 1:
                        raise
                    offered = named_times(table)
                    if not strict and not table.topic:
                        lines.append(time_line(offered[0], str(error)) if offered else _NO_TIME)
                    continue
                before = chosen.setdefault(table.topic, told)
                if before[0] != told[0]:
                    both = (before[0], told[0])
                    chosen[table.topic] = (self._time_of_all(table.topic, both, call), before[1])
        self.times = {topic: time for topic, (time, _) in chosen.items()}
        for topic, (time, words) in chosen.items():
            line = time_line(time, words)
            if time != TimeSource():
                body = f"topics.{quoted(topic)} = {line.removeprefix('time = ')}"
                lines.append(body if topic and rate_hz is None else line)
        self.lines = list(dict.fromkeys(lines))

    def _time_of_all(self, topic: str, times: Sequence[TimeSource], call: str) -> TimeSource:
        """Time that orders the rows of all files."""
        tables = [t for *_, own in self.files for t in own if t.topic == topic]
        for time in times:
            try:
                for table in tables:
                    samples_of(table, next(iter(table.columns)), time)
            except InvalidData:
                continue
            return time
        raise InvalidData(
            f"{call}: its rows are ordered by another time than those of {self.files[0][0]}; "
            "import the files apart"
        )


def _stream(table: Table, time: TimeSource | None) -> Stream:
    for name in [n for n in table.columns if time is not None and n != time.column][:1]:
        try:
            own = samples_of(table, name, time or TimeSource())
        except InvalidData:
            continue
        start = own.origin_ns if own.origin_ns > 10**17 else None
        return Stream(table=table, start_ns=start, seconds=float(own.time[-1] - own.time[0]))
    return Stream(table=table)


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
    listed = list_sources(sources)
    known = [] if model is None else ["", "# Columns that the model allows:"]
    for column in () if model is None else ModelColumns.of(model).known:
        quantity = column_quantity(model, column)
        known.append(f"#   {quoted(column)}{f'  {quantity}' if quantity else ''}")
    body = ["", *_HEAD]
    for name, source in listed.items():
        for stream in source.streams:
            body += ["", f"# {source.log.words}: {_about(stream)}"[:_WIDE]]
            for channel, first in stream.channels.items():
                own, key = stream.table, ChannelKey(channel, stream.table.topic)
                seen = ", ".join(f"{value:.6g}" for value in first)
                note = "; ".join(filter(None, (seen, own.words.get(channel, ""))))
                line = column_line(_likely(channel, model), name, key, own.units.get(channel, ""))
                body.append(f"# {line}{f'  # {printable(note)}' if note else ''}")
    head = ['model = "model.xml"  # MJCF, beside this file', *known]
    return mapping_text(head, listed, [*body, *_RUNS])


def list_sources(sources: Sequence[str]) -> dict[str, LogSource]:
    """List the channels of files, by the names that a mapping may give the files.

    Parameters
    ----------
    sources : sequence of str
        Files, or ``NAME=PATH``.

    Returns
    -------
    dict of str to LogSource
        Name of the source -> its streams and channels.

    Raises
    ------
    InvalidData
        If a file cannot be read.
    """
    found: dict[str, LogSource] = {}
    for call, path in given_files(sources).items():
        log = open_log(path)
        source = LogSource(files=[(log.name, path, log, log.first())])
        source.take_times(strict=False)
        found[source_name(call, found)] = source
    return found


def mapping_text(head: Sequence[str], sources: Mapping[str, LogSource], rest: Sequence[str]) -> str:
    """Mapping file of sources, between its first lines and its columns and runs."""
    lines = [f"format = {quoted(MAPPING_FORMAT)}", *head]
    for name, source in sources.items():
        lines += ["", f"[sources.{name}]", f"file = {quoted(source.files[0][0])}", *source.lines]
    return "\n".join([*lines, *rest]) + "\n"


def column_line(column: str, source: str, key: ChannelKey, unit: str, *more: str) -> str:
    """Line of a mapping for the channel of a column; without a source where it is ""."""
    parts = [f"source = {quoted(source)}"] if source else []
    parts += [f"topic = {quoted(key.topic)}"] if key.topic else []
    parts += [f"channel = {quoted(key.channel)}"]
    parts += [f"unit = {quoted(unit)}"] if unit else []
    return f"{quoted(column or _UNKNOWN)} = {{ {', '.join([*parts, *more])} }}"


def _about(stream: Stream) -> str:
    """Topic, kind, length, rate and date of a stream, in words."""

    def parts() -> Iterator[str]:
        yield from (printable(stream.table.topic), printable(stream.table.kind))
        if stream.samples:
            yield f"{stream.samples} samples"
        if stream.rate_hz is not None:
            yield f"{stream.rate_hz:.6g} Hz over {stream.seconds:.3f} s"
        if stream.start_ns is not None:
            yield f"from {_date(stream.start_ns)}"
        yield printable(stream.table.note)

    return ", ".join(filter(None, parts()))


def _likely(channel: str, model: mujoco.MjModel | None) -> str:
    """Column of the model that a channel means by its name; "" for none."""
    if model is None or channel in ModelColumns.of(model).known:
        return "" if model is None else channel
    found = _OF_JOINT.fullmatch(channel)
    own = joint_sensors(model).get(found[2]) if found else None
    if found is None or own is None or found[1] == "effort":
        return f"torque.{found[2]}" if found and own else ""
    sensors = own.position if found[1] == "position" else own.velocity
    return f"sensor.{sensors[0]}" if sensors else ""


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
        whole = strftime("%Y-%m-%dT%H:%M:%S", gmtime(ns // 10**9))
    except (OverflowError, ValueError, OSError):
        return f"{ns} ns"
    return f"{whole}.{ns % 10**9:09d}Z"
