"""Writing a recording atomically: written beside its place, read back, then renamed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from posixpath import normpath
from typing import Any, Literal, get_args

from loose_env.arms import copy_files, files_of
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.recording.recording import (
    DESCRIPTION,
    ENDINGS,
    FORMAT,
    Recording,
    RunEntry,
    read_description,
    read_recording,
)
from loose_env.recording.run import Run, table_of
from loose_env.recording.tables import inside, write_csv, write_parquet

FileFormat = Literal["parquet", "csv"]
"""How the tables of runs are kept."""

_WRITERS = {"parquet": write_parquet, "csv": write_csv}


def write_recording(
    folder: str | Path,
    *,
    model_xml: str | Path,
    runs: Iterable[Run],
    planned: Iterable[RunEntry] = (),
    file_format: FileFormat | None = "parquet",
    overwrite: bool = False,
) -> Recording:
    """Write runs and their model as a recording.

    All is written beside the folder, read back and checked, and renamed into place: what is
    there is a recording that reads, or was not touched.

    Parameters
    ----------
    folder : str or Path
        The folder to write; new or empty.
    model_xml : str or Path
        Text of an MJCF model, written as ``model.xml``; or the path of one, copied under its own
        name with all it refers to. A string without ``<`` is a path.
    runs : iterable of Run
        The runs. A name gets the ending of the format in the place of another one.
    planned : iterable of RunEntry
        Runs that are still to be measured.
    file_format : {"parquet", "csv"} or None
        Format of the runs' tables; None for that of each run's name, Parquet where it has none.
        Both keep every number to the last bit.
    overwrite : bool
        Whether a recording that is there is replaced, its runs and its model. A folder that holds
        other files beside them is refused.

    Returns
    -------
    Recording
        The recording as it reads from the folder.

    Raises
    ------
    InvalidData
        If the runs and the model make no recording, as `read_recording`.
    InvalidSetting
        If the folder holds something, or there is no such model file.
    UnknownName
        If there is no such format.
    """
    if file_format is not None and file_format not in get_args(FileFormat):
        raise UnknownName(f"runs are kept as {list(get_args(FileFormat))}, not {file_format!r}")
    target = Path(folder).resolve()
    check_target(target, overwrite=overwrite)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    old = target.with_name(f".{target.name}.{os.getpid()}.old")
    shutil.rmtree(beside, ignore_errors=True)
    try:
        beside.mkdir()
        beside.joinpath(DESCRIPTION).touch()  # its name is taken: no run may have it
        model = _write_model(beside, model_xml)
        entries = [_write_run(beside, run, file_format) for run in runs]
        entries += [_entry(each.file, each) | {"planned": True} for each in planned]
        whole = {"format": FORMAT, "model": model, "runs": entries}
        text = json.dumps(whole, indent=1, ensure_ascii=False) + "\n"
        beside.joinpath(DESCRIPTION).write_text(text, encoding="utf-8")
        recording = read_recording(beside)
        if target.exists():
            target.rename(old)
        try:
            beside.rename(target)
        except BaseException:  # an interrupt too: what was there goes back
            if old.exists():
                old.rename(target)
            raise
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return replace(recording, folder=target, model_path=target / model)


def check_target(folder: str | Path, *, overwrite: bool = False) -> None:
    """Refuse a folder that a recording cannot be written to.

    Raises
    ------
    InvalidSetting
        If it is a file, or holds something; with ``overwrite``, if that is no recording, or
        something besides the files of one.
    """
    target = Path(folder).resolve()
    if not target.exists():
        return
    if not target.is_dir():
        raise InvalidSetting(f"{target} is a file; a recording is written as a folder")
    if not any(target.iterdir()):
        return
    if not overwrite:
        raise InvalidSetting(
            f"{target} is not empty; give a new or empty folder: a recording is overwritten only "
            "where that is asked for"
        )
    # Nobody's other folder is deleted by a slip.
    if not target.joinpath(DESCRIPTION).is_file():
        raise InvalidSetting(
            f"{target} holds no {DESCRIPTION} and is no recording; it is not overwritten"
        )
    others = _other_files(target)
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        raise InvalidSetting(
            f"{target} holds {', '.join(others[:3])}{more}, which the recording there does not "
            "name and overwriting would delete; move them away, or give a new folder"
        )


def _other_files(folder: Path) -> list[str]:
    """Files in a recording's folder that belong neither to its runs nor to its model."""
    try:
        said = read_description(folder / DESCRIPTION)
    except InvalidData as error:
        raise InvalidSetting(
            f"{folder} is not overwritten, for it cannot be told which of its files are the "
            f"recording's: {error}; move it away, or give a new folder"
        ) from None
    own = {folder / normpath(name) for name in (DESCRIPTION, *(run.file for run in said.runs))}
    model = folder / normpath(said.model)
    own.add(model)
    # A model that does not read names no other files.
    with suppress(InvalidData, OSError):
        own |= files_of(model)
    there = (each for each in folder.rglob("*") if each.is_symlink() or not each.is_dir())
    return sorted(str(each.relative_to(folder)) for each in there if each not in own)


def _write_model(folder: Path, model_xml: str | Path) -> str:
    if isinstance(model_xml, str) and "<" in model_xml:
        folder.joinpath("model.xml").write_text(model_xml, encoding="utf-8")
        return "model.xml"
    file = Path(model_xml).resolve()
    if not file.is_file():
        raise InvalidSetting(f"there is no model {str(model_xml)!r}; give MJCF text or its path")
    copy_files(files_of(file), file.parent, folder)
    return file.name


def _write_run(folder: Path, run: Run, file_format: FileFormat | None) -> dict[str, Any]:
    name = PurePosixPath(run.name)
    ending = name.suffix.lower()
    if file_format is None:
        file_format = "csv" if ending == ".csv" else "parquet"
    if ending in ENDINGS:
        name = name.with_suffix("")
    given = normpath(f"{name}.{file_format}")
    path = inside(folder, given, f"run {run.name!r}")
    if path.exists():
        raise InvalidData(f"run {run.name!r}: there are two files {given!r}; rename the run")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InvalidData(
            f"run {run.name!r}: {str(PurePosixPath(given).parent)!r} is a file of the recording "
            "and no folder; rename the run"
        ) from None
    _WRITERS[file_format](path, table_of(run))
    return _entry(given, run)


def _entry(file: str, run: Run | RunEntry) -> dict[str, Any]:
    entry: dict[str, Any] = {"file": file}
    if run.excited:
        entry["excited"] = list(run.excited)
    if run.pose is not None:
        entry["pose"] = dict(run.pose)
    if run.commands:
        entry["commands"] = {name: vars(timing) for name, timing in run.commands.items()}
    return entry | {"condition": run.condition}
