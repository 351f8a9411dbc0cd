"""Proposal of a mapping for files: sources, runs, a column for each channel, with reasons."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.errors import InvalidData, LooseEnvError
from loose_env.importing.clocks import chosen_time, samples_of, time_line
from loose_env.importing.evidence import Signal, coding_of, decoded, on_one_base
from loose_env.importing.mapping import MAPPING_FORMAT, TimeSource
from loose_env.importing.names import meaning_of, quantities
from loose_env.importing.roles import Line, Roles
from loose_env.importing.samples import (
    ChannelKey,
    Log,
    Samples,
    Table,
    natural,
    printable,
    quoted,
)
from loose_env.importing.sources import given_files, open_log
from loose_env.importing.targets import joint_targets
from loose_env.importing.units import quantity_of
from loose_env.recording import ModelColumns
from loose_env.typing import Array

_MOST_RUNS = 4
"""Runs of which signals are compared; more tell hardly more."""
_MOST_LEFT = 500
"""Channels without a column that are listed, at most."""
_SAME = 0.7
"""Share of channels that two files have in common to be two runs of one log."""
_ALL_NAN = "no sample: all its values are NaN"


class LogFile(NamedTuple):
    """A file of the command line, and the tables of its first episode."""

    call: str
    log: Log
    tables: list[Table]


@dataclass(eq=False, kw_only=True)
class LogSource:
    """A source of the mapping: files of one kind, one in each run."""

    files: list[LogFile]
    times: dict[str, TimeSource] = field(default_factory=dict)
    """Time of each topic that has one."""
    lines: list[str] = field(default_factory=list)
    """Lines of the mapping that say so."""

    def take_times(self, rate_hz: float | None) -> None:
        """Choose the time of each topic by all files; a file of one table needs one."""
        for topic in dict.fromkeys(t.topic for each in self.files for t in each.tables):
            tables = [t for each in self.files for t in each.tables if t.topic == topic]
            time, words = TimeSource(rate_hz=rate_hz), ""
            try:
                time, words = (time, "") if rate_hz else chosen_time(tables)
            except InvalidData:
                if len(self.files[0].tables) == 1:
                    raise
                continue
            self.times[topic] = time
            line = time_line(time, words)
            if topic and rate_hz is None:
                line = f"topics.{quoted(topic)} = {line.removeprefix('time = ')}"
            if time != TimeSource() and line not in self.lines:
                self.lines.append(line)


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A proposed mapping."""

    logs: Mapping[str, LogSource]
    columns: tuple[Line, ...]
    notes: tuple[str, ...]
    unassigned: tuple[Line, ...] = ()
    """Channels without a column, and the reasons."""
    runs: tuple[Mapping[str, str], ...] = ()
    """Files of each run, by source."""
    unused: tuple[str, ...] = ()
    """Files that hold no signals."""
    refused: str = ""
    """Reason for which no recording can be made so; "" where one can."""


def propose(
    sources: Sequence[str], model: mujoco.MjModel, rate_hz: float | None = None
) -> Proposal:
    r"""Propose a mapping of files to the columns of a model.

    Parameters
    ----------
    sources : sequence of str
        Files or folders, or ``NAME=PATH``: all runs of a log at once.
    model : mujoco.MjModel
        The model.
    rate_hz : float, optional
        Sampling rate of files without times [Hz].

    Raises
    ------
    InvalidData
        If a file cannot be read or its times are not known.

    Examples
    --------
    >>> import tempfile
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     rows = "".join(f"{i},{i % 7}\n" for i in range(50))
    ...     _ = Path(folder, "log.csv").write_text("time [s],angle [deg]\n" + rows)
    ...     found = propose([f"{folder}/log.csv"], mujoco.MjModel.from_xml_string(xml))
    >>> [(line.column, line.candidate.key.channel, line.scaling.unit) for line in found.columns]
    [('sensor.encoder', 'angle [deg]', 'deg')]
    """
    logs, notes, unused = _sources(sources, rate_hz)
    runs = _runs(logs)
    signals = _signals(logs, runs, {t.name: t.aliases for t in joint_targets(model)})
    roles = Roles(model, signals).found()
    known, left = [*ModelColumns.of(model).known], roles.left()
    order = sorted(roles.lines, key=lambda c: (c.startswith("ctrl."), known.index(c)))
    columns = (*(roles.lines[column] for column in order), *roles.open)
    refused = _nothing(logs, roles, left, known) if all(c[:5] == "ctrl." for c in order) else ""
    taken = {line.candidate.source for line in roles.lines.values()}
    for name in [name for name in logs if taken and name not in taken]:
        notes.append(f"{name}: none of its channels is used")
        unused += [each.call for each in logs.pop(name).files]
    runs = [{k: v for k, v in run.items() if k in logs} for run in runs]
    return Proposal(
        logs=logs, columns=columns, notes=(*notes, *roles.notes), unassigned=left,
        runs=tuple(runs), unused=tuple(unused), refused=refused,
    )  # fmt: skip


