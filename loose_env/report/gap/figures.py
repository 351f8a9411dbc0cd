"""Figures of a comparison of model and measurement: the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.gap import binned
from loose_env.report.pages.figures import WIDTH, new_figure, plain_log_ticks
from loose_env.report.pages.legend import draw_legend, legend_height, shortened
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Overlay",
    "channel_bars",
    "horizon_curves",
    "overlay_figure",
    "residual_panels",
    "spectrum_curves",
]


BEFORE, AFTER = TRUTH, MEASURED
"""Colours of the nominal and of the corrected model."""
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_DOTS = 300
"""Dots of a panel."""
_NAMES = 26
"""Letters of a channel's name, at most."""
# Names come from a model and are no formulas: what stands between two dollar signs is drawn as is.
_PANEL, _ABOVE = 1.95, 0.4
"""Height of a panel with its axis, and of what stands above the first one [inch]."""


def channel_bars(pairs: Mapping[str, tuple[float, float]]) -> Figure:
    """Gap of each channel before and after, on a logarithmic scale from the noise floor up.

    Parameters
    ----------
    pairs : mapping
        Channel -> before and after, in noise standard deviations.
    """
    rows = list(pairs.items())
    height = 0.29 * len(rows) + 0.95
    figure = new_figure(height)
    letters = min(_NAMES, max((len(name) for name, _ in rows), default=1))
    left, right = (0.16 + 0.077 * letters) / WIDTH, 1.02 / WIDTH
    axes = figure.add_axes((left, 0.55 / height, 1 - left - right, 1 - 0.9 / height))
    most = max((max(p) for _, p in rows), default=1.0)
    least = min([*(min(p) for _, p in rows), 1.0])
    for k, (name, (before, after)) in enumerate(rows):
        y = -float(k)
        axes.plot(
            [before, after], [y, y], color=FAINT, linewidth=4, solid_capstyle="round", zorder=2
        )
        axes.plot(before, y, "o", color=BEFORE, markersize=7, zorder=4)
        axes.plot(after, y, "o", color=AFTER, markersize=7, zorder=5)
        beside: dict[str, Any] = {
            "color": INK, "fontsize": 9, "va": "center", "transform": axes.get_yaxis_transform(),
            "parse_math": False,
        }  # fmt: skip
        shown = shortened(name, letters)
        axes.text(-0.03, y, shown, ha="right", **beside)
        axes.text(1.03, y, f"{before:.3g} → {after:.3g}", ha="left", **beside)
    _floor(axes, "x")
    axes.set_xscale("log")
    axes.set(xlim=(0.85 * least, 1.3 * max(most, 2.0)), ylim=(0.45 - len(rows), 0.55))
    axes.set_yticks([])
    plain_log_ticks(axes, "x")
    _plain(axes, grid="x", spines=())
    axes.set_xlabel("residual over the noise floor", color=MUTED, fontsize=9)
    _legend(figure, height)
    return figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """One channel over time, measured and by both models."""

    time: Array
    """Times [s] (N,)."""
    measured: Array
    """Readings (N,); NaN where one is missing."""
    nominal: Array
    """By the nominal model (N,)."""
    corrected: Array
    """By the corrected model (N,)."""
    channel: str
    """Name of the channel."""
    unit: str
    """Its unit."""


