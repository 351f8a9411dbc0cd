"""Proposal of a mapping for files: sources, runs, a column for each channel, with reasons."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.errors import InvalidData, LooseEnvError
from loose_env.importing.clocks import samples_of
from loose_env.importing.describe import (
    LogFile,
    LogSource,
    column_line,
    mapping_text,
    source_name,
)
from loose_env.importing.evidence import Signal, coding_of, on_one_base
from loose_env.importing.join_runs import decoded
from loose_env.importing.mapping import printable, quoted
from loose_env.importing.names import meaning_of, quantities
from loose_env.importing.reading import given_files, open_log
from loose_env.importing.roles import Line, Roles
from loose_env.importing.samples import ChannelKey, Samples, natural
from loose_env.importing.targets import joint_targets

_MOST_RUNS = 4
"""Runs of which signals are compared; more tell hardly more."""
_MOST_LEFT = 40
"""Channels without a column that are listed, at most."""
_SAME = 0.7
"""Share of channels that two files have in common to be two runs of one log."""
_ALL_NAN = "no sample: all its values are NaN"


class Left(NamedTuple):
    """A channel without a column, and the reason."""

    source: str
    key: ChannelKey
    unit: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A proposed mapping."""

    logs: Mapping[str, LogSource]
    columns: tuple[Line, ...]
    notes: tuple[str, ...]
    unassigned: tuple[Left, ...] = ()
    runs: tuple[Mapping[str, str], ...] = ()
    """Files of each run, by source."""
    unused: tuple[str, ...] = ()
    """Files that hold no signals."""


def propose(
    sources: Sequence[str], model: mujoco.MjModel, rate_hz: float | None = None
) -> Proposal:
    """Propose a mapping of files to the columns of a model.

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
        If a file cannot be read, its times are not known, or no channel is a measured one.
    """
    logs, notes, unused = _sources(sources, rate_hz)
    runs = _runs(logs)
    signals, step, left = _signals(logs, runs, [t.name for t in joint_targets(model)])
    defined = {
        name: "rad"
        for name, log in logs.items()
        if log.files[0][2].kind in ("mcap", "rosbag2", "sysid", "hdf5") or any(
            key.startswith(("actual_q", "target_q")) for key in log.files[0][3][0].columns
        )
    }  # fmt: skip
    roles = Roles(model, signals, step, defined).found()
    columns = (*roles.lines.values(), *roles.open)
    left = [*(Left(s.source, s.key, s.unit, why) for s, why in roles.left()), *left]
    measured = [c for c in roles.lines if not c.startswith("ctrl.")]
    if not measured:
        names = ", ".join(dict.fromkeys(log.files[0][0] for log in logs.values()))
        if roles.notes:  # the log has them, and the model no place for them
            raise InvalidData(f"{names}: {'; '.join(roles.notes)[:600]}")
        heard = "; ".join(f"{each.key}: {each.reason}" for each in left[:3])
        found = ", ".join(f"{line.candidate.key} as {c}" for c, line in [*roles.lines.items()][:2])
        raise InvalidData(
            f"{names}: no channel is a measured position, velocity or torque of the model "
            f"({found or 'nothing was recognised'}); record the joints' states too, or write a "
            f"mapping by loose import --describe. {heard[:400]}"
        )
    taken = {line.candidate.source for line in roles.lines.values()}
    for name in [name for name in logs if name not in taken]:
        notes.append(f"{name}: none of its channels is used")
        unused += [call for call, *_ in logs.pop(name).files]
    runs = [{k: v for k, v in run.items() if k in taken} for run in runs]
    return Proposal(
        logs=logs, columns=columns, notes=(*notes, *roles.notes), unassigned=tuple(left),
        runs=tuple(runs), unused=tuple(unused),
    )  # fmt: skip


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
        entry = (call, given[call], log, tables)
        group = next((g for g in groups if _of_one_kind(g.files[0], entry)), None)
        if group is None:
            groups.append(LogSource(files=[entry]))
        else:
            group.files.append(entry)
    if not groups:
        raise first or InvalidData(f"{', '.join(words)}: no logs")
    named: dict[str, LogSource] = {}
    for group in groups:
        name = source_name(group.files[0][0], named)
        group.take_times(rate_hz)
        named[name] = group
    return named, notes, unused


