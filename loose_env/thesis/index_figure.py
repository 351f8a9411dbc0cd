"""The comparative index at every pose, printed and worked out again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from loose_env.envs.rendering.palette import FAINT, INK, MEASURED, MUTED
from loose_env.report.pages.figures import WIDTH, new_figure
from loose_env.thesis.comparative import IndexRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["index_figure"]

_GAP = 1.4  # lines between two blocks
_MOST = 0.8


def index_figure(groups: Mapping[str, Sequence[IndexRow]]) -> Figure:
    """Draw one line a pose and one block a condition.

    Parameters
    ----------
    groups : mapping
        Rows of each condition by its name; the dashed line marks the least index of the first.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    lines = sum(len(rows) + _GAP for rows in groups.values())
    height = 0.235 * lines + 0.55
    figure = new_figure(height)
    left, foot = 0.62, 0.5
    box = (left / WIDTH, foot / height, 1 - (left + 0.1) / WIDTH, 1 - (foot + 0.05) / height)
    axes = figure.add_axes(box)
    first = next(iter(groups.values()))
    threshold = min(row.mag_d for row in first)
    y, ticks = 0.0, {}
    for name, rows in groups.items():
        axes.text(0.0, y, name, color=INK, fontsize=9.5, fontweight="bold", va="center")
        block: dict[str, Any] = {"ymin": y - len(rows) - 0.5, "ymax": y - 0.5, "zorder": 1}
        axes.vlines([0.2 * k for k in range(5)], color=FAINT, linewidth=0.8, **block)
        axes.vlines(threshold, color=MUTED, linewidth=1.1, linestyle=(0, (3, 2)), **block)
        for row in rows:
            y -= 1.0
            ticks[y] = f"{row.theta2}°"
            _pair(axes, row, y)
        y -= _GAP
    widest = max(first, key=lambda row: abs(row.mag_d - row.mag_d_printed))
    _names(axes, widest, -1.0 - list(first).index(widest))
    axes.set(xlim=(0.0, _MOST + 0.1), ylim=(y + _GAP - 0.5, 0.6))
    axes.set_xticks([0.2 * k for k in range(5)])
    axes.set_yticks(list(ticks), list(ticks.values()))
    axes.patch.set_alpha(0.0)
    axes.tick_params(length=0, pad=6, labelsize=9, labelcolor=MUTED)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("comparative index mag(D)", color=MUTED, fontsize=9)
    return figure


def _pair(axes: Axes, row: IndexRow, y: float) -> None:
    """Draw a dot for what follows here and a ring for what was printed."""
    axes.plot([row.mag_d_printed, row.mag_d], [y, y], color=MUTED, linewidth=1.3, zorder=2)
    over: dict[str, Any] = {"marker": "o", "linestyle": "none", "clip_on": False, "zorder": 3}
    axes.plot(row.mag_d, y, color=MEASURED, markersize=5.5, **over)
    ring: dict[str, Any] = {
        "markerfacecolor": "none",
        "markeredgecolor": INK,
        "markeredgewidth": 1.3,
    }
    axes.plot(row.mag_d_printed, y, markersize=9.5, **ring, **over)


def _names(axes: Axes, row: IndexRow, y: float) -> None:
    """Name dot and ring, each on its free side."""
    side = 1.0 if row.mag_d_printed > row.mag_d else -1.0
    words: dict[str, Any] = {"fontsize": 9, "va": "center"}
    here, said = ("right", "left") if side > 0 else ("left", "right")
    axes.text(row.mag_d - 0.018 * side, y, "here", color=MEASURED, ha=here, **words)
    axes.text(row.mag_d_printed + 0.022 * side, y, "printed", color=INK, ha=said, **words)