def _nothing(
    logs: Mapping[str, LogSource], roles: Roles, left: Sequence[Line], known: Sequence[str]
) -> str:
    """Reason why no channel is a measured one."""
    names = ", ".join(dict.fromkeys(log.files[0].call for log in logs.values()))
    if roles.notes:  # the log has them, and the model no place for them
        return f"{names}: {'; '.join(roles.notes)[:600]}"
    heard = "; ".join(f"{each.candidate.key}: {each.reason}" for each in [*roles.open, *left][:3])
    found = ", ".join(f"{line.candidate.key} as {c}" for c, line in [*roles.lines.items()][:2])
    return (
        f"{names}: no channel is a measured position, velocity or torque of the model "
        f"({found or 'nothing was recognised'}); record the joints' states too, or name the "
        f"channels of columns such as {', '.join(known[:3])} in the mapping. {heard[:400]}"
    )


# ------------------------------------------------------------------------- files


def _sources(
    words: Sequence[str], rate_hz: float | None
) -> tuple[dict[str, LogSource], list[str], list[str]]:
    """Sources of files, those of one kind in one; files without signals are left out."""
    given = given_files(words)
    notes: list[str] = []
    unused: list[str] = []
    groups: list[LogSource] = []
    first: LooseEnvError | None = None
    for call in sorted(given, key=natural):
        try:
            log = open_log(given[call])
            tables = [table for table in log.first() if table.columns]
            if not tables or all(len(t) < 2 for t in tables):
                raise InvalidData(f"{log.name}: it holds no signals")
        except LooseEnvError as error:
            first = first or error
            notes.append(f"left out: {error}")
            unused.append(call)
            continue
        entry = LogFile(call, log, tables)
        group = next((g for g in groups if _of_one_kind(g.files[0], entry)), None)
        if group is None:
            groups.append(LogSource(files=[entry]))
        else:
            group.files.append(entry)
    if not groups:
        raise first or InvalidData(f"{', '.join(words)}: no logs")
    named: dict[str, LogSource] = {}
    for group in groups:
        name = source_name(group.files[0].call, named)
        group.take_times(rate_hz)
        named[name] = group
    return named, notes, unused


def _of_one_kind(one: LogFile, other: LogFile) -> bool:
    """Whether two files are runs of one log: the same channels, and no other quantity by name."""
    keys = [{(t.topic, c) for t in each.tables for c in t.columns} for each in (one, other)]
    if len(keys[0] & keys[1]) < _SAME * len(keys[0] | keys[1]):
        return False
    told = [quantities(Path(each.call).stem) for each in (one, other)]
    own = {q for t in one.tables for c in t.columns for q in quantities(c)} - {"other"}
    return told[0] == told[1] or len(own) > 1


