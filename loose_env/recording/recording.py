"""A recording: measured runs and the nominal model, read from a folder and checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from posixpath import normpath

import mujoco
import numpy as np

from loose_env.arms import compile_spec, load_spec, require_numbers
from loose_env.errors import InvalidData
from loose_env.recording.columns import ModelColumns
from loose_env.recording.csv_file import read_csv
from loose_env.recording.description import DESCRIPTION, RunEntry, read_description
from loose_env.recording.folder import existing_file, inside
from loose_env.recording.parquet_file import read_parquet
from loose_env.recording.run import Run
from loose_env.recording.sensor_roles import (
    JointSensors,
    add_joint_columns,
    check_comparison,
    joint_sensors,
)
from loose_env.recording.table import check_numbers

__all__ = ["ENDINGS", "Recording", "load_model", "read_recording"]

ENDINGS = {".parquet": read_parquet, ".csv": read_csv}
"""Endings of a run's file, and what reads it."""

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

    def joint_sensors(self) -> dict[str, JointSensors]:
        """Sensors that measure position and velocity of each joint of the model."""
        return joint_sensors(self.model())

    def check_comparison(self) -> None:
        """Refuse runs that lack the joint positions which their comparison rests on.

        Raises
        ------
        InvalidData
            As `loose_env.recording.check_comparison`, of the first such run.
        """
        model = self.model()
        for run in self.runs:
            check_comparison(model, run)


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
        hint = "; 'loose import' makes one from a log" if home.is_file() else ""
        raise InvalidData(f"there is no folder {str(folder)!r}; a recording is a folder{hint}")
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
        path = existing_file(home, entry.file, f"{place}.file")
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
    table = ENDINGS[ending](path, name, partial(columns.check_header, name))
    check_numbers(table)
    groups = columns.grouped(table.columns)
    return Run(
        name=name,
        time=table.columns["time"],
        controls=groups["controls"],
        sensors=groups["sensors"],
        torques=groups["torques"],
        excited=entry.excited,
        pose=entry.pose,
        condition=entry.condition,
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