def _of_one_kind(one: LogFile, other: LogFile) -> bool:
    """Whether two files are runs of one log: the same channels, and no other quantity by name."""
    keys = [{(t.topic, c) for t in each[3] for c in t.columns} for each in (one, other)]
    if one[2].kind != other[2].kind or len(keys[0] & keys[1]) < _SAME * len(keys[0] | keys[1]):
        return False
    told = [quantities(Path(each[0]).stem) for each in (one, other)]
    own = {q for t in one[3] for c in t.columns for q in quantities(c)} - {"other"}
    return told[0] == told[1] or len(own) > 1


def _runs(logs: Mapping[str, LogSource]) -> list[dict[str, str]]:
    """Files of each run: one of each source, paired by folder or by order."""
    counts = {name: len(log.files) for name, log in logs.items()}
    if len(set(counts.values())) > 1:
        most = max(counts, key=lambda name: counts[name])
        few = min(counts, key=lambda name: counts[name])
        raise InvalidData(
            f"{counts[most]} files are like {logs[most].files[0][0]}, and {counts[few]} like "
            f"{logs[few].files[0][0]}: which belong to one run cannot be told; give them in one "
            "folder a run, or import each kind apart"
        )
    return [
        {name: log.files[i][0] for name, log in logs.items()} for i in range(max(counts.values()))
    ]


# ------------------------------------------------------------------------- signals


def _signals(
    logs: Mapping[str, LogSource], runs: Sequence[Mapping[str, str]], joints: Sequence[str]
) -> tuple[list[Signal], float, list[Left]]:
    """Channels of some runs on common times, and those that have no samples."""
    read: list[dict[tuple[str, ChannelKey], Samples]] = []
    left: dict[tuple[str, ChannelKey], Left] = {}
    units: dict[tuple[str, ChannelKey], str] = {}
    for i in _chosen(len(runs)):
        episodes = {name: log.files[i][2].episodes for name, log in logs.items()}
        parts = next((e for e in episodes.values() if e), ("",))
        for n in _chosen(len(parts), most=max(1, _MOST_RUNS // max(len(runs), 1))):
            own: dict[tuple[str, ChannelKey], Samples] = {}
            for name, log in logs.items():
                _, _, file, first = log.files[i]
                tables = file.tables(parts[n], None) if n and file.episodes else first
                for table in tables:
                    time = log.times.get(table.topic)
                    if time is None:
                        continue
                    for channel in table.columns:
                        if channel in (time.column, time.fine):
                            continue
                        key = (name, ChannelKey(channel, table.topic))
                        units[key] = table.units.get(channel, "")
                        try:
                            own[key] = samples_of(table, channel, time)
                        except InvalidData as error:
                            nan = np.isnan(np.asarray(table.columns[channel], dtype=float)).all()
                            why = _ALL_NAN if nan else str(error)
                            left[key] = Left(*key, units[key], why)
            read.append(own)
    keys = list(dict.fromkeys(key for own in read for key in own))
    coded = {key: _coding([own[key].values for own in read if key in own]) for key in keys}
    step, bases = 0.0, []
    for own in read:
        plain = {
            i: replace(own[key], values=decoded(own[key].values, *coded[key]))
            for i, key in enumerate(keys)
            if key in own
        }
        own_step, base = on_one_base(plain)
        step = step or own_step
        bases.append(base)
    signals = []
    for i, key in enumerate(keys):
        values = [base.get(i, np.empty(0)) for base in bases]
        if not any(len(v) for v in values):
            left[key] = Left(*key, units[key], "has no time in common with the other channels")
            continue
        source, channel_key = key
        beside = Path(logs[source].files[0][0]).stem if len(logs) > 1 else ""
        told = quantities(beside)
        signals.append(
            Signal(
                source=source,
                key=channel_key,
                unit=units[key],
                meaning=meaning_of(channel_key, joints, beside if told else ""),
                runs=values,
                step=step,
                period=coded[key][0],
                sign_bit=coded[key][1],
                whole=all(_is_whole(own[key].values) for own in read if key in own),
                sort=i,
            )
        )
    if not signals:
        names = ", ".join(log.files[0][0] for log in logs.values())
        why = next((each.reason for each in left.values()), "give the runs of one motion")
        raise InvalidData(f"{names}: no channels of numbers that have 10 samples in common; {why}")
    used = {(s.source, s.key) for s in signals}
    return signals, step, [each for key, each in left.items() if key not in used]


def _is_whole(values: np.ndarray) -> bool:
    return bool(np.all(values == np.round(values)))


def _chosen(count: int, most: int = _MOST_RUNS) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, most))})


