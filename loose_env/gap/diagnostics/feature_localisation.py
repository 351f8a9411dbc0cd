"""Errors and residual tests by channel for impact-dominated runs, from features, not samples.

The trajectories are chaotic; the quantities comparable by channel are the features, the power
spectrum, and the dependence on the measured motion, with which the simulated rattle is
uncorrelated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion
from loose_env.gap.diagnostics.localisation import depends_on
from loose_env.gap.diagnostics.residual_spectra import Series, band_edges, density
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.output.evidence_schema import Band, ChannelResidual, Dependence, ResidualTest
from loose_env.gap.residuals.residual_model import DIVERGED_RESIDUAL, LONGEST, ResidualModel
from loose_env.typing import Array

_SCATTER = 2.0
"""By how many of its standard deviations a difference of powers has to exceed chance."""
_SEGMENT = 2.0
"""Length of the segments whose spectra are averaged [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FeatureChannel:
    """One channel of one run that is compared by features."""

    gap: ChannelResidual
    """Residual of the channel in the run; over the deviation of a correct model, in place of the
    noise."""
    features: Array
    """Measured less simulated features of the channel, in standard deviations of a correct model
    (F,)."""
    frequency: Array
    """Frequencies [Hz] (K,)."""
    power: Array
    """1 plus the difference of the measured power from the simulated one with noise, over the
    noise power (K,)."""


def feature_channels(
    comparison: ResidualModel, hypothesis: Hypothesis, motions: Sequence[JointMotion]
) -> list[FeatureChannel]:
    """Compare runs by their features with a simulation, channel by channel."""
    if not comparison.features:
        return []
    predicted = comparison.predict([hypothesis])[0]
    return [
        _channel(comparison, t, u, predicted[t], motions)
        for t, features in comparison.features.items()
        for u in range(len(features.used))
    ]


def feature_tests(channels: Sequence[FeatureChannel]) -> list[ResidualTest]:
    """Residual tests by channel, over all its runs; features have no time order."""
    found: dict[str, list[FeatureChannel]] = {}
    for each in channels:
        found.setdefault(each.gap.channel, []).append(each)
    unknown = float("nan")
    return [
        ResidualTest(
            channel=name,
            rms=float(np.sqrt(np.mean(np.concatenate([s.features for s in many]) ** 2))),
            autocorrelation=unknown, whiteness_95=unknown, largest_autocorrelation=unknown,
            correlation_time=unknown, trend=0.0, trend_z=0.0,
            dependences=max(many, key=lambda s: s.gap.rms).gap.dependences,
        )
        for name, many in found.items()
    ]  # fmt: skip


def _channel(
    comparison: ResidualModel,
    number: int,
    used: int,
    predicted: Array,
    motions: Sequence[JointMotion],
) -> FeatureChannel:
    features, trial = comparison.features[number], comparison.trials[number]
    channel = int(features.used[used])
    apart = features.differences(predicted)
    apart = np.where(
        np.isfinite(apart), np.clip(apart, -DIVERGED_RESIDUAL, DIVERGED_RESIDUAL), DIVERGED_RESIDUAL
    )
    own = apart[features.about[:, used]]
    mean = apart[features.names.index(f"mean of {comparison.channels[channel].name}")]
    rms = float(np.sqrt(np.mean(own**2)))
    bands: tuple[Band, ...] = ()
    frequency = power = np.zeros(0)
    floor = float(comparison.scales[number, channel])
    measured, simulated = (
        _series(trial, number, comparison.channels[channel].name, values[:, channel] / floor)
        for values in (trial.measured, predicted)
    )
    depends: tuple[Dependence, ...] = ()
    if np.isfinite(predicted[:, channel]).all() and len(measured.sample):
        frequency, seen = density(measured)
        shown = density(simulated)[1]
        if len(seen) == len(shown):
            bands = _bands(frequency, seen, shown, measured)
            power = 1.0 + np.abs(seen - shown - 1.0)
        good = np.isin(simulated.sample, measured.sample)
        residual = measured.residual - simulated.residual[good]
        depends = depends_on(
            [_series(trial, number, measured.channel, residual, measured.sample)], motions
        )
    return FeatureChannel(
        gap=ChannelResidual(
            run=trial.name,
            channel=comparison.channels[channel].name,
            rms=rms,
            offset=float(mean) / float(np.sqrt(len(own))),
            bands=bands,
            dependences=depends,
            autocorrelated_rms=float(np.sqrt(max(rms**2 - 1, 0.0))),
            autocorrelation_z=float((rms**2 - 1) * np.sqrt(len(own) / 2)),
        ),
        features=own,
        frequency=frequency if len(power) else np.zeros(0),
        power=power,
    )


def _series(
    trial: Trial,
    number: int,
    channel: str,
    values: Array,
    sample: NDArray[np.intp] | None = None,
) -> Series:
    """Series of a run's values (T,), or of those at some samples."""
    if sample is None:
        sample = np.flatnonzero(np.isfinite(values))
        values = values[sample]
    return Series(
        run=trial.name, trial=number, channel=channel, sample=sample, time=trial.time[sample],
        residual=values, block=(trial.time[sample] // LONGEST).astype(np.intp),
    )  # fmt: skip


def _bands(frequency: Array, seen: Array, shown: Array, series: Series) -> tuple[Band, ...]:
    """Difference of measured and simulated power in bands, beyond sampling error."""
    span = float(series.time[-1] - series.time[0])
    segments = max(1.0, 2 * span / _SEGMENT - 1)
    found = []
    for low, high in pairwise(band_edges(float(frequency[-1]))):
        inside = (frequency > low) & (frequency <= high * (1 + 1e-9))
        if not inside.any():
            continue
        apart = abs(float(np.mean(seen[inside] - shown[inside])) - 1.0)
        both = np.hypot(np.mean(seen[inside]), np.mean(shown[inside]))
        apart -= _SCATTER * float(both) / np.sqrt(segments * int(inside.sum()))
        found.append((low, high, max(apart, 0.0), int(inside.sum())))
    whole = sum(apart * count for *_, apart, count in found)
    return tuple(
        Band(
            low=low,
            high=high,
            rms=float(np.sqrt(1.0 + apart)),
            share=float(apart * count / whole) if whole > 0 else 0.0,
        )
        for low, high, apart, count in found
    )
