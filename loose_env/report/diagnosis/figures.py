"""Figures of a diagnosis: posterior by record, correlation loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, PAPER, TRUTH
from loose_env.instrument import HEALTHY, Loop, RecordSeen
from loose_env.report.pages.figures import WIDTH, new_figure
from loose_env.report.pages.legend import LETTERS, legend_rows, shortened
from loose_env.report.pages.palette import is_light

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["hypothesis_colours", "loop_figure", "posterior_figure", "shown_hypotheses"]


_HEALTHY = "#009e73"
_REST = "#8a8f98"
_LOOSE = ("#d55e00", "#0173b2", "#e69f00", "#cc79a7", "#56b4e9")
"""Colours of the hypotheses, told apart by colour-blind eyes; none is one of the ink's."""
_SHOWN = 0.03
"""Probability that a hypothesis must have had once to get a colour of its own."""
_NARROW = 50.0
"""Half angle up to which a direction is drawn [degrees]."""
_LINE = 0.25
"""Height of a line of words [inch]."""
_ROOM = 1.38
"""Half the width of a loop's drawing, over the circle r = 1."""


def shown_hypotheses(steps: Sequence[Mapping[str, float]]) -> list[str]:
    """Hypotheses with a colour of their own: healthy, and the most probable ones.

    Parameters
    ----------
    steps : sequence of mapping
        Posterior after each record.

    Examples
    --------
    >>> shown_hypotheses([{"healthy": 0.5, "a": 0.48, "b": 0.02}, {"healthy": 0.0, "a": 1.0}])
    ['healthy', 'a']
    """
    most: dict[str, float] = {}
    for step in steps:
        for name, p in step.items():
            most[name] = max(most.get(name, 0.0), p)
    last = steps[-1] if steps else {}
    named = [n for n, p in most.items() if p >= _SHOWN and n != HEALTHY]
    named.sort(key=lambda n: (-last.get(n, 0.0), -most[n]))
    return [*([HEALTHY] if HEALTHY in most else []), *named[: len(_LOOSE)]]


def hypothesis_colours(names: Sequence[str]) -> dict[str, str]:
    """Give each hypothesis its colour; the healthy arm has always the same."""
    loose = [name for name in names if name != HEALTHY]
    found = dict(zip(loose, _LOOSE, strict=False))
    return {name: _HEALTHY if name == HEALTHY else found[name] for name in names}


def posterior_figure(
    steps: Sequence[Mapping[str, float]], labels: Sequence[str], names: Mapping[str, str]
) -> Figure:
    """Draw the posterior after each record: a bar a record, divided among the hypotheses.

    Parameters
    ----------
    steps : sequence of mapping
        Hypothesis -> probability after each record.
    labels : sequence of str
        Name of each bar.
    names : mapping
        Hypotheses with a colour of their own -> what they are called; all others share one.
    """
    colours = hypothesis_colours(list(names))
    entries = [*names, None]
    if all(sum(step.get(n, 0.0) for n in names) > 0.995 for step in steps):
        entries.pop()
    texts = [shortened(names[n], LETTERS) if n is not None else "all others" for n in entries]
    rows = legend_rows(texts)
    above, each, below = 0.22 + _LINE * (rows[-1][0] + 1), 0.36, 0.42
    height = above + each * len(steps) + below
    figure = new_figure(height)
    for (row, x), name, words in zip(rows, entries, texts, strict=True):
        y = 1 - (0.16 + _LINE * row) / height
        colour = _REST if name is None else colours[name]
        figure.text(x, y, "■", color=colour, fontsize=12, ha="left", va="center")
        figure.text(x + 0.037, y, words, color=INK, fontsize=10, ha="left", va="center")
    letters = max(map(len, labels), default=1)
    left = min(0.3, (0.12 + 0.075 * letters) / WIDTH)
    axes = figure.add_axes((left, below / height, 0.97 - left, 1 - (above + below) / height))
    for k, step in enumerate(steps):
        start = 0.0
        for name in entries:
            share = max(0.0, 1.0 - start) if name is None else float(step.get(name, 0.0))
            colour = _REST if name is None else colours[name]
            axes.barh(-k, share, left=start, height=0.74, color=colour, linewidth=0, zorder=2)
            if share >= 0.085:
                on_it = "#16191d" if is_light(colour) else "#fefefe"
                axes.text(
                    start + share / 2, -k, _whole(share), color=on_it, fontsize=9.5,
                    ha="center", va="center_baseline", zorder=3,
                )  # fmt: skip
            start += share
    axes.set(xlim=(0.0, 1.0), ylim=(0.5 - len(steps), 0.5))
    axes.set_yticks([-k for k in range(len(steps))], list(labels))
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0 %", "25 %", "50 %", "75 %", "100 %"])
    first, *_, last = axes.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    _bare(axes)
    axes.tick_params(axis="y", labelcolor=INK)
    return figure


def _whole(share: float) -> str:
    """A share in whole per cent, never rounded to all."""
    return "over 99" if share > 0.995 else f"{100 * share:.0f}"


