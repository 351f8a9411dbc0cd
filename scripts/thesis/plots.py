"""Plots shared by sections: correlation loops, statistics by pose or direction; centring, rms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report import WIDTH, new_figure, quiet_axes
from loose_env.typing import Array
from scripts.thesis.estimators import correlation_loop
from scripts.thesis.planar_motion import contour_levels, histogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d0451b", "#5b8c5a", "#8a5aa8")
"""Colours of states in order: tight, loose, in between, and one more."""
_STYLES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.4, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


def note(
    axes: Axes,
    x: float,
    y: float,
    text: str,
    *,
    color: str = INK,
    size: float = 9,
    inside: bool = False,
    **look: Any,
) -> None:
    """Write into axes, at a place in the data, or ``inside`` as a share of the axes."""
    place: dict[str, Any] = {"transform": axes.transAxes} if inside else {}
    axes.text(x, y, text, color=color, fontsize=size, **place, **look)


def bare_panels(
    count: int,
    columns: int,
    *,
    flat: float = 1.0,
    above: float = 0.1,
    head: float = 0.0,
    foot: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Panels without frames, so many side by side; ``flat``: height over width.

    There is room above each panel, and a head above and a foot below all of them [inch].
    """
    side = flat * WIDTH / columns
    height = -(-count // columns) * (side + above) + head + foot
    figure, found = new_figure(height), []
    for k in range(count):
        row, column = divmod(k, columns)
        bottom = (height - head - (row + 1) * (side + above)) / height
        axes = figure.add_axes((column / columns, bottom, 1 / columns, side / height))
        axes.set(aspect="equal")
        axes.set_axis_off()
        axes.patch.set_alpha(0.0)
        found.append(axes)
    return figure, found


def square_panels(count: int, names: Sequence[str], columns: int = 3) -> tuple[Figure, list[Axes]]:
    """Square panels without frames, so many side by side, below a legend of the states."""
    figure, found = bare_panels(count, columns, head=0.32)
    legend_row(figure, names, float(figure.get_figheight()))
    return figure, found


def loop_panels(
    panels: Mapping[str, Sequence[tuple[Array, Array]]],
    names: Sequence[str],
    direction: float,
    columns: int = 3,
) -> Figure:
    """Draw polar loops of correlation against direction, a panel a pose.

    A panel has the reference x (N,) and the acceleration a (2, N) of each state; the true direction
    of the fault [rad] is the same in all.
    """
    figure, places = square_panels(len(panels), names, columns)
    angles = np.linspace(0.0, np.pi, 181)
    for (title, loops), axes in zip(panels.items(), places, strict=True):
        axes.set(xlim=(-1.15, 1.15), ylim=(-1.1, 1.2), aspect="equal")
        turn = np.linspace(0.0, 2 * np.pi, 121)
        for radius in (0.5, 1.0):
            axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FAINT, linewidth=0.8)
        end = 1.08 * np.array([np.cos(direction), np.sin(direction)])
        axis_line(axes, end, color=INK, linewidth=1.0, zorder=1)
        for (x, a), colour, style in zip(loops, COLOURS, _STYLES, strict=False):
            r = correlation_loop(x, a, angles)
            axes.plot(
                r * np.cos(angles), r * np.sin(angles), color=colour, linewidth=1.5, linestyle=style
            )
        axes.text(0.0, 1.04, title, color=INK, fontsize=9, ha="center", va="bottom")
    return figure


def axis_line(axes: Axes, end: Sequence[float] | Array, **look: Any) -> None:
    """Draw a line through the origin, from one end to its opposite."""
    axes.plot([-end[0], end[0]], [-end[1], end[1]], **look)


def contours(
    axes: Axes, samples: Array, *, bins: int, shares: Sequence[float], colour: str, **look: Any
) -> None:
    """Draw the contours of a histogram that hold shares of the samples (2, N)."""
    found = histogram(samples, bins)
    levels = np.unique(contour_levels(found, shares))
    across, up = found.centres(0), found.centres(1)
    axes.contour(across, up, found.counts.T, levels=levels, colors=[colour], **look)


def legend_row(figure: Figure, names: Sequence[str], height: float) -> None:
    """Name the colours in one row at the top of a figure of the given height [inch]."""
    widths = [0.42 + 0.075 * len(name) for name in names]
    at = max((WIDTH - sum(widths)) / 2, 0.0)
    y = 1 - 0.13 / height
    from matplotlib.lines import Line2D

    for name, width, colour, style in zip(names, widths, COLOURS, _STYLES, strict=False):
        line = Line2D(
            [at / WIDTH, (at + 0.26) / WIDTH], [y, y], color=colour, linewidth=2, linestyle=style
        )
        figure.add_artist(line)
        figure.text((at + 0.32) / WIDTH, y, name, color=INK, fontsize=9, va="center")
        at += width