def _runs(logs: Mapping[str, LogSource]) -> list[dict[str, str]]:
    """Files of each run: one of each source, paired by folder or by order."""
    counts = {name: len(log.files) for name, log in logs.items()}
    if len(set(counts.values())) > 1:
        most = max(counts, key=lambda name: counts[name])
        few = min(counts, key=lambda name: counts[name])
        raise InvalidData(
            f"{counts[most]} files are like {logs[most].files[0].call}, and {counts[few]} like "
            f"{logs[few].files[0].call}: which belong to one run cannot be told; give them in one "
            "folder a run, or import each kind apart"
        )
    return [
        {name: log.files[i].call for name, log in logs.items()} for i in range(max(counts.values()))
    ]


# ------------------------------------------------------------------------- signals


def _signals(
    logs: Mapping[str, LogSource],
    runs: Sequence[Mapping[str, str]],
    joints: Mapping[str, Sequence[str]],
) -> list[Signal]:
    """All channels, on common times of some runs where they have samples."""
    read: list[dict[tuple[str, ChannelKey], Samples]] = []
    units: dict[tuple[str, ChannelKey], str] = {}
    why: dict[tuple[str, ChannelKey], str] = {}
    for i in _chosen(len(runs)):
        parts = next((e for log in logs.values() if (e := log.files[i].log.episodes)), ("",))
        for n in _chosen(len(parts), most=max(1, _MOST_RUNS // max(len(runs), 1))):
            read.append({})
            for name, source in logs.items():
                _, log, first = source.files[i]
                for table in log.tables(parts[n], None) if n and log.episodes else first:
                    time = source.times.get(table.topic)
                    for channel, values in table.columns.items():
                        if time and channel in (time.column or table.time, time.fine):
                            continue
                        key = (name, ChannelKey(channel, table.topic))
                        units[key] = table.units.get(channel, "")
                        if time is None or quantity_of(units[key]) == "time":
                            why[key] = "a time" if time else "its topic has no time in order"
                            continue
                        try:
                            read[-1][key] = samples_of(table, channel, time)
                        except InvalidData as error:
                            nan = np.isnan(np.asarray(values, dtype=float)).all()
                            why[key] = _ALL_NAN if nan else str(error)
    coded = dict.fromkeys(units, (None, None)) | {
        key: found for own in reversed(read) for key, each in own.items()
        if (found := coding_of(each.values, units[key])) != (None, None)
    }  # fmt: skip
    bases = [
        on_one_base({k: replace(v, values=decoded(v.values, *coded[k])) for k, v in own.items()})
        for own in read
    ]
    signals = []
    for i, key in enumerate(units):
        name, own_key = key
        file, beside = logs[name].files[0], Path(logs[name].files[0].call).stem
        told = len(logs) > 1 and quantities(beside)
        signals.append(
            Signal(
                source=name,
                key=own_key,
                unit=units[key],
                meaning=meaning_of(own_key, joints, beside if told else ""),
                runs=[base.get(key, np.empty(0)) for _, base in bases],
                step=bases[0][0],
                period=coded[key][0],
                sign_bit=coded[key][1],
                whole=all(_whole(own[key].values[::97]) and _whole(own[key].values)
                          for own in read if key in own),
                sort=i,
                defined=bool(file.log.angle),
                why=why.get(key, "has no time in common with the other channels"),
            )
        )  # fmt: skip
    if not any(s.values.size for s in signals):
        names = ", ".join(log.files[0].call for log in logs.values())
        reason = next(iter(why.values()), "give the runs of one motion")
        raise InvalidData(
            f"{names}: no channels of numbers that have 10 samples in common; {reason}"
        )
    return signals


def _whole(values: Array) -> bool:
    return bool(np.all(values == np.round(values)))


def _chosen(count: int, most: int = _MOST_RUNS) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, most))})


# ------------------------------------------------------------------------- text


