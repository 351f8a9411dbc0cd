"""Figures of a model-error analysis: residuals of the nominal and of the corrected model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.gap import binned
from loose_env.report.figures import DASHED, labels, legend, panels, plain, plain_log_ticks
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEFORE, AFTER = TRUTH, MEASURED
"""Colours of the nominal and of the corrected model."""
_DOTS, _NAMES = 300, 26  # dots of a panel, letters of a channel's name


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
    """Measured, nominal and corrected readings (N,) over time, and the residual of each model."""
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
    labels(top, above=f"{plain(channel, 50)} [{unit}]")
    labels(low, x="time [s]", above=f"measured less predicted [{unit}]")
    low.title.set_position((0.12, 1.0))
    legend(figure, top)
    return figure


def spectrum_curves(before: tuple[Array, Array], after: tuple[Array, Array]) -> Figure:
    """Spectrum of one channel's residual before and after, with the noise floor."""
    figure, (axes,) = panels(1, 2.8, grid="both")
    axes.plot(*before, color=BEFORE, linewidth=1.6, label="before")
    axes.plot(*after, color=AFTER, linewidth=2.0, label="after")
    _floor(axes, "y")
    axes.set(xscale="log", yscale="log")
    axes.set_ylim(bottom=min(0.3, axes.get_ylim()[0]))
    plain_log_ticks(axes, "x")
    labels(axes, x="frequency [Hz]", above="power over that of the noise")
    legend(figure, axes)
    return figure


def horizon_curves(
    horizons: Sequence[float], before: Sequence[float], after: Sequence[float]
) -> Figure:
    """Error of open-loop predictions by their horizon [s]."""
    figure, (axes,) = panels(1, 2.6)
    for values, colour, name, lift in ((before, BEFORE, "before", 7), (after, AFTER, "after", -14)):
        axes.plot(horizons, values, "o-", color=colour, linewidth=2, markersize=6, label=name)
        for x, y in zip(horizons, values, strict=True):
            look: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 9}
            axes.annotate(f"{y:.2f}", (x, y), xytext=(0, lift), color=INK, **look)
    _floor(axes, "y")
    axes.set(xscale="log", yscale="log")
    every = [*before, *after, 1.0]
    axes.set(xlim=(horizons[0] / 1.6, horizons[-1] * 1.6), ylim=(0.6 * min(every), 2 * max(every)))
    plain_log_ticks(axes, "y")
    axes.set_xticks(list(horizons), [f"{h:g} s" for h in horizons])
    axes.set_xticks([], minor=True)
    labels(axes, x="how long the simulation runs on its own", above="error over the noise floor")
    legend(figure, axes)
    return figure


def residual_panels(
    regressors: Mapping[str, Array],
    before: Array,
    after: Array | None,
    *,
    floor: float,
    label: str,
) -> Figure:
    """A residual against several regressors: samples, means, noise floor."""
    figure, many = panels(len(regressors), 1.95)
    both = before if after is None else np.concatenate([before, after])
    finite = np.abs(both[np.isfinite(both)])
    reach = max(1.15 * float(np.quantile(finite, 0.995)) if len(finite) else 1.0, 2.5 * floor)
    for axes, (name, values) in zip(many, regressors.items(), strict=True):
        axes.axhspan(-floor, floor, color=FAINT, alpha=0.45, linewidth=0, label="noise")
        good = np.flatnonzero(np.isfinite(values) & np.isfinite(before))
        few = (
            good[np.unique(np.linspace(0, len(good) - 1, _DOTS).astype(int))] if len(good) else good
        )
        axes.plot(values[few], before[few], ".", color=BEFORE, alpha=0.35, markersize=3)
        _means(axes, values, before, BEFORE, "before")
        if after is not None:
            _means(axes, values, after, AFTER, "after")
        axes.set_ylim(-reach, reach)
        labels(axes, x=name)
    labels(many[0], above=label)
    legend(figure, many[0])
    return figure


def _means(axes: Axes, values: Array, residual: Array, colour: str, name: str) -> None:
    """Draw the mean of a residual in bins of a regressor."""
    good = np.isfinite(values) & np.isfinite(residual)
    x, y = values[good], residual[good]
    if len(x) >= 10:
        groups, centres = binned(x, bins=16)
        means = np.array([y[groups == b].mean() for b in range(len(centres))])
        axes.plot(centres, means, "o-", color=colour, markersize=3.5, linewidth=1.7, label=name)


def _floor(axes: Axes, which: Literal["x", "y"]) -> None:
    """Draw the noise floor."""
    line = axes.axvline if which == "x" else axes.axhline
    line(1.0, color=INK, linewidth=1.2, linestyle=DASHED, zorder=2, label="noise")
