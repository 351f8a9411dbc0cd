"""One builder for the figures of all sections: panels of curves, points, intervals and loops."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report import new_figure, quiet_axes
from loose_env.typing import Array
from scripts.thesis.estimators import correlation_loop
from scripts.thesis.planar_motion import contour_levels, histogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d0451b", "#5b8c5a", "#8a5aa8")
"""Colours of states in order: tight, loose, in between, and one more."""
_STYLES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.4, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
DASHED: Any = (0, (4, 2))


class Curve(NamedTuple):
    """A line, or points where its look has a marker alone."""

    x: ArrayLike
    y: ArrayLike
    """Values (K,), or with the ends of their intervals (3, K), drawn as bars or as a band."""
    name: str
    """Entry of the legend; none where it is empty."""
    look: Mapping[str, Any]


def curve(x: ArrayLike, y: ArrayLike, name: str = "", **look: Any) -> Curve:
    """Curve with a look in matplotlib's words."""
    return Curve(x, y, name, look)


def points(x: ArrayLike, y: ArrayLike, name: str = "", marker: str = "o", **look: Any) -> Curve:
    """Points without a line between them."""
    return Curve(x, y, name, {"marker": marker, "linestyle": "none", "markersize": 5, **look})


def axis(end: Sequence[float] | Array, name: str = "", **look: Any) -> Curve:
    """Line through the origin, from one end to its opposite."""
    return curve([-end[0], end[0]], [-end[1], end[1]], name, **look)


def ring(radius: float) -> Curve:
    """Faint circle about the origin."""
    turn = np.linspace(0.0, 2 * np.pi, 121)
    return curve(radius * np.cos(turn), radius * np.sin(turn), color=FAINT, linewidth=0.8)


def drawing(method: str, *values: Any, **look: Any) -> Callable[[Axes], Any]:
    """What a method of axes draws."""
    return lambda axes: getattr(axes, method)(*values, **look)


def state_look(index: int) -> dict[str, Any]:
    """Colour and style of a state by its place in the legend."""
    return {"color": COLOURS[index], "linestyle": _STYLES[index], "linewidth": 1.5}


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Axes of a figure and what is drawn in them."""

    curves: Sequence[Curve | Callable[[Axes], Any]]
    """In the order in which they are drawn; a function draws by itself."""
    title: str = ""
    up: str = ""
    """Words at the vertical axis."""
    marks: Sequence[float] = ()
    """Places of vertical lines."""
    look: Mapping[str, Any] = field(default_factory=dict)
    """Limits, scales and ticks in the words of ``Axes.set``."""


def chart(
    panels: Sequence[Panel],
    *,
    across: str = "",
    height: float = 1.3,
    columns: int = 1,
    bare: bool = False,
    sharey: Literal["none", "all", "row", "col"] = "none",
) -> Figure:
    """Draw panels in rows under one legend; ``height`` of a row [inch].

    Bare panels have no frame and the same scale on both axes.
    """
    rows = -(-len(panels) // columns)
    figure = new_figure(rows * height + 0.65)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=sharey).ravel()
    legend: dict[str, Any] = {}
    for axes, panel in zip(grid, panels, strict=False):
        if not bare:
            quiet_axes(axes, grid="both", width=0.6, pad=4)
        for one in panel.curves:
            if not isinstance(one, Curve):
                one(axes)
            elif (drawn := _drawn(axes, one)) and one.name:
                legend.setdefault(one.name, drawn)
        for place in panel.marks:
            axes.axvline(place, color=INK, linewidth=1.0, linestyle=DASHED)
        side = "center" if bare else "left"
        axes.set_title(panel.title, fontsize=9, color=INK, loc=side, pad=4)
        axes.set_ylabel(panel.up, color=MUTED, fontsize=8.5)
        axes.set(**{"aspect": "equal"} if bare else {}, **panel.look)
        for own in (axes.xaxis, axes.yaxis):
            if own.get_scale() == "log":  # exponents of a power of ten are too small to read
                own.set_major_formatter("{x:g}")
                own.set_minor_formatter("")
        if bare:
            axes.set_axis_off()
    for axes in grid[len(panels) :]:
        axes.remove()
    if legend:
        room: dict[str, Any] = {"frameon": False, "fontsize": 8.5, "labelcolor": INK}
        wide = max(1, min(len(legend), 66 // (5 + max(map(len, legend)))))
        figure.legend([*legend.values()], [*legend], loc="outside upper left", ncols=wide, **room)
    figure.supxlabel(across, color=MUTED, fontsize=9)
    return figure


def _drawn(axes: Axes, one: Curve) -> Any:
    """Draw a curve with its intervals; return what the legend shows of it."""
    x, y = np.asarray(one.x, dtype=float), np.asarray(one.y, dtype=float)
    middle, *ends = y if y.ndim == 2 else (y,)
    (line,) = axes.plot(x, middle, **{"linewidth": 1.2, **one.look})
    if ends and line.get_linestyle() == "None":
        axes.vlines(x, *ends, color=line.get_color(), linewidth=2.0, alpha=0.55)
    elif ends:
        axes.fill_between(x, *ends, color=line.get_color(), alpha=0.18, linewidth=0)
    return line


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
