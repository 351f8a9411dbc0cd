"""Runs without corrupt samples, cut into pieces at pauses, with notes on what is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing import median_step
from loose_env.recording import FEWEST_SAMPLES, Run, set_aside

_PAUSE_S = 1.0
"""Shortest time without a row that is a pause [s]: what the machine does in a second without
record is unknown, and a clock that jumps would be simulated through."""
_PAUSE_STEPS = 20.0
"""The same in median steps [1]: a slow recorder does not pause between its rows."""
_PIECE = ", from "
"""Between the file and the start of a piece in its name."""


def measured_runs(
    runs: Sequence[Run], model: mujoco.MjModel
) -> tuple[list[list[Run]], tuple[str, ...]]:
    """Pieces of every run that are compared, with a note on what was left out."""
    found, words = [], []
    for run in runs:
        clean, corrupt = set_aside(run, model)
        pieces = pieces_of(clean)
        words += [each.words for each in corrupt]
        if pieces[0] is not clean:
            lost = run.samples - sum(piece.samples for piece in pieces)
            longest = float(np.max(np.diff(run.time)))
            words.append(
                f"{run.name}: no sample for up to {longest:.4g} s; compared as {len(pieces)} "
                f"piece{'s' * (len(pieces) > 1)} between the pauses"
                + (f", without {lost} samples of shorter ones" if lost else "")
            )
        found.append(pieces)
    return found, tuple(words)


def file_of(name: str) -> str:
    """File of a run or of a piece of one.

    Examples
    --------
    >>> file_of("run-3.csv, from 50 s"), file_of("run-4.csv")
    ('run-3.csv', 'run-4.csv')
    """
    return name.rpartition(_PIECE)[0] or name


def pieces_of(run: Run) -> list[Run]:
    """Cut a run where its recorder paused or its clock jumped.

    Pieces of fewer than `FEWEST_SAMPLES` are left out.

    Examples
    --------
    >>> time = np.concatenate([np.arange(100), np.arange(5000, 5200)]) / 100
    >>> run = Run(name="a.csv", time=time, sensors={"q": np.sin(time)})
    >>> [(piece.name, piece.samples) for piece in pieces_of(run)]
    [('a.csv, from 0 s', 100), ('a.csv, from 50 s', 200)]
    """
    steps = np.diff(run.time)
    cuts = np.flatnonzero(steps > max(_PAUSE_S, _PAUSE_STEPS * median_step(run.time))) + 1
    if not len(cuts):
        return [run]
    edges = [0, *map(int, cuts), run.samples]
    pieces = [
        replace(run.part(slice(first, last)), name=f"{run.name}{_PIECE}{run.time[first]:.10g} s")
        for first, last in pairwise(edges)
        if last - first >= FEWEST_SAMPLES
    ]
    if not pieces:
        raise InvalidData(
            f"{run.name}: {len(cuts)} pauses of up to {steps.max():.4g} s leave no piece of "
            f"{FEWEST_SAMPLES} samples; record the run again, or correct its time stamps"
        )
    return pieces
