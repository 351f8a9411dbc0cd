"""Measured runs as they are compared: cut at pauses, aligned with simulation steps, joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from math import ceil
from pathlib import Path

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.result import read_result
from loose_env.importing import median_step
from loose_env.io import json_text, restored, whole_of, write_text
from loose_env.recording import (
    FEWEST_SAMPLES,
    Recording,
    Run,
    read_recording,
    set_aside,
    table_of,
    write_recording,
)
from loose_env.typing import Array

_PAUSE_S = 1.0
"""Shortest time without a row that is a pause [s]: what the machine does in a second without
record is unknown, and a clock that jumps would be simulated through."""
_PAUSE_STEPS = 20.0  # the same in median steps [1]: a slow recorder does not pause between its rows


def measured_runs(runs: Sequence[Run], model: mujoco.MjModel) -> tuple[list[Run], tuple[str, ...]]:
    """Pieces of all runs that are compared, with a note on what was left out."""
    found, words = list[Run](), list[str]()
    for run in runs:
        clean, corrupt = set_aside(run, model)
        pieces = pieces_of(clean)
        words += [each.words for each in corrupt]
        if pieces[0] is not clean:
            count, lost = len(pieces), run.samples - sum(piece.samples for piece in pieces)
            words.append(
                f"{run.name}: no sample for up to {np.max(np.diff(run.time)):.4g} s; compared as "
                f"{count} piece{'s' * (count > 1)} between the pauses"
                + f", without {lost} samples of shorter ones"
                * bool(lost)
            )
        found += pieces
    return found, tuple(words)


def pieces_of(run: Run) -> list[Run]:
    """Cut a run where its recorder paused or its clock jumped; short pieces are left out."""
    steps = np.diff(run.time)
    cuts = np.flatnonzero(steps > max(_PAUSE_S, _PAUSE_STEPS * median_step(run.time))) + 1
    if not len(cuts):
        return [run]
    pieces = [
        replace(run.part(slice(first, last)), name=f"{run.name}, from {run.time[first]:.10g} s")
        for first, last in pairwise([0, *map(int, cuts), run.samples])
        if last - first >= FEWEST_SAMPLES
    ]
    if not pieces:
        raise InvalidData(
            f"{run.name}: {len(cuts)} pauses of up to {steps.max():.4g} s leave no piece of "
            f"{FEWEST_SAMPLES} samples; record the run again, or correct its time stamps"
        )
    return pieces


_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


def steady_activations(model: mujoco.MjModel, command: Array) -> Array:
    """Activations (model.na,) of filters at steady state under a command (actuators,)."""
    # Zero, as MuJoCo starts, where the state does not follow from the command: that of an
    # integrator depends on its unknown initial value, muscles and others on more than their
    # commands.
    found = np.zeros(model.na)
    for k in np.flatnonzero(model.actuator_actnum):
        if int(model.actuator_dyntype[k]) not in _FILTERS or model.actuator_actnum[k] != 1:
            return np.zeros(model.na)
        value = command[k] if k < len(command) else 0.0
        for what in ("ctrl", "act"):
            if getattr(model, f"actuator_{what}limited")[k]:
                value = np.clip(value, *getattr(model, f"actuator_{what}range")[k])
        found[model.actuator_actadr[k]] = value
    return found


SETTLE = 0.4
"""How long an arm that begins at rest is held under its first command, so that springs take their
load [s]."""

_REGULAR = 0.02
"""Largest deviation of a stamp from an even grid, as a share of the sample interval, that counts
as even; or:"""
_ROUNDED = 0.75
"""The same as a share of what the stamps are rounded to: half of it, and a margin for the grid."""
_FINE = 0.25  # rounding of stamps over the sample interval, below which it does not hide a lost row


@dataclass(frozen=True)
class Channel:
    """One scalar column that is compared."""

    column: str  # Column without the axis: "sensor.name" or "torque.name"
    axis: int | None = None  # Axis: 0, 1, 2 for x, y, z of a vector

    @property
    def name(self) -> str:
        """Column name as in the recording, axis included."""
        return self.column if self.axis is None else f"{self.column}.{'xyz'[self.axis]}"


BEFORE_S = 10.0
"""Longest time before a window in which commands are known [s]: a drive follows none for longer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One run, aligned for comparison with a simulation."""

    name: str  # File of the run
    form: str  # "forward", "inverse" or "free"
    time: Array  # Sample times [s], from 0 (T,)
    measured: Array  # Readings of the channels; NaN where nothing was read (T, C)
    step: float  # Simulation step [s]
    steps: int  # Number of simulation steps from the first to the last sample, both included
    controls: Array  # Commands at every step (steps, actuators); zero without commands
    before: Array  # Commands before them, which a drive may still follow (steps, actuators)
    position: Array  # Joint positions at the first sample [rad, m] (joints,)
    speed: Array  # Joint speeds at the first sample [rad/s, m/s] (joints,)
    resting: bool  # Whether the arm is at rest at the first samples, held by its commands

    @property
    def rate(self) -> float:
        """Mean sample rate [1/s]."""
        return (len(self.time) - 1) / float(self.time[-1])

    def between(self, first: int, last: int) -> Trial:
        """Window of the run, from one sample to before another; its caller sets the state."""
        if first <= 0 and last >= len(self.time):
            return self
        begun = round(float(self.time[first]) / self.step)
        time = self.time[first:last] - begun * self.step
        controls = self.controls[begun : begun + ceil(float(time[-1]) / self.step - 1e-6) + 1]
        earlier = self.controls[max(begun - round(BEFORE_S / self.step), 0) : begun]
        part = replace(self, time=time, measured=self.measured[first:last])
        return replace(part, controls=controls, before=earlier, steps=len(controls))

    def at_samples(self, values: Array) -> Array:
        """Interpolate values at the steps (..., steps, C) to the samples (..., T, C)."""
        last = self.steps - 1
        at = np.clip(self.time / self.step, 0, last)
        low = np.minimum(np.floor(at + 1e-6).astype(int), last)
        share = np.clip(at - low, 0.0, 1.0)[:, None]
        if np.all(share < 1e-5):
            return np.asarray(values[..., low, :])
        high = values[..., np.minimum(low + 1, last), :]
        return np.asarray(values[..., low, :] * (1 - share) + high * share)


def channels_of(runs: list[Run]) -> tuple[Channel, ...]:
    """List every column of any run, in the order of its first appearance."""
    found = (
        Channel(f"{prefix}.{name}", axis)
        for run in runs
        for prefix, columns in (("sensor", run.sensors), ("torque", run.torques))
        for name, values in columns.items()
        for axis in ([None] if values.ndim == 1 else range(values.shape[1]))
    )
    return tuple(dict.fromkeys(found))


def _even_interval(time: Array) -> float | None:
    """Sample interval [s] of stamps (T,) that are even but for rounding; None if they are not."""
    number, since = np.arange(len(time)), time - time[0]
    interval, first = np.polyfit(number, since, 1)
    off = float(np.max(np.abs(since - first - interval * number)))
    spacing, steps = float(np.spacing(np.max(np.abs(time)))), 10.0 ** -np.arange(2, 8)
    counts = since / steps[:, None]
    whole = np.abs(counts - np.round(counts)).max(axis=1) <= 1e-3 + spacing / steps
    rounded = float(steps[whole].max(initial=0.0))  # the largest of 10 ms, 1 ms, ... [s]
    rounding = rounded if rounded < _FINE * interval else 0.0
    return float(interval) if off <= max(_REGULAR * interval, _ROUNDED * rounding) else None


def align_run(
    run: Run, machine: NominalModel, channels: tuple[Channel, ...], *, step: float
) -> Trial:
    """Align a run with simulation steps."""
    # Commands are the means over each step of what acts. Stamps that are even but for their
    # rounding become even. The initial state is for the caller to set.
    time, interval = run.time - run.time[0], _even_interval(run.time)
    if interval is not None:
        time = interval * np.arange(len(time))
        step = interval / ceil(interval / step * (1 - 1e-9))
    steps = ceil(float(time[-1]) / step - 1e-6) + 1
    table, unread = table_of(run), np.full(len(time), np.nan)
    measured = np.column_stack([table.get(channel.name, unread) for channel in channels])
    controls = np.zeros((steps, len(machine.actuators)))
    middle = (np.arange(steps, dtype=float) + 0.5) * step
    for k, name in enumerate(machine.actuators):
        if name in run.controls:
            controls[:, k] = run.timing(name).acting(time, run.controls[name], middle)
    return Trial(
        name=run.name, form=run.comparison, time=time, measured=measured, step=step, steps=steps,
        controls=controls, before=controls[:0], position=machine.model.qpos0.copy(),
        speed=np.zeros(machine.model.nv), resting=False,
    )  # fmt: skip


# Recordings of one machine joined as one, those of earlier outputs included

_NOTE = "source.json"  # file in the folder of an output that says which recording a result is of
_FORMAT = "loose-gap-source/1"
_JOINED = "recording"  # folder there with the runs of several recordings


@dataclass(frozen=True)
class _Source:
    """Recording of a result, and the model that took the place of its own."""

    recording: str
    model: str | None = None


def read_source(path: Path, kept: str, *, model: Path | None = None) -> Recording:
    """Read a recording, or that of the output of an earlier comparison.

    Parameters
    ----------
    path : Path
        Folder of a recording, or of an earlier output.
    kept : str
        Name of the folder in an output for what is kept between runs.
    model : Path, optional
        MJCF file that takes the place of the recording's model.

    Raises
    ------
    InvalidData
        If it is neither, or the recording of an output is gone.
    """
    note = path / kept / _NOTE
    if not (path / "result.json").is_file() or (path / "recording.json").exists():
        if path.is_file() and path.suffix == ".xml":
            raise InvalidData(f"{path} is a model and no recording; give it as --model {path}")
        return read_recording(path, model=model)
    read_result(path)
    if not note.is_file():
        raise InvalidData(
            f"{path} holds a result and does not say of which recording (it is of an earlier "
            "version); give the recording in its place"
        )
    whole = whole_of(note.read_text(encoding="utf-8"), format=_FORMAT, noun="note of the recording")
    source = restored(_Source, whole, str(note))
    place = (note.parent / source.recording).resolve()
    if not place.is_dir():
        raise InvalidData(
            f"{path} is the result of the recording {place}, which is gone; give the recording "
            "from where it is now"
        )
    if model is None and source.model is not None:
        model = Path(source.model)
    return read_recording(place, model=model)


def note_source(kept: Path, recording: Recording, model: Path | None) -> None:
    """Note in a folder of checkpoints which recording a result is of."""
    folder = recording.folder
    shown = folder.name if folder.parent == kept.resolve() else str(folder)
    source = _Source(shown, None if model is None else str(model.resolve()))
    write_text(kept / _NOTE, json_text({"format": _FORMAT, **asdict(source)}))


def join_recordings(kept: Path, recordings: Sequence[Recording]) -> Recording:
    """Write the runs of several recordings of one machine as one.

    Parameters
    ----------
    kept : Path
        Folder in which the recording is written.
    recordings : sequence of Recording
        The recordings, the one that came first before the others.

    Returns
    -------
    Recording
        All runs, with the model of the first recording; the names of further ones begin with
        ``next2``, ``next3``, and so on.

    Raises
    ------
    InvalidData
        If the models of two recordings differ.
    """
    first, folder = recordings[0], kept / _JOINED
    text, runs = first.spec().to_xml(), list(first.runs)
    for number, own in enumerate(recordings[1:], start=2):
        if own.spec().to_xml() != text:
            raise InvalidData(
                f"the models of {first.folder} and {own.folder} differ; several recordings are "
                "compared with one model: give it as --model"
            )
        stem = f"next{number}"
        while any(run.name.startswith(f"{stem}-") for run in runs):
            stem += "a"
        runs += [replace(run, name=f"{stem}-{run.name}") for run in own.runs]
    return write_recording(
        folder, model_xml=first.model_path, runs=runs, file_format="parquet",
        overwrite=folder.exists(),
    )  # fmt: skip
