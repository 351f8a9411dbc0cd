"""Windows of runs with the most motion, for cheap simulations, and their total length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.data.smoothing import filled
from loose_env.gap.residuals.random_excitation.features import RandomFeatures
from loose_env.gap.residuals.random_excitation.frequency_response import FEWEST
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import SCREENING_RUNS, SCREENING_S

SHORTEST = 1.5
"""Shortest window [s]."""
LEAD = 0.4
"""What is simulated before a window and not compared: late commands and the unknown start [s]."""
INVERSE = 4.0
"""How many times as much is taken of inverse runs: they cost less, and their band is lower."""


def windowed(comparison: ResidualModel, seconds: float) -> ResidualModel:
    """Cut one window from every run, to a total length; a shorter input is unchanged.

    A window lies where the joints move most relative to their typical motion, all joints included.
    Of inverse runs `INVERSE` times as much is taken. A recording of free responses stays whole,
    since their initial states count. If windows would be shorter than `SHORTEST`, runs are left out
    evenly; the last one keeps a window of that length. Of a run that is compared by features a
    window has as many samples as these need, and the run stays whole where the window has no
    features.
    """
    inverse = [t for t in comparison.trials if t.form == "inverse"]
    others = [t for t in comparison.trials if t.form != "inverse"]
    whole = any(t.form == "free" for t in others)
    lengths = _lengths(inverse, INVERSE * seconds, INVERSE * SHORTEST)
    lengths |= _lengths(others, np.inf if whole else seconds, SHORTEST)
    if all(lengths.get(id(t)) == np.inf for t in comparison.trials):
        return comparison
    kept = [
        _shortened(comparison, t, lengths[id(t)]) for t in comparison.trials if id(t) in lengths
    ]
    found = comparison.like(trials=kept)
    numbers = dict(zip(map(id, comparison.trials), comparison.runs.tolist(), strict=True))
    found.runs = np.array([numbers.get(id(trial), -1) for trial in kept], dtype=np.intp)
    return found


def screening_seconds(comparison: ResidualModel) -> float:
    """Total length of the windows on which candidates are screened [s]."""
    return max(SCREENING_S, SHORTEST * min(len(comparison.trials), SCREENING_RUNS))


def windows_as_runs(comparison: ResidualModel, seconds: float) -> ResidualModel:
    """Windows that are the runs from here on, with initial states of their own.

    The whole runs where the windows contain no readings.
    """
    found = windowed(comparison, seconds)
    if not len(found):
        return comparison
    found.runs = np.arange(len(found.trials))
    return found


def _lengths(trials: Sequence[Trial], seconds: float, shortest: float) -> dict[int, float]:
    """Window lengths [s] by identity of the run; infinite where runs are short."""
    if sum(float(t.time[-1]) for t in trials) <= seconds:
        return {id(t): np.inf for t in trials}
    count = max(1, min(len(trials), int(seconds / shortest)))
    taken = np.unique(np.linspace(0, len(trials) - 1, count).round().astype(int))
    return {id(trials[k]): max(seconds / count, shortest) for k in taken}


def _shortened(comparison: ResidualModel, trial: Trial, length: float) -> Trial:
    """Window of a run; all of it if compared by features that the window lacks.

    The command may not vary in a window, or its channels may not have been read.
    """
    if trial.form == "inverse":
        return _window(trial, length, lead=0.0)
    if not (trial.excited and trial.name in comparison.chaotic):
        return _window(trial, length)
    window = _window(trial, length, fewest=FEWEST)
    try:
        RandomFeatures.of_trial(window, comparison.machine, comparison.channels, comparison.read)
    except InvalidData:
        return trial
    return window


def _window(trial: Trial, length: float, *, fewest: int = 1, lead: float = LEAD) -> Trial:
    """Window of maximum motion, of a length [s] and minimum number of samples."""
    size = max(round(min(length * trial.rate, len(trial.time))), fewest)
    if size >= len(trial.time):
        return trial
    activity = np.zeros(len(trial.time))
    for values in trial.motion.values():
        if np.isfinite(values).sum() < 2:
            continue
        read = filled(trial.time, values, trial.time)  # a dropout is no motion
        change = np.abs(np.diff(read, prepend=read[:1]))
        # Square roots: a window in which several joints move is more informative than one fast
        # swing.
        activity += np.sqrt(change / max(float(np.mean(change)), 1e-12))
    summed = np.concatenate([[0.0], np.cumsum(activity)])
    starts = np.arange(0, len(trial.time) - size, max(size // 8, 1))
    first = int(starts[np.argmax(summed[starts + size] - summed[starts])])
    before = min(first, round(lead * trial.rate))
    window = trial.between(first - before, first + size)
    measured = window.measured.copy()
    measured[:before] = np.nan
    return replace(window, measured=measured)
