"""Putting measured runs into a recording that was planned."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path, PurePosixPath
from posixpath import normpath

from loose_env.errors import InvalidSetting
from loose_env.recording.recording import (
    DESCRIPTION,
    ENDINGS,
    Description,
    Recording,
    RunEntry,
    read_description,
    read_recording,
)
from loose_env.recording.run import Run
from loose_env.recording.writing import write_recording


def planned_recording(folder: str | Path) -> Description | None:
    """Description of a recording with runs that were planned; None where there is none."""
    file = Path(folder) / DESCRIPTION
    if not file.is_file():
        return None
    said = read_description(file)
    return said if any(each.planned for each in said.runs) else None


def check_measured(
    folder: str | Path, names: Iterable[tuple[str, str]], *, overwrite: bool = False
) -> dict[str, RunEntry]:
    """Find the planned runs of the given names.

    Parameters
    ----------
    folder : str or Path
        A planned recording.
    names : iterable of (str, str)
        Names and conditions of runs; the ending of a name does not count.
    overwrite : bool
        Whether a run that was measured already may be replaced.

    Raises
    ------
    InvalidSetting
        If the recording is not planned, a run is not in the plan or measured already, or one is
        called healthy that is planned as suspect.
    """
    said = planned_recording(folder)
    if said is None:
        raise InvalidSetting(f"{folder} is no planned recording; 'loose plan' makes one")
    planned = {_stem(each.file): each for each in said.runs if each.planned}
    found: dict[str, RunEntry] = {}
    for name, condition in names:
        entry = planned.get(_stem(name))
        if entry is None:
            raise InvalidSetting(
                f"run {name!r} is not in the plan of {folder}, which has {', '.join(planned)}; "
                "name the run so, or give a new folder"
            )
        if condition == "healthy" and entry.condition != "healthy":
            raise InvalidSetting(
                f"run {name!r} is called healthy, and {folder} plans it as suspect; runs of a "
                "healthy day go into a session of their own: 'loose plan MODEL --reference'"
            )
        if not overwrite and (Path(folder) / entry.file).exists():
            raise InvalidSetting(
                f"{Path(folder) / entry.file} was measured already; --overwrite replaces it"
            )
        found[name] = entry
    return found


def write_measured(
    folder: str | Path, runs: Iterable[Run], *, overwrite: bool = False
) -> Recording:
    """Put measured runs into a planned recording, whose model, poses and conditions stay.

    The runs are written beside the folder and read back first: one that does not read changes
    nothing.

    Parameters
    ----------
    folder : str or Path
        A planned recording.
    runs : iterable of Run
        Runs with the names of planned ones; each table has the format that the plan names.
    overwrite : bool
        Whether runs that were measured already are replaced.

    Returns
    -------
    Recording
        All runs that were measured so far.

    Raises
    ------
    InvalidData
        If a run does not fit the model.
    InvalidSetting
        As `check_measured`.
    """
    given = tuple(runs)
    target = Path(folder).resolve()
    entries = check_measured(
        target, ((each.name, each.condition) for each in given), overwrite=overwrite
    )
    named = []
    for each in given:
        entry = entries[each.name]
        named.append(
            replace(
                each,
                name=entry.file,
                excited=entry.excited,
                pose=entry.pose,
                condition=entry.condition,
            )
        )
    beside = target.with_name(f".{target.name}.{os.getpid()}.measured")
    shutil.rmtree(beside, ignore_errors=True)
    try:
        model = target / read_description(target / DESCRIPTION).model
        write_recording(beside, model_xml=model, runs=named, file_format=None)
        for each in named:
            place = target / normpath(each.name)
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(beside / normpath(each.name), place)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return read_recording(target)


def _stem(name: str) -> str:
    """Name of a run without the ending of its table."""
    path = PurePosixPath(normpath(name))
    return str(path.with_suffix("") if path.suffix.lower() in ENDINGS else path)
