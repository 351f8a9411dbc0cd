"""Figures of a model-error analysis: nominal and corrected model beside the measurement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.gap import Correlation
from loose_env.report.figures import DASHED, labels, legend, panels, plain_log_ticks
from loose_env.typing import Array, ComplexArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEFORE, AFTER = TRUTH, MEASURED
"""Colours of the nominal and of the corrected model."""
_NAMES = 26  # letters of a channel's name


def overlay_figure(
    time: Array, measured: Array, nominal: Array, corrected: Array, *, unit: str
) -> Figure:
    """Measured, nominal and corrected values (N,) over time, and the residual of each model."""
    figure, (top, low) = panels(2, 1.8)
    top.plot(time, measured, ".", color=MUTED, markersize=3.2, label="measured")
    for values, label, colour, line in (
        (nominal, "nominal model", BEFORE, DASHED),
        (corrected, "corrected model", AFTER, "-"),
    ):
        look: dict[str, Any] = {"color": colour, "linestyle": line, "linewidth": 1.4}
        top.plot(time, values, label=label, **look)
        low.plot(time, measured - values, **look)
    for axes in (top, low):
        axes.set_xlim(time[0], time[-1])
    low.ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
    top.tick_params(labelbottom=False)
    labels(top, above=f"[{unit}]")
    labels(low, x="time [s]", above=f"measured less model [{unit}]")
    low.title.set_position((0.12, 1.0))
    legend(figure, top)
    return figure


def correlation_figure(given: Correlation) -> Figure:
    """Autocorrelation and cross-correlation of a residual by lag, with a 95 % band."""
    figure, axes = panels(2, 1.5)
    interval, band = given.interval, given.band
    parts = ((given.own, "with itself"), (given.other, f"with the speed of {given.joint}"))
    for each, (values, words) in zip(axes, parts, strict=True):
        lag = np.arange(len(values)) * interval
        each.axhspan(-band, band, color=FAINT, alpha=0.6, linewidth=0)
        each.vlines(lag, 0, values, color=AFTER, linewidth=1.6)
        each.set_xlim(-0.5 * interval, lag[-1] + 0.5 * interval)
        reach = max(1.2 * float(np.max(np.abs(values[1:]), initial=0.0)), 2.5 * band)
        each.set_ylim(-min(reach, 1.05), min(reach, 1.05))
        labels(each, above=words)
    labels(axes[-1], x="lag [s]")
    return figure


def response_figure(frequency: Array, gains: Mapping[str, ComplexArray]) -> Figure:
    """Gain and phase of a frequency response, measured and of both models."""
    figure, (top, low) = panels(2, 1.7, grid="both")
    looks: dict[str, dict[str, Any]] = {
        "measured": {"color": INK, "marker": ".", "linestyle": "", "markersize": 4},
        "nominal": {"color": BEFORE, "linestyle": DASHED, "linewidth": 1.4},
        "corrected": {"color": AFTER, "linestyle": "-", "linewidth": 1.6},
    }
    for name, values in gains.items():
        top.plot(frequency, np.abs(values), label=name, **looks[name])
        low.plot(frequency, np.degrees(np.unwrap(np.angle(values))), **looks[name])
    for axes in (top, low):
        axes.set_xscale("log")
        plain_log_ticks(axes, "x")
    labels(top, above="gain")
    labels(low, x="frequency [Hz]", above="phase [°]")
    legend(figure, top)
    return figure
