"""One builder for figures: panels of curves, points, intervals and bands under one legend."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.envs import FAINT, INK, MUTED
from loose_env.io import written_beside
from loose_env.report import WIDTH, new_figure, quiet_axes
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    width: float = WIDTH,
    sharey: Literal["none", "all", "row", "col"] = "none",
) -> Figure:
    """Draw panels in rows under one legend; ``height`` of a row, ``width`` of the figure [inch].

    Bare panels have no frame and the same scale on both axes.
    """
    rows = -(-len(panels) // columns)
    figure = new_figure(rows * height + 0.65)
    figure.set_figwidth(width)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=sharey).ravel()
    legend: dict[str, Any] = {}
    for axes, panel in zip(grid, panels, strict=False):
        if not panel.curves:
            axes.set_axis_off()
            continue
        if not bare:
            quiet_axes(axes, grid="both", width=0.6, pad=4, size=8.5)
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
        wide = max(1, min(len(legend), int(12 * width) // (5 + max(map(len, legend)))))
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


def save(figure: Figure, path: Path, *, dpi: int = 130) -> None:
    """Write a figure to a file atomically, in the format of the file's name."""
    import matplotlib

    told = {"Date": None} if path.suffix == ".svg" else None  # the same rows, the same file
    with matplotlib.rc_context({"svg.hashsalt": path.stem}):
        written_beside(path, lambda beside: figure.savefig(beside, dpi=dpi, metadata=told))
