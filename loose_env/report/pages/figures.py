"""Figures of a comparison, from rows of episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.errors import MissingExtra
from loose_env.evaluation import Row, by_agent, standings
from loose_env.report.pages.palette import agent_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


WIDTH = 5.4
"""Width of every figure [inch]; at 358 pixels of a phone its letters are still 8 high."""
_LETTERS = 20  # of a name beside a curve; longer ones take two lines
_MARKERS = "osD^vP*"
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.4)), (0, (6, 1.5, 1.2, 1.5)))


def new_figure(height: float) -> Figure:
    """Return an empty figure of the page's width.

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


def quiet_axes(
    axes: Axes,
    *,
    grid: Literal["x", "y", "both"] | None = "y",
    spines: Sequence[str] = ("bottom",),
    pad: float = 5,
    size: float = 8.5,
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


def plain_log_ticks(axes: Axes, which: Literal["x", "y"]) -> None:
    """Write the ticks of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = getattr(axes, f"{which}axis")
    low, high = axis.get_view_interval()
    wide = high / max(low, 1e-300) > 300
    axis.set_major_locator(LogLocator(base=10, subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


def success_bars(
    rows: Sequence[Row], *, colours: Mapping[str, str] | None = None, chance: float | None = None
) -> Figure:
    """Draw a bar an agent: accuracy with its 95 % interval.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of all agents.
    colours : mapping, optional
        Colour of each agent.
    chance : float, optional
        Success rate of a blind guess, marked by a line [1].
    """
    found = standings(rows)
    paint = agent_colours(list(by_agent(rows))) if colours is None else colours
    height = 0.5 * len(found) + 0.75
    figure = new_figure(height)
    axes = figure.add_axes((0.03, 0.52 / height, 0.94, 1 - 0.6 / height))
    for k, s in enumerate(found):
        y = -float(k)
        axes.barh(y, s.success, height=0.34, color=paint[s.agent], zorder=2)
        axes.plot([s.low, s.high], [y, y], color=INK, linewidth=1.6, zorder=3)
        for end in (s.low, s.high):
            axes.plot([end, end], [y - 0.09, y + 0.09], color=INK, linewidth=1.6, zorder=3)
        share = f"{100 * s.success:.0f} %"
        axes.text(0.0, y + 0.27, s.agent, color=INK, fontsize=9.5, ha="left", va="bottom")
        axes.text(
            1.0,
            y + 0.27,
            f"{share} ({100 * s.low:.0f} to {100 * s.high:.0f})",
            color=INK,
            fontsize=9.5,
            ha="right",
            va="bottom",
        )
    if chance is not None:
        axes.axvline(chance, color=MUTED, linewidth=1.1, linestyle=(0, (3, 2)), zorder=1)
        label: dict[str, Any] = {"color": MUTED, "fontsize": 8.5, "ha": "left", "va": "bottom"}
        axes.text(chance + 0.01, 0.4 - len(found), "blind guess", **label)
    axes.set(xlim=(0.0, 1.0), ylim=(0.35 - len(found), 0.72))
    axes.set_yticks([])
    _percent(axes, "x")
    quiet_axes(axes, grid="x", spines=(), pad=6, size=9)
    axes.set_xlabel("accuracy", color=MUTED, fontsize=9)
    return figure


def success_against_records(
    rows: Sequence[Row], *, colours: Mapping[str, str] | None = None
) -> Figure:
    """Draw the share of correct verdicts after at most k records."""
    paint = agent_colours(list(by_agent(rows))) if colours is None else colours
    most = max(int(row["records"]) for row in rows)
    figure = new_figure(3.5)
    own, order = by_agent(rows), [s.agent for s in standings(rows)]
    labels = {agent: wrap(agent, _LETTERS) or [""] for agent in order}
    letters = max(len(line) for lines in labels.values() for line in lines)
    beside = 0.072 * letters + 0.2
    axes = figure.add_axes((0.62 / WIDTH, 0.15, 1 - (0.62 + beside) / WIDTH, 0.755))
    counts = np.arange(most + 1)
    ends = {}
    for k, agent in enumerate(order):
        right = np.array([bool(row["success"]) for row in own[agent]])
        records = np.array([int(row["records"]) for row in own[agent]])
        share = (right[:, None] & (records[:, None] <= counts)).mean(axis=0)
        axes.plot(
            counts,
            share,
            color=paint[agent],
            linewidth=2.0,
            linestyle=_DASHES[k % len(_DASHES)],
            marker=_MARKERS[k % len(_MARKERS)],
            markersize=4.5,
            clip_on=False,
            zorder=3,
        )
        ends[agent] = float(share[-1])
    for agent, y in _spread(ends, 0.065 * max(len(lines) for lines in labels.values())).items():
        axes.annotate(
            "\n".join(labels[agent]),
            xy=(most, ends[agent]),
            xytext=(most * 1.035, y),
            annotation_clip=False,
            color=INK,
            fontsize=9,
            ha="left",
            va="center",
        )
        dot: dict[str, Any] = {"color": paint[agent], "linewidth": 1.0, "clip_on": False}
        axes.plot([most * 1.012, most * 1.03], [ends[agent], y], **dot)
    axes.set(xlim=(0, most), ylim=(0.0, 1.0))
    axes.set_xticks(counts if most <= 12 else counts[:: int(np.ceil(most / 12))])
    _percent(axes, "y")
    quiet_axes(axes, pad=6, size=9)
    axes.set_xlabel("records taken, at most", color=MUTED, fontsize=9)
    axes.text(0.0, 1.05, "correct verdicts", color=MUTED, fontsize=9, ha="left", va="bottom")
    return figure


def _spread(heights: Mapping[str, float], gap: float) -> dict[str, float]:
    """Move labels apart so that each two neighbours are at least ``gap`` from each other."""
    names = sorted(heights, key=lambda name: heights[name])
    placed = np.array([heights[name] for name in names])
    for _ in range(200):
        for k in range(len(placed) - 1):
            short = gap - (placed[k + 1] - placed[k])
            if short > 1e-9:
                placed[k] -= short / 2
                placed[k + 1] += short / 2
        placed += max(0.0, 0.0 - float(placed.min()))
        placed -= max(0.0, float(placed.max()) - 1.0)
    return {name: float(y) for name, y in zip(names, placed, strict=True)}


def _percent(axes: Axes, which: str) -> None:
    ticks = [0.0, 0.25, 0.5, 0.75, 1.0]
    words = [f"{100 * t:.0f} %" for t in ticks]
    if which == "x":
        axes.set_xticks(ticks, words)
        first, *_, last = axes.get_xticklabels()
        first.set_horizontalalignment("left")
        last.set_horizontalalignment("right")
    else:
        axes.set_yticks(ticks, words)
