"""A recording: measured runs and the nominal model, read from a folder and checked."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from posixpath import normpath
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
from annotated_types import MinLen
from pydantic import AfterValidator, BeforeValidator, ConfigDict

from loose_env.arms import compile_spec, load_spec, require_numbers
from loose_env.errors import InvalidData
from loose_env.io import restored, whole_of
from loose_env.recording.model_columns import ModelColumns, add_joint_columns
from loose_env.recording.run import CommandTiming, Condition, Run
from loose_env.recording.tables import (
    check_numbers,
    existing_file,
    inside,
    read_csv,
    read_parquet,
    read_text,
)

DESCRIPTION = "recording.json"
"""File that makes a folder a recording."""
FORMAT = "loose-recording/1"
"""The format read and written here."""
ENDINGS = {".parquet": read_parquet, ".csv": read_csv}
"""Endings of a run's file, and what reads it."""

_MOST_BYTES = 2**24


def _finite(value: float) -> float:
    if not np.isfinite(value):
        raise ValueError("a finite position in rad or m is needed")
    return value


def _each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise ValueError("a joint stands twice")
    return names


def _given(value: Any) -> Any:
    if value is None:
        raise ValueError("a mapping of joints and positions is needed; leave the key out")
    return value


_Name = Annotated[str, MinLen(1)]
_Pose = Annotated[
    Mapping[_Name, Annotated[float, AfterValidator(_finite)]] | None, BeforeValidator(_given)
]


@dataclass(frozen=True, kw_only=True)
class RunEntry:
    """What ``recording.json`` says of one run."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    file: _Name
    """Table of the run, from the recording's folder."""
    excited: Annotated[tuple[_Name, ...], AfterValidator(_each_once)] = ()
    """Joints driven with random noise."""
    pose: _Pose = None
    """Positions that the joints are held at [rad or m]."""
    condition: Condition = "suspect"
    """"healthy" where the run is a reference taken before the fault."""
    commands: Mapping[_Name, CommandTiming] = field(default_factory=dict)
    """Actuators whose commands are not held from sample to sample, and how they act."""
    planned: bool = False
    """True for a run that is left out as long as its file is not there."""


@dataclass(frozen=True, kw_only=True)
class Description:
    """The content of ``recording.json``."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    format: Literal["loose-recording/1"]
    """Format of the file."""
    model: _Name
    """Model of the machine, from the recording's folder."""
    runs: Annotated[tuple[RunEntry, ...], MinLen(1)]
    """The runs, at least one."""


def read_description(file: Path) -> Description:
    """Read ``recording.json``; whether its names exist in the model is not looked at here.

    Raises
    ------
    InvalidData
        If it is not UTF-8, not JSON, or not this format: a key missing, unknown or twice, a
        value of another type, a number that is not finite.
    """
    text = read_text(file, DESCRIPTION, _MOST_BYTES)
    try:
        whole = whole_of(text, format=FORMAT, noun="description")
    except InvalidData as error:
        raise InvalidData(f"{DESCRIPTION}: {error}") from None
    return restored(Description, whole, f"{DESCRIPTION}:")