def _coding(runs: Sequence[np.ndarray]) -> tuple[float | None, int | None]:
    """Coding that most of the runs with jumps have."""
    found = [coding_of(values) for values in runs]
    return next((each for each in found if each != (None, None)), (None, None))


# ------------------------------------------------------------------------- text


def proposal_text(proposal: Proposal, model: str) -> str:
    """Write a proposal as a mapping file.

    Parameters
    ----------
    proposal : Proposal
        The proposal.
    model : str
        Path of the model from the folder of the mapping; "" where it lies elsewhere, so that it
        is given on the command line.

    Returns
    -------
    str
        TOML; a line that lacks something is a comment.
    """
    several = len(proposal.logs) > 1
    head = [f"model = {quoted(model)}" if model else "# model: give it by --model"]
    if proposal.unused:
        names = ", ".join(map(quoted, proposal.unused))
        head.append(f"unused = [{names}]  # none of their signals is used")
    lines = [
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
        line = column_line("", left.source if several else "", left.key, left.unit)
        lines.append(f"# {line}  # {printable(left.reason)}")
    if len(proposal.unassigned) > _MOST_LEFT:
        more = len(proposal.unassigned) - _MOST_LEFT
        lines.append(f"# and {more} more: loose import --describe lists them")
    for i, (name, files) in enumerate(zip(_run_names(proposal), proposal.runs, strict=True)):
        lines += ["", "[[runs]]", f"file = {quoted(name)}"]
        if len(proposal.runs) > 1:
            own = ", ".join(f"{source} = {quoted(file)}" for source, file in files.items())
            lines.append(f"sources = {{ {own} }}")
        if i == 0:
            lines.append('condition = "suspect"  # or "healthy"')
        episodes = max(len(log.files[i][2].episodes) for log in proposal.logs.values())
        if episodes:
            lines.append(f'episodes = "all"  # of {episodes}; or such as "0, 3-5"')
    return mapping_text(head, proposal.logs, lines)


def _run_names(proposal: Proposal) -> list[str]:
    """Names of the runs: of their files or folders, or what the names of a run's files share."""
    if len(proposal.runs) == 1:
        return [*proposal.logs][:1]
    taken: dict[str, None] = {}
    files = [list(run.values()) for run in proposal.runs]
    for call in _shared(files) or [own[0].split("/")[0] if own[1:] else own[0] for own in files]:
        taken[source_name(call.replace("/", "-"), taken)] = None
    return [*taken]


def _shared(runs: Sequence[Sequence[str]]) -> list[str]:
    """Words with which all file names of a run begin, or end; none if they do not tell the runs."""
    words = [[re.split(r"[-_.]+", Path(f).stem) for f in own] for own in runs if "/" not in own[0]]
    for way in (1, -1):
        told = []
        for own in words:
            alike = itertools.takewhile(
                lambda each: len(set(each)) == 1, zip(*(w[::way] for w in own), strict=False)
            )
            told.append("-".join([each[0] for each in alike][::way]))
        if len(set(told)) == len(runs) and all(told):
            return [f"run-{call}" if call.isdigit() else call for call in told]
    return []


def _line(each: Line, several: bool) -> str:
    s, scaling = each.candidate, each.scaling
    more = [f"scale = {scaling.scale:.9g}"] if scaling.scale != 1.0 else []
    more += [f"sign = {each.sign}"] if each.sign != 1 else []
    more += [f"offset = {scaling.offset:.9g}"] if scaling.offset else []
    more += [f"period = {s.period:.9g}"] if s.period is not None else []
    more += [f"sign_bit = {s.sign_bit}"] if s.sign_bit is not None else []
    return column_line(each.column, s.source if several else "", s.key, scaling.unit, *more)
