"""Residual split into time series by run and channel, their spectra and averages in bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.residuals.residual_model import Rows
from loose_env.typing import Array

_SEGMENT = 2.0
"""Length of the segments whose spectra are averaged [s]."""
_POINTS = 60
"""Points of a spectrum that is drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Residual of one channel in one run."""

    run: str
    """File of the run."""
    trial: int
    """Index of the run among the trials."""
    channel: str
    """Name of the channel, as in the recording."""
    sample: NDArray[np.intp]
    """Indices of the samples in the run (N,)."""
    time: Array
    """Times of these samples [s] (N,)."""
    residual: Array
    """Measured less predicted, in noise standard deviations (N,)."""
    block: NDArray[np.intp]
    """Block of time (N,)."""

    @property
    def rms(self) -> float:
        """Root mean square, in noise standard deviations."""
        return float(np.sqrt(np.mean(self.residual**2)))


def series_of(
    residual: Array, rows: Rows, trials: Sequence[Trial], channels: Sequence[Channel]
) -> list[Series]:
    """Split a residual vector (N,) by run and channel.

    Those without a sample are left out, and runs that are compared by features.
    """
    found = []
    for t, trial in enumerate(trials):
        own = np.flatnonzero((rows.trial == t) & ~rows.is_feature)
        for c, channel in enumerate(channels):
            here = own[rows.channel[own] == c]
            if not len(here):
                continue
            order = here[np.argsort(rows.sample[here], kind="stable")]
            sample = rows.sample[order]
            found.append(
                Series(
                    run=trial.name,
                    trial=t,
                    channel=channel.name,
                    sample=sample,
                    time=trial.time[sample],
                    residual=residual[order],
                    block=rows.block[order],
                )
            )
    return found


def density(series: Series) -> tuple[Array, Array]:
    """Spectral density of a series, over that of white noise of unit variance.

    The series is resampled to a uniform grid first, with linear interpolation over missing samples.
    """
    count = len(series.time)
    if count < 16:
        return np.zeros(0), np.zeros(0)
    span = float(series.time[-1] - series.time[0])
    interval = float(np.median(np.diff(series.time)))
    clock = series.time[0] + interval * np.arange(int(span / interval + 1e-6) + 1)
    even = np.interp(clock, series.time, series.residual)
    rate = 1.0 / interval
    size = min(len(even), max(16, round(_SEGMENT * rate)))
    frequency, power = welch(even, rate, nperseg=size, detrend=False)
    return frequency[1:], power[1:] * rate / 2


def mean_spectrum(many: Sequence[Series]) -> tuple[Array, Array]:
    """Average the spectra of several series of one channel, on the first one's grid."""
    found = [density(series) for series in many]
    found = [f for f in found if len(f[0])]
    if not found:
        return np.zeros(0), np.zeros(0)
    frequency = min((f[0] for f in found), key=lambda f: f[-1])
    return frequency, np.mean([np.interp(frequency, *each) for each in found], axis=0)


def spectrum(many: Sequence[Series], *, points: int = _POINTS) -> tuple[Array, Array]:
    """Mean spectrum in bands of even width on a logarithmic axis (K,), (K,)."""
    return in_bands(*mean_spectrum(many), points=points)


def in_bands(frequency: Array, power: Array, *, points: int = _POINTS) -> tuple[Array, Array]:
    """Average a spectrum (K,), (K,) in bands of equal width on a logarithmic axis."""
    if len(frequency) < 2:
        return frequency, power
    edges = np.geomspace(frequency[0] * 0.999, frequency[-1] * 1.001, points + 1)
    band = np.searchsorted(edges, frequency) - 1
    filled = np.unique(band)
    return (
        np.array([np.exp(np.mean(np.log(frequency[band == b]))) for b in filled]),
        np.array([np.mean(power[band == b]) for b in filled]),
    )


def band_edges(highest: float) -> list[float]:
    """Edges of the frequency bands [Hz]: 0, 1, 3, 10, ... and half the rate.

    Examples
    --------
    >>> band_edges(50.0)
    [0.0, 1.0, 3.0, 10.0, 30.0, 50.0]
    """
    edges, value = [0.0], 1.0
    while value < 0.9 * highest:
        edges.append(value)
        value = value * 3 if len(edges) % 2 == 0 else value * 10 / 3
    return [*(float(round(e, 6)) for e in edges), float(highest)]
