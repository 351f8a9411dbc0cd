"""How much of what measured spectra have beyond a model's another model explains.

When a stop is struck depends on the last digit of a gap; how often and how hard does not. So where
a part slides, what a simulation makes of a run is compared with it by spectra, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from loose_env.gap.comparison import Comparison
from loose_env.gap.hypothesis import Hypothesis

__all__ = ["log_distance", "spectral_share"]

Array = NDArray[np.float64]

_SEGMENT = 256
"""Samples of a segment of Welch's method."""
_FEWEST = 4
"""Fewest segments of a run."""
_ABOVE = 25.0
"""A line counts where one of the spectra is so many times the noise."""


def spectral_share(
    comparisons: Sequence[Comparison], before: Hypothesis, after: Hypothesis
) -> float:
    """Share of the distance of spectra between runs and one hypothesis that another explains.

    Parameters
    ----------
    comparisons : sequence of Comparison
        Runs; those that are simulated with their commands count.
    before, after : Hypothesis
        The hypotheses.

    Returns
    -------
    float
        1: the spectra are the same; 0: as far off as before; 0 also where nothing was off before.
        Estimates of spectra scatter, so that it stays below 1 where blows are no more than alike.
    """
    off = np.zeros(2)
    for comparison in comparisons:
        floors = np.asarray(comparison.floors, dtype=float)
        predicted = comparison.predict([before, after])
        for t, trial in enumerate(comparison.trials):
            if trial.form != "forward":
                continue
            seen = np.flatnonzero(np.isfinite(trial.measured).all(axis=0))
            for c in seen.tolist():
                both = [p[t][:, c] for p in predicted]
                if all(np.isfinite(p).all() for p in both):
                    off += [log_distance(trial.measured[:, c], p, floors[c]) for p in both]
    return float(1 - off[1] / off[0]) if off[0] > 0 else 0.0


def log_distance(measured: Array, predicted: Array, floor: float) -> float:
    """Sum of the squared logarithms by which two spectra differ, line by line.

    Parameters
    ----------
    measured, predicted : ndarray (T,)
        A reading, and what a simulation makes of it without noise.
    floor : float
        Standard deviation of the reading's white noise.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> one, two = rng.normal(size=(2, 20_000))
    >>> log_distance(one, two, 0.01) < 0.05 * log_distance(one, 3 * two, 0.01)
    True
    """
    size = min(_SEGMENT, len(measured) // _FEWEST)
    if size < 8:
        return 0.0
    _, own = signal.welch(measured, nperseg=size)
    _, other = signal.welch(predicted, nperseg=size)
    noise = 2 * floor**2  # one-sided, per sample
    own, other = own[1:], other[1:]
    counted = np.maximum(own, other) > _ABOVE * noise
    ratios = np.log(np.maximum(own, 1e-3 * noise)[counted] / (other + noise)[counted])
    return float(np.sum(ratios**2))