_FINITE = (
    "actuator_gainprm actuator_biasprm actuator_dynprm actuator_gear actuator_ctrlrange "
    "actuator_forcerange dof_frictionloss geom_size"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Runs of one machine and the model they are compared with."""

    folder: Path
    """Where it was read, resolved."""
    model_path: Path
    """MJCF file of the nominal model, or of the one that replaces it."""
    runs: tuple[Run, ...]
    """The runs, in the order of ``recording.json``."""

    def spec(self) -> mujoco.MjSpec:
        """Read the model anew, for edits of one's own.

        Raises
        ------
        InvalidData
            If the file was changed since and cannot be read.
        """
        return load_model(self.model_path)[0]

    def model(self) -> mujoco.MjModel:
        """Compile the model anew.

        Raises
        ------
        InvalidData
            If the file was changed since and does not compile.
        """
        return load_model(self.model_path)[1]


def read_recording(folder: str | Path, *, model: str | Path | None = None) -> Recording:
    """Read a recording of the format ``loose-recording/1`` and check all of it.

    In errors a row is a sample, counted from 1; the header is row 0. For CSV the line of the
    file is given too.

    Parameters
    ----------
    folder : str or Path
        Folder with ``recording.json``.
    model : str or Path, optional
        MJCF file that replaces the recording's model; its names have to be those of the columns.

    Returns
    -------
    Recording
        Runs as float64 arrays, with NaN where a sample is missing.

    Raises
    ------
    InvalidData
        If the folder holds no such recording. The message names the file, the column and the
        row.
    InvalidSetting
        If ``model`` is given and there is no such file.

    Examples
    --------
    >>> import tempfile
    >>> from loose_env.recording import write_recording
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> time = np.arange(20) / 100
    >>> run = Run(name="swing.csv", time=time, sensors={"encoder": np.cos(time)})
    >>> with tempfile.TemporaryDirectory() as place:
    ...     _ = write_recording(Path(place, "swings"), model_xml=xml, runs=[run])
    ...     recording = read_recording(Path(place, "swings"))
    ...     recording.runs[0].comparison, recording.model().nv
    ('free', 1)
    """
    try:
        home = Path(folder).resolve()
        there = home.is_dir()
    except (OSError, RuntimeError, TypeError, ValueError) as error:
        raise InvalidData(f"{folder!r} is no folder: {error}") from None
    if not there:
        words = f"there is no folder {str(folder)!r}; a recording is a folder"
        raise InvalidData(f"{words}; 'loose import' makes one from a log")
    if not os.path.lexists(home / DESCRIPTION):
        hint = f"there is no file {DESCRIPTION!r} in {home}; 'loose import' makes one from a log"
        raise InvalidData(f"{home.name}: {hint}")
    description = read_description(existing_file(home, DESCRIPTION, f"{home.name}"))
    if model is None:
        model = existing_file(home, description.model, f"{DESCRIPTION}: model")
    model_path = Path(model)
    compiled = load_model(model_path)[1]
    columns = ModelColumns.of(compiled)
    files: dict[tuple[int, int], str] = {}
    found = []
    for i, entry in enumerate(description.runs):
        place = f"{DESCRIPTION}: runs[{i}]"
        if entry.planned and not inside(home, entry.file, f"{place}.file").exists():
            continue
        hint = '; a run that is still to be measured has "planned": true'
        path = existing_file(home, entry.file, f"{place}.file", hint)
        # By what lies on the disk: a link, or another way of writing the path, is the same run.
        state = path.stat()
        name = normpath(entry.file)
        if (state.st_dev, state.st_ino) in files:
            first = files[state.st_dev, state.st_ino]
            raise InvalidData(f"{place}.file: {entry.file!r} is the same file as {first!r}")
        files[state.st_dev, state.st_ino] = entry.file
        found.append((place, path, name, entry))
    if not found:
        names = ", ".join(entry.file for entry in description.runs)
        raise InvalidData(f"{DESCRIPTION}: none of the planned runs has been measured: {names}")
    runs = tuple(_run(*arguments, columns) for arguments in found)
    return Recording(folder=home, model_path=model_path.resolve(), runs=runs)


def _run(place: str, path: Path, name: str, entry: RunEntry, columns: ModelColumns) -> Run:
    ending = Path(name).suffix.lower()
    if ending not in ENDINGS:
        raise InvalidData(f"{place}.file: {entry.file!r} has to end in {' or '.join(ENDINGS)}")
    for i, joint in enumerate(entry.excited):
        columns.check_joint(f"{place}.excited[{i}]", joint)
    for joint in entry.pose or {}:
        columns.check_joint(f"{place}.pose", joint)
    for drive in entry.commands:
        columns.check_command(f"{place}.commands", drive)
    table = ENDINGS[ending](path, name, partial(columns.check_header, name))
    check_numbers(table)
    return Run(
        name=name,
        time=table.columns["time"],
        **columns.grouped(table.columns),
        excited=entry.excited,
        pose=entry.pose,
        condition=entry.condition,
        commands=entry.commands,
    )


def load_model(
    path: Path, *, package: str | Path | None = None
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Model of a recording as specification and compiled, an MJCF or URDF.

    A URDF, which has neither sensors nor actuators, gets those of its joints (`add_joint_columns`).

    Parameters
    ----------
    path : Path
        The file.
    package : str or Path, optional
        Folder of the ROS package, or packages, in which the meshes of a URDF lie.

    Raises
    ------
    InvalidData
        If it cannot be read, or has numbers that are not finite.
    """
    try:
        file, kind, spec = load_spec(path, package=package)
    except OSError as error:
        raise InvalidData(f"{path.name}: it cannot be read: {error.strerror or error}") from None
    if kind != "mujoco":
        add_joint_columns(spec)
    model = compile_spec(spec, file)
    require_numbers(model, (), file)
    for name in _FINITE.split():
        if not np.isfinite(getattr(model, name)).all():
            raise InvalidData(f"{file.name}: {name} has to be finite")
    return spec, model
