"""Plots that several sections share: loops, contours, statistics by pose; centring and rms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import INK, MUTED
from loose_env.typing import Array
from scripts.charts import Curve, Panel, axis, chart, curve, drawing, points, ring
from scripts.thesis.estimators import correlation_loop
from scripts.thesis.planar_motion import contour_levels, histogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d0451b", "#5b8c5a", "#8a5aa8")
"""Colours of states in order: tight, loose, in between, and one more."""
_STYLES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.4, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


def state_look(index: int) -> dict[str, Any]:
    """Colour and style of a state by its place in the legend."""
    return {"color": COLOURS[index], "linestyle": _STYLES[index], "linewidth": 1.5}


def contours(
    samples: Array, *, bins: int, shares: Sequence[float], **look: Any
) -> Callable[[Axes], Any]:
    """Contours of a histogram that hold shares of the samples (2, N), to be drawn in a panel."""
    found = histogram(samples, bins)
    levels = np.unique(contour_levels(found, shares))
    across, up = found.centres(0), found.centres(1)
    return drawing("contour", across, up, found.counts.T, levels=levels, **look)


def loops(pairs: Mapping[str, tuple[Array, Array]], direction: float) -> list[Curve]:
    """Polar loops of correlation by direction, and the true direction of the fault [rad].

    By state the reference x (N,) and the acceleration a (2, N).
    """
    angles = np.linspace(0.0, np.pi, 181)
    end = 1.08 * np.array([np.cos(direction), np.sin(direction)])
    curves = [ring(0.5), ring(1.0), axis(end, color=INK, linewidth=1.0, zorder=1)]
    for k, (state, (x, a)) in enumerate(pairs.items()):
        r = correlation_loop(x, a, angles)
        curves.append(curve(r * np.cos(angles), r * np.sin(angles), state, **state_look(k)))
    return curves


def by_category(
    points_of: Mapping[str, Any],
    categories: Sequence[str],
    *,
    ylabel: str,
    xlabel: str,
    symlog: bool = False,
) -> Figure:
    """Draw statistics, each with its values and their intervals' ends, side by side by category."""
    curves: list[Any] = [drawing("axhline", 0.0, color=MUTED, linewidth=0.9)]
    for k, ((name, values), colour) in enumerate(zip(points_of.items(), COLOURS, strict=False)):
        at = np.arange(len(categories)) + 0.16 * (k - (len(points_of) - 1) / 2)
        curves.append(points(at, values, name, color=colour, markersize=4.5))
    if symlog:
        curves.append(drawing("set_yscale", "symlog", linthresh=1.0))
        curves.append(lambda axes: axes.yaxis.set_major_formatter("{x:g}"))
    ticks = {"xticks": range(len(categories)), "xticklabels": categories}
    look = {**ticks, "xlim": (-0.5, len(categories) - 0.5)}
    return chart([Panel(curves=curves, up=ylabel, look=look)], across=xlabel, height=2.1)


def centred(signal: Array) -> Array:
    """Remove the mean along the last axis, time; the shape stays."""
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


def rms(signal: Array) -> float:
    """Root mean square of all values, in the unit of the signal."""
    return float(np.sqrt(np.mean(signal**2)))