def overlay_figure(overlay: Overlay) -> Figure:
    """Measured, nominal and corrected readings over time, and what each model leaves of them."""
    entries = [
        ("●", MUTED, "measured"), ("- -", BEFORE, "nominal model"), ("—", AFTER, "corrected model"),
    ]  # fmt: skip
    above = legend_height(entries) + 0.26
    height = above + 1.75 + 0.3 + 0.95 + 0.5
    figure = new_figure(height)
    draw_legend(figure, entries, height)
    left = 0.68 / WIDTH
    top = figure.add_axes((left, (height - above - 1.75) / height, 0.97 - left, 1.75 / height))
    low = figure.add_axes((left, 0.5 / height, 0.97 - left, 0.95 / height))
    x = overlay.time
    top.plot(x, overlay.measured, ".", color=MUTED, markersize=3.2, zorder=2)
    top.plot(x, overlay.nominal, color=BEFORE, linewidth=1.5, linestyle=(0, (4, 2)), zorder=3)
    top.plot(x, overlay.corrected, color=AFTER, linewidth=1.4, zorder=4)
    left_by = [overlay.measured - overlay.nominal, overlay.measured - overlay.corrected]
    largest = max((float(np.nanmax(np.abs(v), initial=0.0)) for v in left_by), default=0.0)
    power = 3 * int(np.floor(np.log10(largest) / 3)) if largest > 0 else 0
    for values, colour in zip(left_by, (BEFORE, AFTER), strict=True):
        low.plot(x, values / 10.0**power, color=colour, linewidth=1.2, zorder=3)
    small = f"10{str(power).translate(_RAISED)} " if power else ""
    for axes, words, y in (
        (top, f"{shortened(overlay.channel, 50)} [{overlay.unit}]", height - above + 0.06),
        (low, f"measured less predicted [{small}{overlay.unit}]", 0.5 + 0.95 + 0.06),
    ):
        _plain(axes, grid="y", spines=())
        axes.set_xlim(x[0], x[-1])
        figure.text(
            0.03, y / height, words, color=MUTED, fontsize=9, ha="left", va="bottom",
            parse_math=False,
        )  # fmt: skip
    top.tick_params(labelbottom=False)
    low.set_xlabel("time [s]", color=MUTED, fontsize=9)
    return figure


def spectrum_curves(before: tuple[Array, Array], after: tuple[Array, Array]) -> Figure:
    """Spectrum of one channel's residual before and after, with the noise floor.

    Parameters
    ----------
    before, after : tuple of ndarray
        Frequencies [Hz] and densities over that of the noise.
    """
    figure = new_figure(3.1)
    axes = figure.add_axes((0.115, 0.165, 0.865, 0.72))
    for (frequency, power), colour, width in ((before, BEFORE, 1.6), (after, AFTER, 2.0)):
        if len(frequency):
            axes.plot(frequency, power, color=colour, linewidth=width, zorder=3)
    _floor(axes, "y")
    axes.set(xscale="log", yscale="log")
    axes.set_ylim(bottom=min(0.3, axes.get_ylim()[0]))
    _plain(axes, grid="both", spines=())
    plain_log_ticks(axes, "x")
    axes.set_xlabel("frequency [Hz]", color=MUTED, fontsize=9)
    _legend(figure, 3.1, "power over that of the noise")
    return figure


def horizon_curves(
    horizons: Sequence[float], before: Sequence[float], after: Sequence[float]
) -> Figure:
    """Error of predictions that run on their own, by how long they do."""
    figure = new_figure(2.9)
    axes = figure.add_axes((0.115, 0.175, 0.865, 0.7))
    for values, colour, above in ((before, BEFORE, True), (after, AFTER, False)):
        axes.plot(horizons, values, "o-", color=colour, linewidth=2, markersize=6, zorder=3)
        for x, y in zip(horizons, values, strict=True):
            axes.annotate(
                f"{y:.2f}", (x, y), xytext=(0, 7 if above else -8), textcoords="offset points",
                color=INK, fontsize=9, ha="center", va="bottom" if above else "top",
            )  # fmt: skip
    _floor(axes, "y")
    axes.set(xscale="log", yscale="log")
    low, high = min([*before, *after, 1.0]), max([*before, *after, 1.0])
    axes.set(xlim=(horizons[0] / 1.6, horizons[-1] * 1.6), ylim=(0.6 * low, 2.0 * high))
    axes.set_xticks(list(horizons), [f"{h:g} s" for h in horizons])
    axes.set_xticks([], minor=True)
    plain_log_ticks(axes, "y")
    _plain(axes, grid="y", spines=())
    axes.set_xlabel("how long the simulation runs on its own", color=MUTED, fontsize=9)
    _legend(figure, 2.9, "error over the noise floor")
    return figure


