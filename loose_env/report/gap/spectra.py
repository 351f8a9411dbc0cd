"""Spectra of what the channels of a comparison show beyond the model, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from loose_env.gap import (
    FeatureChannel,
    GapResult,
    GapSolution,
    ResidualDiagnostics,
    Series,
    in_bands,
    series_of,
    spectrum,
)
from loose_env.report.gap.figures import spectrum_curves
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import group
from loose_env.typing import Array

__all__ = ["by_channel", "spectra_group"]


_SPECTRA = 4
"""Channels whose spectra are drawn."""


def by_channel(solution: GapSolution, residual: Array) -> dict[str, list[Series]]:
    """Series of a residual on the held-out runs, those of each channel together."""
    held = solution.problem.held_out_whole
    found: dict[str, list[Series]] = {}
    for series in series_of(residual, held.rows, held.trials, held.channels):
        found.setdefault(series.channel, []).append(series)
    return found


def spectra_group(
    solution: GapSolution, evidence: ResidualDiagnostics, result: GapResult
) -> dict[str, Any]:
    """Section with the spectra of the channels that disagree most."""
    before = _spectra(
        by_channel(solution, solution.base.held_out_residual), evidence.features_before
    )
    after = _spectra(by_channel(solution, solution.best.held_out_residual), evidence.features_after)
    worst = sorted(result.gap.by_channel, key=lambda c: -result.gap.by_channel[c][0])
    cards = [
        FigureCard(
            title=channel,
            image=spectrum_curves(before[channel][0], after[channel][0]),
            caption=before[channel][1],
        )
        for channel in worst[:_SPECTRA]
        if channel in before and channel in after and len(before[channel][0][0]) > 1
    ]
    return group(
        "Spectra before and after",
        "Spectra of the residual on the held-out runs, of the channels with the largest one.",
        cards=cards,
    )


def _spectra(
    series: dict[str, list[Series]], impact_fit: Sequence[FeatureChannel]
) -> dict[str, tuple[tuple[Array, Array], str]]:
    """Spectrum of every channel and what it shows; of runs without trajectory if of no other."""
    found = {}
    own: dict[str, list[FeatureChannel]] = {}
    for each in impact_fit:
        if len(each.power):
            own.setdefault(each.gap.channel, []).append(each)
    for channel, runs in own.items():
        frequency = min((s.frequency for s in runs), key=len)
        power = np.mean([np.interp(frequency, s.frequency, s.power) for s in runs], axis=0)
        found[channel] = (
            in_bands(frequency, power),
            f"By how much the power of {channel} differs from the simulated power, over that of "
            "its noise: impacts make the trajectories chaotic. The dashed line is the "
            "noise floor.",
        )
    for channel, many in series.items():
        found[channel] = (
            spectrum(many),
            f"Spectrum of what {channel} shows beyond the model, over that of its noise; the "
            "dashed line is the noise floor.",
        )
    return found
