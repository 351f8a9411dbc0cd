"""Recording made of loggers' files by a mapping: channels read, resampled and joined to runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.clocks import samples_of
from loose_env.importing.command_timing import timed
from loose_env.importing.evidence import decoded
from loose_env.importing.mapping import ColumnEntry, ImportMapping, RunPlan, read_mapping
from loose_env.importing.resampling import bridged, held, median_step, resampled, rows_of
from loose_env.importing.samples import Log, Samples, Table, topic_table
from loose_env.importing.sources import files_of_runs, given_files, open_log, run_episodes
from loose_env.importing.units import UNITS, column_quantity, unit_named
from loose_env.recording import (
    FEWEST_SAMPLES,
    MOST_MISSING,
    MOST_VALUES,
    CommandTiming,
    FileFormat,
    ModelColumns,
    Recording,
    Run,
    check_measured,
    check_target,
    existing_file,
    load_model,
    planned_recording,
    write_measured,
    write_recording,
)
from loose_env.typing import Array

Say = Callable[[str], None]
_Read = dict[tuple[str, Log, str], list[Table]]
"""Tables by source, file and episode, which several runs may be cut from."""


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
    """Settings of the written recording."""

    file_format: FileFormat = "parquet"
    """Format of the runs' tables; in a planned recording the plan's."""
    overwrite: bool = False
    """Replace an existing recording at the output; of a planned one, the runs imported again."""


def import_recording(
    sources: Sequence[str | Path],
    mapping: str | Path,
    out: str | Path,
    settings: ImportSettings | None = None,
    *,
    model: str | Path | None = None,
    say: Say = lambda _: None,
) -> Recording:
    """Make a recording of files that loggers wrote.

    Parameters
    ----------
    sources : sequence of str or Path
        The files; ``NAME=PATH`` names a source of the mapping. No other file is read, but for
        the model and its assets.
    mapping : str or Path
        Mapping file.
    out : str or Path
        Folder of the recording. It is written beside its place, read back, and renamed. Into a
        planned recording go the runs that have the names of planned ones; its model, poses and
        conditions stay.
    settings : ImportSettings, optional
        How it is written.
    model : str or Path, optional
        MJCF file in the place of the mapping's; not for a planned recording, which has its own.
    say : callable, optional
        Is given lines on what was done.

    Returns
    -------
    Recording
        As it reads from the folder.

    Raises
    ------
    InvalidData
        If a file is damaged or does not hold what the mapping asks for; the message names the
        file and the place.
    InvalidSetting
        If a file is not there or not used, or the output holds something.
    MissingExtra
        If a kind of file needs a library that is not installed.
    """
    settings = settings or ImportSettings()
    session = planned_recording(out)
    if session is None:
        check_target(out, overwrite=settings.overwrite)  # before hours of logs are read
    plan = read_mapping(mapping)
    given = given_files([str(each) for each in sources])
    if session is None:
        model_file = _model_file(plan, Path(mapping), model)
    elif model is not None:
        raise InvalidSetting(f"{out} is a planned recording with a model of its own: no --model")
    else:
        model_file = existing_file(Path(out).resolve(), session.model, f"{out}: model")
    compiled = load_model(model_file)[1]
    _check_names(plan, compiled)
    files = files_of_runs(plan, given)
    logs = {path: open_log(path) for path in dict.fromkeys(p for f in files for p in f.values())}
    planned: list[tuple[RunPlan, str, dict[str, Log]]] = []
    for run, paths in zip(plan.runs, files, strict=True):
        own = {name: logs[path] for name, path in paths.items()}
        for column in plan.columns.values():
            if own[column.source].ambiguous and not column.unit:
                raise InvalidData(
                    f"{column.place}: unit is missing: {own[column.source].ambiguous}"
                )
        episodes = run_episodes(run, own.values())
        parts = [(replace(run, file=f"{run.file}-{each}"), each, own) for each in episodes]
        planned += parts or [(run, "", own)]
    if session is not None:
        names = [(run.file, run.condition) for run, *_ in planned]
        check_measured(out, names, overwrite=settings.overwrite)
    tables: _Read = {}
    runs = [_joined(plan, *each, tables, compiled, say) for each in planned]
    if session is not None:
        return write_measured(out, runs, overwrite=settings.overwrite)
    free = {c.column[5:] for c in plan.columns.values() if c.is_command and c.method is None}
    return write_recording(
        out,
        model_xml=model_file,
        runs=timed(compiled, runs, free, say),
        file_format=settings.file_format,
        overwrite=settings.overwrite,
    )


def _model_file(plan: ImportMapping, mapping: Path, model: str | Path | None) -> Path:
    if model is None and not plan.model:
        raise InvalidData(
            f"{plan.name}: a recording needs a model: name an MJCF file by model = '...', from the "
            "mapping's folder, or give --model"
        )
    path = mapping.resolve().parent / plan.model if model is None else Path(model)
    if not path.is_file():
        told = " from the mapping's folder; another one is given by --model" * (model is None)
        words = f"{plan.name}: there is no model {str(model or plan.model)!r:.200}{told}"
        raise InvalidSetting(words) if model else InvalidData(words)
    return path


def _check_names(plan: ImportMapping, model: mujoco.MjModel) -> None:
    """Refuse names that the model lacks, before files of gigabytes are read."""
    allowed = ModelColumns.of(model)
    allowed.check_header(plan.name, ["time", *plan.columns])
    for run in plan.runs:
        for joint in run.excited:
            allowed.check_joint(f"{run.place}.excited", joint)
        for joint in run.pose or ():
            allowed.check_joint(f"{run.place}.pose", joint)


# ------------------------------------------------------------------------- one run


class _Column(NamedTuple):
    """One column in SI units, on the clock of the run."""

    entry: ColumnEntry
    place: str
    time: Array
    values: Array
    step: float
    """Median time between samples [s]."""
    longest: float
    """Longest pause that is bridged [s]."""

    @property
    def last(self) -> float:
        """Last time that it speaks of; a command stands until the next."""
        return float(self.time[-1]) + (self.longest if self.entry.way == "hold" else 0.0)


def _joined(
    plan: ImportMapping, run: RunPlan, episode: str, logs: Mapping[str, Log],
    read: _Read, model: mujoco.MjModel, say: Say,
) -> Run:  # fmt: skip
    """Run with all columns on common times."""
    columns = _columns(plan, episode, logs, read, model, say)
    start, stop = _ends(run, columns)
    lead = min(columns, key=lambda c: (c.entry.way == "hold", c.step))
    rows = _rows(run, lead, start, stop, len(columns))
    table: dict[str, Array] = {}
    seconds, rate = rows[-1] - rows[0], 1 / median_step(rows)
    say(f"{run.file}: {len(rows)} rows, {seconds:.3f} s at {rate:.6g} Hz")
    for entry, place, time, values, _, longest in columns:
        if entry.way == "hold":
            own, how = held(time, values, rows, longest), "last value held"
        else:
            own, how = resampled(time, values, rows, longest)
        missing = int(np.count_nonzero(np.isnan(own)))
        if missing > MOST_MISSING * len(rows):
            first = rows[int(np.flatnonzero(np.isnan(own))[0])] - rows[0]
            raise InvalidData(
                f"{run.place}: column {entry.column!r}, from {place}: "
                f"{missing / len(rows):.0%} of {len(rows)} rows have no sample, the first "
                f"{first:.3f} s after the start; a column may miss {100 * MOST_MISSING:g} %. Cut "
                "the run by start and stop; or, where pauses belong to the channel, set its gap_s "
                f"(now {longest:.4g})"
            )
        table[entry.column] = own
        note = f", {missing} missing" if missing else ""
        note += f", unwrapped at {entry.period:g}" if entry.period else ""
        say(f"  {entry.column}: {how}{note}")
    linear = [c.column[5:] for c in plan.columns.values() if c.is_command and c.method == "band"]
    return Run(
        name=run.file,
        time=rows - rows[0],
        **ModelColumns.of(model).grouped(table),
        excited=run.excited,
        pose=None if run.pose is None else dict(run.pose),
        condition=run.condition,
        commands=dict.fromkeys(linear, CommandTiming(mode="linear")),
    )


def _columns(
    plan: ImportMapping, episode: str, logs: Mapping[str, Log],
    read: _Read, model: mujoco.MjModel, say: Say,
) -> list[_Column]:  # fmt: skip
    """Columns in SI units, each source on its clock as the mapping corrects it."""
    found: dict[str, Samples] = {}
    for name, log in logs.items():
        source, entries = plan.sources[name], [c for c in plan.columns.values() if c.source == name]
        place = name, log, episode if log.episodes else ""
        if place not in read:
            read[place] = log.tables(place[2], [c.key for c in entries])
        tables = [topic_table(read[place], c.key, log.name) for c in entries]
        own = {
            c.column: samples_of(table, c.channel, source.time_of(c.topic))
            for c, table in zip(entries, tables, strict=True)
        }
        for line in dict.fromkeys(line for each in own.values() for line in each.done):
            say(line)
        first = min(s.origin_ns + round(s.time[0] * 1e9) for s in own.values())
        for c in entries:
            time, samples = source.time_of(c.topic), own[c.column]
            start = first if time.from_start else 0
            # Whole nanoseconds: an offset of years would cost the stamps their microseconds.
            origin = samples.origin_ns - start + round((time.offset_s - c.delay_s) * 1e9)
            found[c.column] = replace(samples, origin_ns=origin)
    origin = min(samples.origin_ns for samples in found.values())
    times = {(id(s.time), s.origin_ns): s.since(origin) for s in found.values()}
    steps: dict[int, tuple[float, float]] = {}
    columns = []
    for entry in plan.columns.values():
        samples = found[entry.column]
        values = decoded(samples.values, entry.period, entry.sign_bit)
        values = values * _factor(entry, samples, model) + entry.offset
        if not np.isfinite(values).all():
            raise InvalidData(f"{entry.place}: scaled, its values are too large for a number")
        at, clock = times[id(samples.time), samples.origin_ns], id(samples.time)
        if clock not in steps:
            steps[clock] = median_step(samples.time), bridged(samples.time)
        step, longest = steps[clock]
        columns.append(_Column(entry, samples.place, at, values, step, entry.gap_s or longest))
    return columns


def _factor(entry: ColumnEntry, samples: Samples, model: mujoco.MjModel) -> float:
    """Factor from the channel's values to SI units."""
    wanted = column_quantity(model, entry.column)
    name = entry.unit or samples.unit
    if not name:
        return entry.sign * entry.scale
    unit = unit_named(name, f"{entry.place}.unit")
    if wanted is not None and unit.quantity != wanted:
        fitting = " ".join(n for n, each in UNITS.items() if each.quantity == wanted)
        told = "" if entry.unit else f" (so says {samples.place})"
        raise InvalidData(
            f"{entry.place}.unit: {name!r}{told} measures {unit.quantity}, and the column holds "
            f"{wanted}: {fitting}. A sensor's sensitivity goes into scale"
        )
    return replace(entry, unit=name).factor