def loop_figure(record: RecordSeen) -> Figure:
    """Draw the correlation loops of one record, a panel for each joint and plane.

    The circle is a correlation of 1. The line through the waist is the direction of lowest
    correlation; the arrow, where there is one, that in which motion is lost, as long as it lies
    in the plane.
    """
    loops = record.loops
    across = min(3, len(loops))
    down = -(-len(loops) // across)
    panel = WIDTH / max(across, 2)
    legend = 0.16 + 2 * _LINE
    height = down * panel * (1.0 if across > 1 else 0.95) + legend
    figure = new_figure(height)
    _loop_legend(figure, height, direction=_drawn(record))
    margin = 0.5 * (WIDTH - across * panel)
    deep = (height - legend) / down
    for k, loop in enumerate(loops):
        row, column = divmod(k, across)
        box = (
            (margin + column * panel) / WIDTH,
            (height - legend - (row + 1) * deep) / height,
            panel / WIDTH,
            deep / height,
        )
        axes = figure.add_axes(box)
        axes.set_axis_off()
        axes.set_aspect("equal")
        axes.set(xlim=(-_ROOM, _ROOM), ylim=(-_ROOM, _ROOM))
        _loop(axes, loop, record, named=len({each.joint for each in loops}) > 1)
    return figure


def _drawn(record: RecordSeen) -> bool:
    return record.direction_tool is not None and (record.half_angle_deg or 0.0) <= _NARROW


def _loop(axes: Axes, loop: Loop, record: RecordSeen, *, named: bool) -> None:
    from matplotlib.patches import Circle, Polygon

    axes.add_patch(Circle((0, 0), 1.0, facecolor="none", edgecolor=FAINT, linewidth=1.1))
    for end, name in (((1.1, 0.0), loop.plane[0]), ((0.0, 1.1), loop.plane[1])):
        axes.plot([-end[0], end[0]], [-end[1], end[1]], color=FAINT, linewidth=0.8, zorder=1)
        axes.text(
            1.13 * end[0], 1.13 * end[1], name, color=INK, fontsize=9, fontstyle="italic",
            ha="center", va="center",
        )  # fmt: skip
    if named:
        axes.text(
            -1.3,
            1.3,
            shortened(loop.joint, 22),
            parse_math=False,
            color=MUTED,
            fontsize=9,
            ha="left",
            va="top",
        )
    # Half a turn further the correlation has the other sign, and the point is the same: closed.
    angle = np.radians(np.asarray([*loop.angle_deg, *loop.angle_deg[:1]]))
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    measured, expected = (
        np.asarray([*values, *values[:1]]) for values in (loop.correlation, loop.expected)
    )
    points = measured[:, None] * way
    axes.add_patch(Polygon(points, facecolor=MEASURED, alpha=0.22, linewidth=0, zorder=2))
    axes.plot(*(expected[:, None] * way).T, color=MUTED, linewidth=1.3, dashes=(4, 2.5), zorder=3)
    axes.plot(*points.T, color=MEASURED, linewidth=1.9, zorder=3.2)
    if np.abs(measured).max(initial=0.0) > 0.05:
        waist = way[int(np.argmin(np.abs(measured)))]
        line = 1.12 * np.outer([-1.0, 1.0], waist)
        axes.plot(*line.T, color=MEASURED, linewidth=2.1, solid_capstyle="round", zorder=3.3)
    if _drawn(record):
        _direction(axes, loop, record)


def _direction(axes: Axes, loop: Loop, record: RecordSeen) -> None:
    """Draw the direction in which motion is lost, and how well it is known."""
    from matplotlib.patches import Circle, Wedge

    from loose_env.envs import draw_arrow

    assert record.direction_tool is not None
    seen = np.array([record.direction_tool["xyz".index(axis)] for axis in loop.plane])
    length = float(np.linalg.norm(seen))
    if length < 0.12:
        axes.add_patch(Circle((0, 0), 0.05, facecolor=TRUTH, edgecolor=PAPER, zorder=5))
        return
    heading = float(np.degrees(np.arctan2(seen[1], seen[0])))
    half = record.half_angle_deg
    if half is not None and length > 0.7:
        for turned in (heading, heading + 180.0):
            wedge = Wedge((0, 0), 1.0, turned - half, turned + half, alpha=0.16, zorder=2.5)
            wedge.set(facecolor=TRUTH, linewidth=0)
            axes.add_patch(wedge)
    draw_arrow(axes, -seen, seen, color=TRUTH, both=True)


def _loop_legend(figure: Figure, height: float, *, direction: bool) -> None:
    entries = [
        ("■", MEASURED, "measured"),
        ("- -", MUTED, "healthy arm"),
        ("—", MEASURED, "lowest correlation"),
    ]
    if direction:
        entries.append(("↔", TRUTH, "motion lost along"))
    for (row, x), (mark, colour, words) in zip(
        legend_rows([words for *_, words in entries]), entries, strict=True
    ):
        y = 1 - (0.16 + _LINE * row) / height
        figure.text(x, y, mark, color=colour, fontsize=10, ha="left", va="center")
        figure.text(x + 0.042, y, words, color=INK, fontsize=10, ha="left", va="center")


def _bare(axes: Axes) -> None:
    axes.patch.set_alpha(0.0)
    axes.set_axisbelow(True)
    look: dict[str, Any] = {"length": 0, "pad": 6, "labelsize": 9.5, "labelcolor": MUTED}
    axes.tick_params(**look)
    for spine in axes.spines.values():
        spine.set_visible(False)
