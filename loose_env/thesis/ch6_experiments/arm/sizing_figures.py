"""Pictures of the sizing: torques and joint forces against the angle of joint 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import INK, MEASURED, MUTED, TRUTH
from loose_env.report import new_figure, quiet_axes
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LEFT, _RIGHT, _GAP = 0.105, 0.985, 0.075


@dataclass(frozen=True, kw_only=True, eq=False)
class CaseCurves:
    """One case of the sweep."""

    name: str
    """Title of its row."""
    angles: Array
    """Angle of joint 2 [deg] (K,)."""
    torque: Array
    """Torque at lowest, no and highest rate of joint 2 [N m] (K, 3, 2 joints)."""
    reach: Array
    """Least and greatest torque over all rates of joint 2 [N m] (K, 2, 2 joints)."""
    force: Array
    """Greatest force along and across the link over all rates [N] (K, 2, 2 joints)."""


def torque_figure(cases: Sequence[CaseCurves], limits: Sequence[float], top_rate: float) -> Figure:
    """Draw the torques of both joints, a row a case; the drives' limits are dashed."""
    figure, grid = _grid(len(cases))
    size = [1.12 * max(float(np.abs(c.reach[..., k]).max()) for c in cases) for k in (0, 1)]
    for row, case in enumerate(cases):
        for k in (0, 1):
            axes = grid[row][k]
            low, high = case.reach[:, 0, k], case.reach[:, 1, k]
            axes.fill_between(case.angles, low, high, color="#d7e6f1", linewidth=0, zorder=1)
            for which, style in ((0, (0, (1.4, 1.3))), (1, (0, (5, 1.6))), (2, "-")):
                curve = case.torque[:, which, k]
                axes.plot(case.angles, curve, color=MEASURED, linewidth=1.3, linestyle=style)
            for limit in (-limits[k], limits[k]):
                axes.axhline(limit, color=TRUTH, linewidth=1.0, linestyle=(0, (4, 2)))
            axes.set(ylim=(-size[k], size[k]))
            _finish(axes, last=row == len(cases) - 1)
        _name(grid[row][0], case.name)
    for k in (0, 1):
        text = f"joint {k + 1}: torque [N·m]; drive ±{limits[k]:g}"
        grid[0][k].text(0.0, 1.32, text, transform=grid[0][k].transAxes, color=INK, fontsize=9)
    _key(
        figure,
        [
            (MEASURED, (0, (1.4, 1.3)), f"θ₂' = −{top_rate:g} rad/s"),
            (MEASURED, (0, (5, 1.6)), "0"),
            (MEASURED, "-", f"+{top_rate:g} rad/s"),
            (TRUTH, (0, (4, 2)), "drive"),
        ],
    )
    return figure


def force_figure(cases: Sequence[CaseCurves]) -> Figure:
    """Draw the greatest forces at both joints, along and across the link each moves."""
    figure, grid = _grid(len(cases))
    size = [1.1 * max(float(c.force[..., k].max()) for c in cases) for k in (0, 1)]
    for row, case in enumerate(cases):
        for k in (0, 1):
            axes = grid[row][k]
            axes.plot(case.angles, case.force[:, 0, k], color=INK, linewidth=1.5)
            across: dict[str, Any] = {"linewidth": 1.5, "linestyle": (0, (5, 1.6))}
            axes.plot(case.angles, case.force[:, 1, k], color=MEASURED, **across)
            axes.set(ylim=(0.0, size[k]))
            _finish(axes, last=row == len(cases) - 1)
        _name(grid[row][0], case.name)
    for k in (0, 1):
        text = f"joint {k + 1}: greatest force [N]"
        grid[0][k].text(0.0, 1.32, text, transform=grid[0][k].transAxes, color=INK, fontsize=9)
    _key(figure, [(INK, "-", "along the link"), (MEASURED, (0, (5, 1.6)), "across it")])
    return figure


def _grid(rows: int) -> tuple[Figure, list[list[Axes]]]:
    each, above, below = 1.28, 0.46, 0.52
    height = rows * each + above + below
    figure = new_figure(height)
    width = (_RIGHT - _LEFT - _GAP) / 2
    grid = []
    for row in range(rows):
        bottom = (below + (rows - 1 - row) * each) / height
        tall = (each - 0.32) / height
        grid.append(
            [figure.add_axes((_LEFT + k * (width + _GAP), bottom, width, tall)) for k in (0, 1)]
        )
    return figure, grid


def _finish(axes: Axes, *, last: bool) -> None:
    quiet_axes(axes, pad=4, size=8, width=0.7)
    ticks = [-90, -45, 0, 45, 90]
    axes.set(xlim=(-90, 90))
    axes.set_xticks(
        ticks, [f"{t}°".replace("-", "−") for t in ticks] if last else [""] * len(ticks)
    )
    if last:
        labels = axes.get_xticklabels()
        labels[-1].set_horizontalalignment("right")
        axes.set_xlabel("θ₂", color=MUTED, fontsize=9, labelpad=2)


def _name(axes: Axes, text: str) -> None:
    axes.text(0.0, 1.06, text, transform=axes.transAxes, color=MUTED, fontsize=8.5)


def _key(figure: Figure, entries: Sequence[tuple[str, Any, str]]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, linestyle=style, linewidth=1.4) for colour, style, _ in entries
    ]
    figure.legend(
        handles,
        [text for *_, text in entries],
        loc="upper left",
        bbox_to_anchor=(_LEFT - 0.03, 1.0),
        ncols=len(entries),
        frameon=False,
        fontsize=8.5,
        labelcolor=INK,
        handlelength=2.2,
        columnspacing=1.4,
    )
