"""Import of loggers' files by a mapping into a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import mujoco

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.command_timing import timed
from loose_env.importing.join_runs import Joined, joined_run
from loose_env.importing.mapping import ImportMapping, RunPlan, read_mapping
from loose_env.importing.samples import ChannelKey, Log, Samples
from loose_env.importing.sources import (
    files_of_runs,
    given_files,
    open_log,
    read_source,
    run_episodes,
)
from loose_env.recording import (
    FileFormat,
    ModelColumns,
    Recording,
    check_measured,
    check_target,
    existing_file,
    load_model,
    planned_recording,
    write_measured,
    write_recording,
)


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
    """Settings of the written recording."""

    file_format: FileFormat = "parquet"
    """Format of the runs' tables; in a planned recording the plan's."""
    overwrite: bool = False
    """Replace an existing recording at the output; of a planned one, the runs imported again."""

    def __post_init__(self) -> None:
        if self.file_format not in get_args(FileFormat):
            raise InvalidSetting(
                f"file_format is one of {list(get_args(FileFormat))}, not {self.file_format!r}"
            )


def import_recording(
    sources: Sequence[str | Path],
    mapping: str | Path,
    out: str | Path,
    settings: ImportSettings | None = None,
    *,
    model: str | Path | None = None,
    say: Callable[[str], None] | None = None,
) -> Recording:
    """Make a recording of files that loggers wrote.

    Parameters
    ----------
    sources : sequence of str or Path
        The files; ``NAME=PATH`` names a source of the mapping. No other file is read, but for
        the model and its assets.
    mapping : str or Path
        Mapping file, TOML or JSON.
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
    say = say or _silent
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
    logs = {
        (name, path): open_log(path)
        for name, path in dict.fromkeys(pair for own in files for pair in own.items())
    }
    for run, own in zip(plan.runs, files, strict=True):
        for column in run.columns:
            units = logs[column.source, own[column.source]].ambiguous
            if units and not column.unit:
                raise InvalidData(f"{column.place}: unit is missing: {units}")
    plan, files = _by_episode(plan, files, logs)
    if session is not None:
        names = [(run.file, run.condition) for run in plan.runs]
        check_measured(out, names, overwrite=settings.overwrite)
    joined: list[Joined] = []
    pools: dict[tuple[str, Path, str], dict[ChannelKey, Samples]] = {}
    wanted = _wanted(plan, files)
    for run, own in zip(plan.runs, files, strict=True):
        pool: dict[tuple[str, Path, ChannelKey], Samples] = {}
        for name, path in own.items():
            log = logs[name, path]
            place = (name, path, run.episode if log.episodes else "")
            if place not in pools:
                keys = wanted[name, path]
                pools[place] = read_source(log, plan.sources[name], keys, place[2])
                said = dict.fromkeys(d for each in pools[place].values() for d in each.done)
                for line in (f"{path.name}: {len(keys)} channels read", *said):
                    say(line)
            pool |= {(name, path, key): each for key, each in pools[place].items()}
        joined.append(joined_run(run, own, pool, compiled))
        for line in joined[-1].lines:
            say(line)
    if session is not None:
        return write_measured(out, [each.run for each in joined], overwrite=settings.overwrite)
    free = {
        column.column[5:]
        for run in plan.runs
        for column in run.columns
        if column.column.startswith("ctrl.") and column.method is None
    }
    return write_recording(
        out,
        model_xml=model_file,
        runs=timed(compiled, [each.run for each in joined], free, say),
        file_format=settings.file_format,
        overwrite=settings.overwrite,
    )


def _model_file(plan: ImportMapping, mapping: Path, model: str | Path | None) -> Path:
    if model is not None:
        path = Path(model)
        if not path.is_file():
            raise InvalidSetting(f"there is no model {str(model)!r}")
        return path
    if not plan.model:
        raise InvalidData(
            f"{plan.name}: a recording needs a model: name an MJCF file beside the mapping by "
            "model = '...', or give --model"
        )
    home = mapping.resolve().parent
    try:
        return existing_file(home, plan.model, f"{plan.name}: model")
    except InvalidData as error:
        raise InvalidData(f"{error}; a model from elsewhere is given by --model") from None


def _check_names(plan: ImportMapping, model: mujoco.MjModel) -> None:
    """Refuse names that the model lacks, before files of gigabytes are read."""
    allowed = ModelColumns.of(model)
    for run in plan.runs:
        allowed.check_header(run.place, ["time", *(each.column for each in run.columns)])
        for joint in run.excited:
            allowed.check_joint(f"{run.place}.excited", joint)
        if isinstance(run.pose, dict):
            for joint in run.pose:
                allowed.check_joint(f"{run.place}.pose", joint)


def _by_episode(
    plan: ImportMapping,
    files: list[dict[str, Path]],
    logs: Mapping[tuple[str, Path], Log],
) -> tuple[ImportMapping, list[dict[str, Path]]]:
    """Make a run of each episode where the sources of a run have episodes."""
    runs: list[RunPlan] = []
    own: list[dict[str, Path]] = []
    for run, paths in zip(plan.runs, files, strict=True):
        episodes = run_episodes(run, {name: logs[name, path] for name, path in paths.items()})
        runs += [replace(run, file=f"{run.file}-{each}", episode=each) for each in episodes]
        runs += [] if episodes else [run]
        own += [paths] * max(1, len(episodes))
    return replace(plan, runs=tuple(runs)), own


def _wanted(
    plan: ImportMapping, files: list[dict[str, Path]]
) -> dict[tuple[str, Path], list[ChannelKey]]:
    """Channels that runs take of every file."""
    wanted: dict[tuple[str, Path], dict[ChannelKey, None]] = {}
    for run, own in zip(plan.runs, files, strict=True):
        for column in run.columns:
            wanted.setdefault((column.source, own[column.source]), {})[column.key] = None
    return {place: list(keys) for place, keys in wanted.items()}


def _silent(_: str) -> None:
    pass
