"""Surroundings of the arm: its base, the direction of gravity, a scale bar."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs.rendering.palette import EDGE, MUTED, PAPER
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["arrow", "draw_base", "draw_measure", "half_height", "number_size", "unit_vector"]


def half_height(axes: Axes) -> float:
    """Half the height of the drawing [m]."""
    low, high = axes.get_ylim()
    return 0.5 * (high - low)


def unit_vector(vector: Array) -> Array:
    """Vector of length one; a zero vector stays zero."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


def number_size(axes: Axes, radius: float, share: float, smallest: float) -> float:
    """Font size of a joint's number [pt]: a share of the radius [m], within limits."""
    low, high = axes.transData.transform([(0.0, 0.0), (radius, 0.0)])
    figure = axes.get_figure(root=True)
    assert figure is not None
    return float(np.clip(share * (high[0] - low[0]) * 72.0 / figure.dpi, smallest, 11.0))


def arrow(
    axes: Axes,
    start: Array,
    end: Array,
    *,
    color: str,
    width: float,
    zorder: float,
    both: bool = False,
    halo: bool = False,
) -> None:
    """Draw a straight arrow with a head at its end, or at both, and with a light rim."""
    from matplotlib.patheffects import withStroke

    note = axes.annotate(
        "",
        xy=(float(end[0]), float(end[1])),
        xytext=(float(start[0]), float(start[1])),
        arrowprops={
            "arrowstyle": f"{'<|' if both else ''}-|>,head_width=0.2,head_length=0.38",
            "color": color,
            "linewidth": width,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        zorder=zorder,
    )
    if halo and note.arrow_patch is not None:
        note.arrow_patch.set_path_effects([withStroke(linewidth=width + 2.2, foreground=PAPER)])


def draw_base(axes: Axes, radius: float, *, vertical: bool) -> None:
    """Draw what an arm of half-width ``radius`` [m] stands on, from the side or from above."""
    from matplotlib.patches import Circle, Polygon, Rectangle

    look: dict[str, Any] = {"facecolor": PAPER, "edgecolor": EDGE, "linewidth": 1.1, "zorder": 2}
    if not vertical:
        axes.add_patch(Circle((0.0, 0.0), 2.0 * radius, **look))
        for angle in np.radians([45, 135, 225, 315]):
            bolt = 1.6 * radius * np.array([np.cos(angle), np.sin(angle)])
            axes.add_patch(Circle((bolt[0], bolt[1]), 0.14 * radius, **look))
        return
    foot, wide = -2.6 * radius, 3.2 * radius
    sides = [(-1.9 * radius, foot), (-0.9 * radius, 0.0), (0.9 * radius, 0.0), (1.9 * radius, foot)]
    axes.add_patch(Polygon(sides, **look))
    axes.add_patch(
        Rectangle(
            (-wide, foot - 0.6 * radius),
            2 * wide,
            0.6 * radius,
            facecolor="none",
            edgecolor=MUTED,
            linewidth=0.0,
            hatch="/////",
            zorder=1,
        )
    )
    axes.plot([-wide, wide], [foot, foot], color=EDGE, linewidth=1.4, zorder=2)


def draw_measure(axes: Axes, *, vertical: bool) -> None:
    """Draw a measure of length, and gravity or the words that say whence one looks."""
    half = half_height(axes)
    (left, right), (bottom, _) = axes.get_xlim(), axes.get_ylim()
    inset, side = 0.05 * half, 0.04 * (right - left)
    decade = 10.0 ** float(np.floor(np.log10(0.6 * half)))
    length = max(k * decade for k in (1, 2, 5) if k * decade <= 0.6 * half)
    x, y = left + side, bottom + inset
    axes.plot([x, x + length], [y, y], color=MUTED, linewidth=1.2, solid_capstyle="butt")
    for end in (x, x + length):
        axes.plot([end, end], [y - 0.3 * inset, y + 0.3 * inset], color=MUTED, linewidth=1.2)
    look: dict[str, Any] = {"color": MUTED, "fontsize": 8.5, "va": "bottom"}
    axes.text(x, y + 0.5 * inset, f"{length:g} m", ha="left", **look)
    if vertical:
        tip = np.array([right - 1.4 * side, y])
        arrow(axes, tip + np.array([0.0, 0.2 * half]), tip, color=MUTED, width=1.4, zorder=1.0)
        axes.text(tip[0] - 0.9 * inset, y, "gravity", ha="right", **look)
    else:
        axes.text(right - side, bottom + 0.7 * inset, "seen from above", ha="right", **look)