def by_category(
    points: Mapping[str, Any],
    categories: Sequence[str],
    *,
    ylabel: str,
    xlabel: str,
    symlog: float | None = None,
) -> Figure:
    """Draw statistics, each with its values and their intervals' ends, side by side by category."""
    height = 2.7
    figure = new_figure(height)
    legend_row(figure, list(points), height)
    axes = figure.add_axes((0.75 / WIDTH, 0.5 / height, 1 - 0.8 / WIDTH, 1 - 0.85 / height))
    quiet_axes(axes)
    for k, ((values, *ends), colour) in enumerate(zip(points.values(), COLOURS, strict=False)):
        at = np.arange(len(categories)) + 0.16 * (k - (len(points) - 1) / 2)
        axes.vlines(at, *ends, color=colour, linewidth=2.0, alpha=0.55)
        axes.plot(at, values, "o", color=colour, markersize=4.5)
    if symlog is not None:
        axes.set_yscale("symlog", linthresh=symlog)
        low, high = axes.get_ylim()
        ticks = [t for t in (-100, -10, -1, 0, 1, 10, 100) if low <= t <= high]
        axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
        axes.minorticks_off()
    axes.set_xticks(range(len(categories)), categories)
    axes.set_xlim(-0.5, len(categories) - 0.5)
    axes.axhline(0.0, color=MUTED, linewidth=0.9)
    axes.set_xlabel(xlabel, color=MUTED, fontsize=9)
    axes.set_ylabel(ylabel, color=MUTED, fontsize=9)
    return figure


def curves_by_direction(
    panels: Mapping[str, Mapping[str, Array]], angles: Array, *, direction: float, label: str
) -> Figure:
    """Draw statistics at angles from the x axis [rad], one panel below the other."""
    each = 1.45
    height = each * len(panels) + 0.95
    figure = new_figure(height)
    legend_row(figure, list(next(iter(panels.values()))), height)
    shown = (np.degrees(angles) - 90) % 180
    order = np.argsort(shown)
    for k, (name, curves) in enumerate(panels.items()):
        bottom = (height - 0.5 - (k + 1) * each + 0.12) / height
        axes = figure.add_axes((0.75 / WIDTH, bottom, 1 - 0.85 / WIDTH, (each - 0.2) / height))
        quiet_axes(axes)
        for values, colour, style in zip(curves.values(), COLOURS, _STYLES, strict=False):
            axes.plot(shown[order], values[order], color=colour, linewidth=1.6, linestyle=style)
        marked = (np.degrees(direction) - 90) % 180
        axes.axvline(marked, color=INK, linewidth=1.0)
        if k == 0:
            place = axes.get_xaxis_transform()
            note(axes, marked, 1.03, label, size=8.5, ha="center", transform=place)
        axes.set_xlim(0, 180)
        axes.set_xticks(range(0, 181, 30))
        if k < len(panels) - 1:
            axes.set_xticklabels([])
        axes.set_ylabel(name, color=MUTED, fontsize=9)
    axes.set_xlabel("direction from the tool's y axis [deg]", color=MUTED, fontsize=9)
    return figure


_LEFT, _RIGHT, _ABOVE, _BELOW = 0.62, 0.12, 0.30, 0.52
"""Room around panels [inch]."""


def panels(
    titles: Sequence[str], *, across: str, up: Sequence[str], height: float
) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel above the other."""
    count = len(titles)
    total = count * height + count * _ABOVE + (count - 1) * 0.24 + _BELOW
    figure = new_figure(total)
    found: list[Axes] = []
    for k, (title, label) in enumerate(zip(titles, up, strict=True)):
        bottom = total - (k + 1) * (height + _ABOVE) - k * 0.24
        axes = figure.add_axes(
            (_LEFT / WIDTH, bottom / total, 1 - (_LEFT + _RIGHT) / WIDTH, height / total)
        )
        quiet_axes(axes, grid="both", width=0.6)
        note(axes, 0.0, 1 + 0.07 / height, title, inside=True, ha="left", va="bottom")
        axes.set_ylabel(label, color=MUTED, fontsize=8.5)
        axes.yaxis.set_label_coords(-0.095, 0.5)
        found.append(axes)
    found[-1].set_xlabel(across, color=MUTED, fontsize=9)
    return figure, found


def centred(signal: Array) -> Array:
    """Remove the mean along the last axis, time; the shape stays."""
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


def rms(signal: Array) -> float:
    """Root mean square of all values, in the unit of the signal."""
    return float(np.sqrt(np.mean(signal**2)))
