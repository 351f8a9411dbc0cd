"""Look of all figures: sizes, axes, panels, legends, colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from loose_env.envs import FAINT, INK, MUTED
from loose_env.errors import MissingExtra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 5.4
"""Width of every figure [inch]."""
AGENTS = ("#0173b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#8a8f98")
"""Okabe and Ito's palette without black and yellow, which vanish on one background or other.

The page changes none of them in the dark."""
MARKERS = "osD^vP*Xhd"
DASHED = (0, (4, 2))
_SIZE = 11.0  # of letters [pt]: at 336 pixels of a phone still 9.5 pixels high
_LETTERS = 50  # of a row of a legend, or of a label


def new_figure(height: float) -> Figure:
    """Return an empty figure of the page's width.

    Parameters
    ----------
    height : float
        Height [inch].

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra(
            "figures need matplotlib: install it with pip install 'loose-env[report]'"
        ) from error
    return Figure(figsize=(WIDTH, height))


def panels(
    count: int,
    each: float,
    *,
    rows: int = 1,
    grid: Literal["x", "y", "both"] | None = "y",
) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels of a height [inch] and room for a legend of some rows."""
    figure = new_figure(count * each + 0.3 * rows)
    figure.set_layout_engine("constrained", w_pad=0.05)
    axes = figure.subplots(count, 1, squeeze=False)[:, 0].tolist()
    for own in axes:
        quiet_axes(own, grid=grid, spines=())
    return figure, axes


def quiet_axes(
    axes: Axes,
    *,
    grid: Literal["x", "y", "both"] | None = "y",
    spines: Sequence[str] = ("bottom",),
    pad: float = 5,
    size: float = 10.5,
    width: float = 0.8,
) -> None:
    """Leave of the frame of axes only a grid, its labels and some spines.

    Parameters
    ----------
    axes : matplotlib Axes
        Axes to change.
    grid : {"x", "y", "both"}, optional
        Directions of the grid's lines; none where it is None.
    spines : sequence of str
        Sides of the frame that stay.
    pad, size : float
        Distance of the labels from the axis, and their size [pt].
    width : float
        Width of the grid's lines [pt].
    """
    axes.patch.set_alpha(0.0)
    axes.set_axisbelow(True)
    if grid is not None:
        axes.grid(axis=grid, color=FAINT, linewidth=width)
    axes.tick_params(which="both", length=0, pad=pad, labelsize=size, labelcolor=MUTED)
    for side, spine in axes.spines.items():
        spine.set_visible(side in spines)
        spine.set_color(MUTED)


def labels(axes: Axes, *, x: str = "", above: str = "") -> None:
    """Label the horizontal axis, and the vertical one by words above the axes."""
    if x:
        axes.set_xlabel(plain(x, _LETTERS), color=MUTED, fontsize=_SIZE)
    if above:
        axes.set_title(plain(above, _LETTERS), color=MUTED, fontsize=_SIZE, loc="left")


def legend(figure: Figure, *axes: Axes) -> None:
    """Explain the labelled curves of axes above them, each label once."""
    entries = {
        label: mark
        for own in axes
        for mark, label in zip(*own.get_legend_handles_labels(), strict=True)
    }
    words = [plain(label, _LETTERS) for label in entries]
    figure.legend(
        list(entries.values()), words, loc="outside upper left", fontsize=_SIZE, labelcolor=INK,
        ncols=max(1, min(len(words), _LETTERS // (max(map(len, words)) + 5))), frameon=False,
        handlelength=1.6, columnspacing=1.4, borderpad=0.2, borderaxespad=0.1,
    )  # fmt: skip


def plain(name: str, most: int) -> str:
    """Name of at most so many letters that is no formula, cut in the middle where it is longer.

    Examples
    --------
    >>> plain("shoulder_of_the_left_arm", 12), plain("elbow", 12)
    ('should…t_arm', 'elbow')
    """
    head = most // 2
    cut = name if len(name) <= most else f"{name[:head]}…{name[len(name) - (most - head - 1) :]}"
    return cut.replace("$", r"\$")


def percent_ticks(axes: Axes, which: Literal["x", "y"]) -> None:
    """Mark an axis of shares from 0 to 1 in per cent."""
    ticks = [0.0, 0.25, 0.5, 0.75, 1.0]
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_ticks(ticks, [f"{100 * t:.0f} %" for t in ticks])
    axes.set(**{f"{which}lim": (0.0, 1.0)})


def plain_log_ticks(axes: Axes, which: Literal["x", "y"]) -> None:
    """Write the ticks of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    wide = high / max(low, 1e-300) > 300
    axis.set_major_locator(LogLocator(base=10, subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


def agent_colours(agents: Sequence[str]) -> dict[str, str]:
    """Give each agent its colour, in the order of the names; after seven they repeat.

    Examples
    --------
    >>> agent_colours(["thesis", "random", "thesis"])
    {'thesis': '#0173b2', 'random': '#e69f00'}
    """
    return {name: AGENTS[k % len(AGENTS)] for k, name in enumerate(dict.fromkeys(agents))}


def ink_on(colour: str) -> str:
    """Dark or light ink, whichever reads better on a colour ``#rrggbb``.

    Examples
    --------
    >>> ink_on("#0173b2"), ink_on("#e69f00")
    ('#fefefe', '#16191d')
    """
    channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    light = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] > 0.2
    return "#16191d" if light else "#fefefe"
