"""Corrections of a recording that findings offer, and the corrected recording written."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from posixpath import normpath
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from loose_env.arms import copy_files, files_of
from loose_env.errors import InvalidSetting
from loose_env.recording import (
    DESCRIPTION,
    Recording,
    Run,
    RunEntry,
    read_description,
    write_recording,
)
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class Correction:
    """One change of a recording that removes a defect."""

    kind: Literal["scale", "unwrap", "exchange", "shift", "gravity"]
    """``"scale"``: a column is multiplied by ``factor``. ``"unwrap"``: turns that an encoder lost
    are put back. ``"exchange"``: two columns change places.
    ``"shift"``: a column is read ``seconds`` later. ``"gravity"``: the model's gravity is
    ``vector``."""
    columns: tuple[str, ...] = ()
    """Columns that are changed."""
    factor: float = 1.0
    """Factor of ``"scale"``."""
    seconds: float = 0.0
    """Lateness of the columns, taken out by ``"shift"`` [s]."""
    vector: tuple[float, float, float] | None = None
    """Gravity of ``"gravity"`` [m/s²]."""
    runs: tuple[str, ...] = ()
    """Runs whose columns are changed; all where it is empty."""

    def of(self, run: str) -> Correction:
        """Return the same change of one run alone; of all runs for ""."""
        return replace(self, runs=(run,)) if run else self

    @property
    def words(self) -> str:
        """The change, as a reader is told of it."""
        names = " and ".join(self.columns)
        if self.runs:
            names += f" of {' and '.join(self.runs)}"
        if self.kind == "scale":
            return f"{names} multiplied by {self.factor:.6g}"
        if self.kind == "unwrap":
            return f"the lost turns of {names} put back"
        if self.kind == "exchange":
            return f"{names} exchanged"
        if self.kind == "shift":
            return f"{names} moved {1e3 * self.seconds:.4g} ms towards the start"
        return f"gravity of the model set to {np.round(self.vector or (), 3).tolist()} m/s²"


def write_corrected(
    recording: Recording, corrections: Iterable[Correction], folder: str | Path
) -> Recording:
    """Write a recording with corrections applied beside the one that was read.

    Parameters
    ----------
    recording : Recording
        The recording as read; it is not changed.
    corrections : iterable of Correction
        Changes; equal ones count once for each run.
    folder : str or Path
        New or empty folder.

    Returns
    -------
    Recording
        The corrected one. Its runs keep their format and the time of measurement, that of their
        files; runs that are planned and not measured yet stay planned.

    Raises
    ------
    InvalidSetting
        If there is nothing to correct, or the folder holds something.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="q" joint="turn"/></sensor></mujoco>'''
    >>> run = Run(name="a.csv", time=np.arange(20) / 100, sensors={"q": np.full(20, 90.0)})
    >>> with TemporaryDirectory() as place:
    ...     read = write_recording(Path(place, "degrees"), model_xml=xml, runs=[run])
    ...     fix = Correction(kind="scale", columns=("sensor.q",), factor=np.pi / 180)
    ...     made = write_corrected(read, [fix], Path(place, "radians"))
    >>> made.runs[0].sensors["q"][0].round(4)
    np.float64(1.5708)
    """
    chosen = list(dict.fromkeys(corrections))
    if not chosen:
        raise InvalidSetting(
            f"no finding on {recording.folder.name} offers a correction; nothing is written"
        )
    runs = [corrected(run, chosen) for run in recording.runs]
    planned = _planned(recording)
    gravity = [each.vector for each in chosen if each.vector is not None]
    with TemporaryDirectory() as place:
        model = recording.model_path
        if gravity:
            model = _with_gravity(model, gravity[-1], Path(place))
        made = write_recording(
            folder, model_xml=model, runs=runs, planned=planned, file_format=None
        )
    for before, after in zip(recording.runs, made.runs, strict=True):
        source = recording.folder / before.name
        if source.is_file():
            read = source.stat()
            os.utime(made.folder / after.name, ns=(read.st_atime_ns, read.st_mtime_ns))
    return made


def _planned(recording: Recording) -> list[RunEntry]:
    """Entries of the runs that are still to be measured."""
    file = recording.folder / DESCRIPTION
    if not file.is_file():
        return []
    measured = {run.name for run in recording.runs}
    entries = read_description(file).runs
    return [each for each in entries if each.planned and normpath(each.file) not in measured]


def corrected(run: Run, corrections: Sequence[Correction]) -> Run:
    """Run with the columns changed as corrections of all runs, or of it, say."""
    groups = {"ctrl": dict(run.controls), "sensor": dict(run.sensors), "torque": dict(run.torques)}
    own = (replace(c, runs=()) for c in corrections if not c.runs or run.name in c.runs)
    for each in dict.fromkeys(own):
        parts = [column.partition(".") for column in each.columns]
        there = [(groups[p], name) for p, _, name in parts if name in groups[p]]
        if each.kind == "exchange" and len(there) == 2:
            (first, a), (second, b) = there
            first[a], second[b] = second[b], first[a]
        for group, name in there:
            if each.kind == "scale":
                group[name] = group[name] * each.factor
            elif each.kind == "unwrap":
                good = np.isfinite(group[name])
                group[name] = np.array(group[name])
                group[name][good] = np.unwrap(group[name][good])
            elif each.kind == "shift":
                group[name] = _shifted(run.time, group[name], each.seconds)
    return replace(run, controls=groups["ctrl"], sensors=groups["sensor"], torques=groups["torque"])


def _shifted(time: Array, values: Array, seconds: float) -> Array:
    """Values that were recorded some time later, missing where none was recorded."""
    good = np.isfinite(values)
    if not good.any():
        return values
    moved = np.interp(time + seconds, time[good], values[good], left=np.nan, right=np.nan)
    return np.where(np.interp(time + seconds, time, good.astype(float)) > 0.5, moved, np.nan)


def _with_gravity(model: Path, vector: tuple[float, float, float], place: Path) -> Path:
    """Copy of a model with all its files, in which gravity points elsewhere."""
    copy_files(files_of(model), model.parent, place)
    file = place / model.name
    tree = ET.parse(file)
    # The last of several options holds.
    ET.SubElement(tree.getroot(), "option", gravity=" ".join(f"{g:.6g}" for g in vector))
    tree.write(file, encoding="utf-8")
    return file
