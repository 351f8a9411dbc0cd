"""Figures of a model-error analysis: nominal and corrected model beside the measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.gap import Correlation
from loose_env.report.figures import DASHED, labels, legend, panels, plain, plain_log_ticks
from loose_env.typing import Array, ComplexArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEFORE, AFTER = TRUTH, MEASURED
"""Colours of the nominal and of the corrected model."""
_NAMES = 26  # letters of a channel's name


def channel_bars(pairs: Mapping[str, tuple[float, float]]) -> Figure:
    """Residual of each channel before and after, in noise standard deviations."""
    figure, (axes,) = panels(1, 0.29 * len(pairs) + 0.6, grid="x")
    before, after = np.array(list(pairs.values())).T
    y = -np.arange(len(pairs))
    axes.hlines(y, before, after, color=FAINT, linewidth=4, zorder=2)
    axes.plot(before, y, "o", color=BEFORE, markersize=7, zorder=4, label="before")
    axes.plot(after, y, "o", color=AFTER, markersize=7, zorder=5, label="after")
    _floor(axes, "x")
    axes.set_xscale("log")
    axes.set_xlim(0.85 * min(before.min(), after.min(), 1.0), 1.3 * max(before.max(), 2.0))
    axes.set_ylim(0.45 - len(pairs), 0.55)
    plain_log_ticks(axes, "x")
    axes.set_yticks(y, [plain(name, _NAMES) for name in pairs])
    right = axes.secondary_yaxis("right")
    right.set_yticks(y, [f"{a:.3g} → {b:.3g}" for a, b in pairs.values()])
    for each in (axes, right):
        each.tick_params(axis="y", labelcolor=INK, length=0)
    right.spines["right"].set_visible(False)
    labels(axes, x="residual over the noise floor")
    legend(figure, axes)
    return figure


def overlay_figure(
    time: Array, measured: Array, nominal: Array, corrected: Array, *, channel: str, unit: str
) -> Figure:
    """Measured, nominal and corrected force (N,) over time, and the residual of each model."""
    figure, (top, low) = panels(2, 1.8)
    top.plot(time, measured, ".", color=MUTED, markersize=3.2, label="given")
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
    labels(top, above=f"{channel} [{unit}]")
    labels(low, x="time [s]", above=f"given less model [{unit}]")
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


def matrix_figure(names: Sequence[str], values: Array) -> Figure:
    """Correlation matrix (K, K), each value in its cell."""
    figure, (axes,) = panels(1, min(0.34 * len(names) + 0.8, 7.0), grid=None)
    axes.imshow(np.abs(values), cmap="Blues", vmin=0, vmax=1.6, aspect="auto")
    if len(names) <= 12:
        for i, row in enumerate(values):
            for k, value in enumerate(row):
                axes.text(k, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color=INK)
    shown = [f"{plain(name, _NAMES)}  {k}" for k, name in enumerate(names, start=1)]
    axes.set_yticks(range(len(names)), shown)
    axes.set_xticks(range(len(names)), [str(k + 1) for k in range(len(names))])
    axes.tick_params(axis="y", labelcolor=INK)
    return figure


def _floor(axes: Axes, which: Literal["x", "y"]) -> None:
    """Draw the noise floor."""
    line = axes.axvline if which == "x" else axes.axhline
    line(1.0, color=INK, linewidth=1.2, linestyle=DASHED, zorder=2, label="noise")