def _ends(run: RunPlan, columns: Sequence[_Column]) -> tuple[float, float]:
    late = max(columns, key=lambda c: float(c.time[0]))
    early = min(columns, key=lambda c: c.last)
    first, last = float(late.time[0]), early.last
    # Commands may end before the readings, but rows end with the readings.
    last = min(last, max(float(c.time[-1]) for c in columns))
    if first >= last:
        raise InvalidData(
            f"{run.place}: its channels have no time in common: {early.place} ends "
            f"{first - last:.6g} s before {late.place} begins. Where clocks differ, set "
            "offset_s or from_start of a source's time"
        )
    start = first + (run.start or 0.0)
    stop = last if run.stop is None else first + run.stop
    if stop > last + 1e-6 or start >= stop:
        raise InvalidData(
            f"{run.place}: from {start - first:.6g} to {stop - first:.6g} s is not within what "
            f"all its channels have, 0 to {last - first:.6g} s ({late.place} begins last, "
            f"{early.place} ends first)"
        )
    return start, stop


def _rows(run: RunPlan, lead: _Column, start: float, stop: float, columns: int) -> Array:
    most = MOST_VALUES // (columns + 1)
    rows = rows_of(lead.time, start, stop, lead.longest, most)
    if rows is None:
        raise InvalidData(f"{run.place}: more than {most} rows; take less by start and stop")
    if len(rows) < FEWEST_SAMPLES:
        raise InvalidData(
            f"{run.place}: {len(rows)} rows in {stop - start:.6g} s; a run has at least "
            f"{FEWEST_SAMPLES}"
        )
    return rows
