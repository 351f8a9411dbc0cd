"""Residual tests by channel: autocorrelation (whiteness), trend, and dependence on regressors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion
from loose_env.gap.diagnostics.localisation import depends_on
from loose_env.gap.diagnostics.residual_spectra import Series, series_of
from loose_env.gap.output.evidence_schema import ResidualTest
from loose_env.gap.residuals.residual_model import Rows
from loose_env.gap.settings import (
    DEPENDENCE_RMS,
    DEPENDENCE_Z,
)
from loose_env.typing import Array

_LAGS = 50
"""Lags of the autocorrelation that is looked at."""


def autocorrelation(residual: Array, *, lags: int = _LAGS) -> Array:
    """Autocorrelation (lags,) of an evenly sampled residual (T,) at 1, 2, ... samples.

    Examples
    --------
    >>> swing = np.sin(2 * np.pi * np.arange(4000) / 20)
    >>> [round(float(r), 2) for r in autocorrelation(swing, lags=20)[[0, 9, 19]]]
    [0.95, -1.0, 1.0]
    """
    centred = residual - residual.mean()
    power = float(centred @ centred)
    lags = min(lags, len(centred) - 1)
    if power <= 0 or lags < 1:
        return np.zeros(max(lags, 0))
    size = 1 << (2 * len(centred) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    return np.asarray(np.fft.irfft(spectrum, size)[1 : lags + 1] / power)


def residual_tests(
    residual: Array,
    rows: Rows,
    trials: Sequence[Trial],
    channels: Sequence[Channel],
    motions: Sequence[JointMotion],
) -> tuple[ResidualTest, ...]:
    """Test the residuals of some runs for whiteness, channel by channel."""
    by_channel: dict[str, list[Series]] = {}
    for series in series_of(residual, rows, trials, channels):
        by_channel.setdefault(series.channel, []).append(series)
    return tuple(_test(name, many, motions) for name, many in by_channel.items())


def _test(name: str, many: Sequence[Series], motions: Sequence[JointMotion]) -> ResidualTest:
    usable = [s for s in many if len(s.residual) > 2 * _LAGS] or list(many)
    weights = np.array([len(s.residual) for s in usable], dtype=float)
    lags = min(_LAGS, *(len(s.residual) - 1 for s in usable))
    found = np.array([autocorrelation(s.residual, lags=lags) for s in usable])
    mean = weights @ found / weights.sum()
    count = int(weights.sum())
    # Of `lags` independent normal numbers the largest stays below this 95 times in 100.
    limit = float(np.sqrt(2 * np.log(lags / 0.0513)) / np.sqrt(count)) if lags else 0.0
    intervals = [float(np.median(np.diff(s.time))) for s in usable if len(s.time) > 1]
    interval = float(np.median(intervals)) if intervals else 0.0
    positive = mean[: int(np.argmax(mean <= limit))] if (mean <= limit).any() else mean
    trend, trend_z = _trend(many)
    power = np.concatenate([s.residual for s in many])
    return ResidualTest(
        channel=name,
        rms=float(np.sqrt(np.mean(power**2))),
        autocorrelation=float(mean[0]) if lags else 0.0,
        whiteness_95=limit,
        largest_autocorrelation=float(np.abs(mean).max()) if lags else 0.0,
        correlation_time=interval * (1 + 2 * float(positive.sum())),
        trend=trend,
        trend_z=trend_z,
        dependences=tuple(
            d
            for d in depends_on(many, motions)
            if d.z >= DEPENDENCE_Z and d.explained >= DEPENDENCE_RMS
        ),
    )


def _trend(many: Sequence[Series]) -> tuple[float, float]:
    """Trend over a run and its z-score, from the means of blocks of time."""
    times, means = [], []
    for series in many:
        span = float(series.time[-1]) or 1.0
        _, block = np.unique(series.block, return_inverse=True)
        counts = np.bincount(block)
        means.append(np.bincount(block, series.residual) / counts)
        at = np.bincount(block, series.time) / counts / span
        times.append(at - at.mean())
        means[-1] = means[-1] - means[-1].mean()
    x, y = np.concatenate(times), np.concatenate(means)
    power = float(x @ x)
    if len(x) < 4 or power <= 0:
        return 0.0, 0.0
    slope = float(x @ y) / power
    scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1 - len(many) + 1e-9)))
    return slope, float(abs(slope) * np.sqrt(power) / max(scatter, 1e-12))
