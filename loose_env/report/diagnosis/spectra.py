"""Figure of measured against predicted transmission over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import Arm
from loose_env.envs import INK, MEASURED, MUTED
from loose_env.instrument import HEALTHY, Diagnosis, TransmissionSpectrum
from loose_env.report.diagnosis.text import joint_words, short_name
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.figures import WIDTH, new_figure, plain_log_ticks, quiet_axes
from loose_env.report.pages.legend import draw_legend, legend_height, shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["spectra_cards", "transmission_figure"]

_CARDS = 2
"""Runs that are drawn."""
_PANEL, _BELOW, _ABOVE = 1.22, 0.5, 0.3
"""Height of a panel, of the axis below the last and of the title above each [inch]."""
_FAULTS = ("#d55e00", "#cc79a7")
"""Colours of the most probable faults."""
_DASHES: tuple[Any, ...] = ((0, (5, 2)), (0, (1.5, 1.5)))


def spectra_cards(diagnosis: Diagnosis, arm: Arm) -> list[FigureCard]:
    """Cards of the runs in which the hypotheses differ most, one for each excited joint."""
    by_run: dict[int, list[TransmissionSpectrum]] = {}
    for spectrum in diagnosis.spectra:
        records = diagnosis.records
        known = spectrum.record < len(records)
        if known and records[spectrum.record].condition != HEALTHY:
            by_run.setdefault(spectrum.record, []).append(spectrum)
    ranked = sorted(by_run, key=lambda record: -_difference(by_run[record]))
    chosen: dict[str, int] = {}
    for record in ranked:
        chosen.setdefault(by_run[record][0].joint, record)
    cards = []
    for joint, record in list(chosen.items())[:_CARDS]:
        own = by_run[record]
        names = {n: short_name(arm, n) for n in own[0].predicted}
        cards.append(
            FigureCard(
                title=f"Record {record + 1}: {joint_words(arm, joint)} excited",
                image=transmission_figure(own, names),
                caption=f"Transmission from {joint_words(arm, joint)} to each axis of the "
                f"accelerometer, {own[0].unit}. The better hypothesis is the one whose curve lies "
                "on the measured one. The motion of a loose seat and unknown forces of the joints "
                "(friction, brakes, servos) are estimated from the same readings.",
            )
        )
    return cards


def transmission_figure(
    spectra: Sequence[TransmissionSpectrum], names: Mapping[str, str]
) -> Figure:
    """Draw the transmission of one run, a panel for each axis of the accelerometer.

    Parameters
    ----------
    spectra : sequence of TransmissionSpectrum
        Axes of one run.
    names : mapping
        Hypotheses to draw -> what they are called.
    """
    faults = [name for name in names if name != HEALTHY]
    entries = [("●", MEASURED, "measured")]
    entries += [("- -", MUTED, names[HEALTHY])] if HEALTHY in names else []
    entries += [("—", c, names[n]) for n, c in zip(faults, _FAULTS, strict=False)]
    legend = legend_height(entries)
    height = legend + len(spectra) * (_PANEL + _ABOVE) + _BELOW
    figure = new_figure(height)
    draw_legend(figure, entries, height)
    left = 0.55 / WIDTH
    for k, spectrum in enumerate(spectra):
        bottom = height - legend - (k + 1) * (_PANEL + _ABOVE)
        axes = figure.add_axes((left, bottom / height, 0.97 - left, _PANEL / height))
        x = np.array(spectrum.frequency_hz)
        floor = 1e-3 * max([max(spectrum.measured, default=0.0), 1e-12])
        if HEALTHY in spectrum.predicted and HEALTHY in names:
            y = np.maximum(spectrum.predicted[HEALTHY], floor)
            axes.plot(x, y, color=MUTED, linewidth=1.8, linestyle=(0, (4, 2)), zorder=3)
        for name, colour, dash in zip(faults, _FAULTS, ("-", _DASHES[1]), strict=False):
            if name in spectrum.predicted:
                y = np.maximum(spectrum.predicted[name], floor)
                axes.plot(x, y, color=colour, linewidth=1.6, linestyle=dash, zorder=4)
        axes.plot(
            x, np.maximum(spectrum.measured, floor), "o", color=MEASURED, markersize=3.4, zorder=5
        )
        axes.set_yscale("log")
        quiet_axes(axes, grid="both")
        plain_log_ticks(axes, "y")
        if k + 1 < len(spectra):
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("frequency [Hz]", color=MUTED, fontsize=9)
        figure.text(
            left, (bottom + _PANEL + 0.07) / height, shortened(spectrum.channel, 46),
            color=INK, fontsize=9, ha="left", va="bottom", parse_math=False,
        )  # fmt: skip
    return figure


def _difference(spectra: Sequence[TransmissionSpectrum]) -> float:
    """Largest rms log ratio of measured and predicted, or of two predictions, over the axes."""
    found = 0.0
    for spectrum in spectra:
        rows = [np.array(spectrum.measured), *map(np.array, spectrum.predicted.values())]
        logs = np.log(np.maximum(rows, 1e-12))
        found = max(found, float(np.sqrt(np.mean((logs - logs[0]) ** 2))))
    return found