def residual_panels(
    regressors: Sequence[tuple[str, Array]],
    before: Array,
    after: Array | None,
    *,
    floor: float,
    label: str,
) -> Figure:
    """A residual against several regressors: samples of the nominal model, and means of both.

    Parameters
    ----------
    regressors : sequence of (name, ndarray (N,))
        What the residual is held against.
    before, after : ndarray (N,)
        Residual of the nominal and of the corrected model.
    floor : float
        Standard deviation of the noise, drawn as a band.
    label : str
        Name and unit of the residual.
    """
    count = len(regressors)
    height = _PANEL * count + _ABOVE
    figure = new_figure(height)
    shown = np.concatenate([before, after]) if after is not None else before
    finite = shown[np.isfinite(shown)]
    reach = float(np.quantile(np.abs(finite), 0.995)) * 1.15 if len(finite) else 1.0
    reach = max(reach, 2.5 * floor)
    for k, (name, values) in enumerate(regressors):
        bottom = 1 - (_ABOVE + _PANEL * (k + 1) - 0.5) / height
        axes = figure.add_axes((0.125, bottom, 0.855, (_PANEL - 0.6) / height))
        axes.axhspan(-floor, floor, color=FAINT, alpha=0.45, linewidth=0, zorder=1)
        for residual, colour, dots in ((before, BEFORE, True), (after, AFTER, False)):
            if residual is not None:
                _against(axes, values, residual, colour, dots=dots)
        axes.set_ylim(-reach, reach)
        _plain(axes, grid="y", spines=())
        axes.set_xlabel(shortened(name, 60), color=MUTED, fontsize=9, parse_math=False)
        if k == 0:
            _legend(figure, height, label, after=after is not None, band=True)
    return figure


def _against(axes: Axes, values: Array, residual: Array, colour: str, *, dots: bool) -> None:
    """Draw the mean of a residual in bins of a regressor, and some of its samples."""
    good = np.isfinite(values) & np.isfinite(residual)
    x, y = values[good], residual[good]
    if len(x) < 10:
        return
    if dots:
        few = np.linspace(0, len(x) - 1, min(_DOTS, len(x))).astype(int)
        axes.plot(x[few], y[few], ".", color=colour, alpha=0.28, markersize=2.5, zorder=2)
    labels, centres = binned(x, bins=16)
    means = np.array([y[labels == b].mean() for b in range(len(centres))])
    axes.plot(centres, means, "o-", color=colour, markersize=3.5, linewidth=1.7, zorder=4)


def _floor(axes: Axes, which: str) -> None:
    """Draw the noise floor."""
    line: dict[str, Any] = {"color": INK, "linewidth": 1.2, "linestyle": (0, (4, 2)), "zorder": 2}
    if which == "x":
        axes.axvline(1.0, **line)
    else:
        axes.axhline(1.0, **line)


def _legend(
    figure: Figure, height: float, label: str = "", *, after: bool = True, band: bool = False
) -> None:
    """Name the colours above the axes, and what the vertical axis shows."""
    y = 1 - 0.16 / height
    noise = ("noise", FAINT if band else INK)
    entries = [("before", BEFORE), *([("after", AFTER)] if after else []), noise]
    x = 1 - 0.62 * len(entries) / WIDTH
    if label:
        figure.text(
            0.03, y, label, color=MUTED, fontsize=9, ha="left", va="center", parse_math=False
        )
    for name, colour in entries:
        mark = ("■" if band else "- -") if name == "noise" else "●"
        figure.text(x, y, mark, color=colour, fontsize=9, ha="left", va="center")
        figure.text(x + 0.17 / WIDTH, y, name, color=INK, fontsize=9, ha="left", va="center")
        x += 0.64 / WIDTH


def _plain(axes: Axes, *, grid: str, spines: Sequence[str]) -> None:
    """Leave of the frame only what helps reading."""
    axes.patch.set_alpha(0.0)
    axes.set_axisbelow(True)
    axes.grid(axis=grid, which="major", color=FAINT, linewidth=0.8)  # type: ignore[arg-type]
    axes.tick_params(which="both", length=0, pad=5, labelsize=9, labelcolor=MUTED)
    for side, spine in axes.spines.items():
        spine.set_visible(side in spines)
