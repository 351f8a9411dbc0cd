"""Longest unbroken piece of a run: cut at recording gaps, never interpolated across."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing import median_step
from loose_env.instrument.settings.thresholds import BRIDGED_STEPS, FEWEST_SAMPLES, LONGEST_RUN_S
from loose_env.recording import Run
from loose_env.typing import Array


def unbroken(run: Run, columns: Mapping[str, Array]) -> tuple[Run, tuple[str, ...]]:
    """Cut a run to the longest piece in which no column pauses.

    Rows that are not there and samples that are missing (NaN) are the same. A few of them in a row
    are no pause: up to ten steps of the column itself.

    Examples
    --------
    >>> time = np.concatenate([np.arange(100), np.arange(500, 700)]) / 100
    >>> run = Run(name="a.csv", time=time, sensors={"q": np.sin(time)})
    >>> piece, notes = unbroken(run, {"sensor.q": run.sensors["q"]})
    >>> piece.samples, *notes
    (200, 'a.csv: no sample of sensor.q from 0.99 to 5 s; only the 1.99 s from 5 s on are used')
    """
    _refuse_stamps(run)
    broken = np.zeros(run.samples - 1, dtype=bool)
    longest, where = 0.0, ""
    for name, column in columns.items():
        for first, last in _pauses(run.time, column):
            broken[first:last] = True
            if run.time[last] - run.time[first] > longest:
                longest = float(run.time[last] - run.time[first])
                ends = f"{run.time[first]:.6g} to {run.time[last]:.6g} s"
                where = f"{run.name}: no sample of {name} from {ends}"
    if not where:
        return run, ()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], broken, [True]])))
    starts, stops = edges[::2], edges[1::2]
    if not len(starts) or (stops - starts).max() + 1 < FEWEST_SAMPLES:
        raise InvalidData(
            f"{where}, and no piece of the run without a pause has the {FEWEST_SAMPLES} samples "
            "that are needed; record it again, or leave the column out"
        )
    best = int(np.argmax(stops - starts))
    rows = slice(int(starts[best]), int(stops[best]) + 1)
    begin, end = float(run.time[rows][0]), float(run.time[rows][-1])
    piece = f"{end - begin:.6g} s from {begin:.6g} s on"
    return run.part(rows), (f"{where}; only the {piece} are used",)


def _refuse_stamps(run: Run) -> None:
    if run.samples < FEWEST_SAMPLES:
        raise InvalidData(
            f"{run.name}: a run of {run.samples} samples is too short to be used; "
            f"{FEWEST_SAMPLES} are needed"
        )
    if not (np.isfinite(run.time).all() and (np.diff(run.time) > 0).all()):
        raise InvalidData(f"{run.name}: column 'time' has to be finite and to increase strictly")
    span = float(run.time[-1] - run.time[0])
    if span <= LONGEST_RUN_S:
        return
    row = int(np.argmax(np.diff(run.time))) + 1
    raise InvalidData(
        f"{run.name}: column 'time' goes from {run.time[row - 1]:.6g} to {run.time[row]:.6g} s at "
        f"row {row + 1}, and {span:.3g} s in all; no run lasts longer than a day: correct the "
        "stamp, or give all in seconds"
    )


def _pauses(time: Array, column: Array) -> list[tuple[int, int]]:
    """Start and end rows of the dropouts of a column."""
    there = np.flatnonzero(np.isfinite(column))
    if len(there) < 2:
        return []  # nothing that could pause: the column is not used, or all zeros
    longest = BRIDGED_STEPS * median_step(time[there])
    found = [
        (int(there[k]), int(there[k + 1])) for k in np.flatnonzero(np.diff(time[there]) > longest)
    ]
    if time[there[0]] - time[0] > longest:
        found.append((0, int(there[0])))
    if time[-1] - time[there[-1]] > longest:
        found.append((int(there[-1]), len(time) - 1))
    return found