def proposal_text(proposal: Proposal, model: str) -> str:
    """Write a proposal as a mapping file.

    Parameters
    ----------
    proposal : Proposal
        The proposal.
    model : str
        Path of the model from the folder of the mapping.

    Returns
    -------
    str
        TOML; a line that lacks something, and one of each channel without a column, is a comment.
    """
    several = len(proposal.logs) > 1
    lines = [f"format = {quoted(MAPPING_FORMAT)}", f"model = {quoted(model)}"]
    if proposal.unused:
        names = ", ".join(map(quoted, proposal.unused))
        lines.append(f"unused = [{names}]  # none of their signals is used")
    for name, source in proposal.logs.items():
        file = source.files[0].call
        lines += ["", f"[sources.{name}]", f"file = {quoted(file)}", *source.lines]
    lines += [
        "",
        "# Proposed by what the channels do, names and ranges besides: check every line.",
        "[columns]",
    ]
    for each in proposal.columns:
        lines.append(f"# {printable(each.reason)}")
        lines.append(f"{'# ' if each.open else ''}{_line(each, several)}")
    lines += [f"# {printable(note)}" for note in proposal.notes]
    lines += ["# Not used:"] if proposal.unassigned else []
    for left in proposal.unassigned[:_MOST_LEFT]:
        lines.append(f"# {_line(left, several)}  # {printable(left.reason)}")
    if len(proposal.unassigned) > _MOST_LEFT:
        lines.append(f"# and {len(proposal.unassigned) - _MOST_LEFT} more")
    for i, (name, files) in enumerate(zip(_run_names(proposal), proposal.runs, strict=True)):
        lines += ["", "[[runs]]", f"file = {quoted(name)}"]
        if len(proposal.runs) > 1:
            own = ", ".join(f"{source} = {quoted(file)}" for source, file in files.items())
            lines.append(f"sources = {{ {own} }}")
        if i == 0:
            lines.append('condition = "suspect"  # or "healthy"')
        episodes = max(len(log.files[i].log.episodes) for log in proposal.logs.values())
        if episodes:
            lines.append(f'episodes = "all"  # of {episodes}; or such as [0, 3]')
    return "\n".join(lines) + "\n"


def source_name(given: str, taken: Container[str]) -> str:
    """Name of a source from that of its file."""
    stem = Path(given.replace("/", "-")).stem
    plain = "".join(c if (c.isascii() and c.isalnum()) or c in "-_" else "-" for c in stem)
    name = first = plain.strip("-_") or "source"
    count = 2
    while name in taken:  # run-01.mcap and run-01.csv
        name, count = f"{first}-{count}", count + 1
    return name


def _run_names(proposal: Proposal) -> list[str]:
    """Names of the runs: of their file or folder, or the words that the names of all files share.

    A number alone is that of a run: ``robot-03.csv`` and ``acc-03.csv`` make ``run-03``.
    """
    taken: dict[str, None] = {}
    for i, run in enumerate(proposal.runs):
        paths = [Path(file) for file in run.values()]
        words = [re.split(r"[-_. ]+", path.stem) for path in paths]
        shared = [word for word in words[0] if all(word in other for other in words)]
        call = "-".join(shared) or str(i + 1)
        if len({*run.values()}) == 1:
            call = next(iter(run.values()))
        elif len({path.parent for path in paths}) == 1 and paths[0].parent.name:
            call = paths[0].parent.name
        taken[source_name(f"run-{int(call):02d}" if call.isdigit() else call, taken)] = None
    return [*taken]


def _line(each: Line, several: bool) -> str:
    """Line of a mapping for the channel of a column."""
    s, scaling = each.candidate, each.scaling
    parts = [f"source = {quoted(s.source)}"] if several else []
    parts += [f"topic = {quoted(s.key.topic)}"] if s.key.topic else []
    parts += [f"channel = {quoted(s.key.channel)}"]
    parts += [f"unit = {quoted(scaling.unit)}"] if scaling.unit else []
    parts += [f"scale = {scaling.scale:.9g}"] if scaling.scale != 1.0 else []
    parts += [f"sign = {scaling.sign}"] if scaling.sign != 1 else []
    parts += [f"offset = {scaling.offset:.9g}"] if scaling.offset else []
    parts += [f"period = {s.period:.9g}"] if s.period is not None and each.column else []
    parts += [f"sign_bit = {s.sign_bit}"] if s.sign_bit is not None and each.column else []
    return f"{quoted(each.column or 'sensor.?')} = {{ {', '.join(parts)} }}"
