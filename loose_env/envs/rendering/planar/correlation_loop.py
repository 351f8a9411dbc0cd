"""Drawing of the correlation loop on the tool."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs.rendering.palette import FAINT, MEASURED, MUTED
from loose_env.envs.rendering.planar.view import PlanarPose
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from loose_env.envs.rendering.correlation_loop import Loop

__all__ = ["draw_healthy", "draw_measured", "draw_scale"]


def draw_scale(axes: Axes, pose: PlanarPose, radius: float) -> None:
    """Draw the circle on which the correlation would be 1, and name it."""
    from matplotlib.patches import Circle

    x, y = float(pose.tool[0]), float(pose.tool[1])
    axes.add_patch(
        Circle((x, y), radius, facecolor="none", edgecolor=FAINT, linewidth=1.1, zorder=3)
    )
    side = _clear_side(axes, pose, radius)
    label = pose.tool + 1.06 * radius * side
    axes.text(
        label[0],
        label[1],
        "r = 1",
        color=MUTED,
        fontsize=8,
        ha="left" if side[0] > 0 else "right",
        va="bottom" if side[1] > 0 else "top",
        zorder=9,
    )


def draw_healthy(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
    """Draw what the nominal, healthy arm would show: dashed and grey."""
    points = pose.tool + radius * loop.points @ pose.frame.T
    axes.plot(*points.T, color=MUTED, linewidth=1.3, linestyle=(0, (4, 2.5)), zorder=7.3)
    _axis(axes, pose, 1.08 * radius, loop.lowest, color=MUTED, width=1.3, dashes=(4, 2.5))


def draw_measured(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
    """Draw the loop of the record and its direction of lowest correlation."""
    from matplotlib.patches import Polygon

    points = pose.tool + radius * loop.points @ pose.frame.T
    axes.add_patch(Polygon(points, facecolor=MEASURED, alpha=0.22, linewidth=0, zorder=3.1))
    axes.plot(*points.T, color=MEASURED, linewidth=2.0, solid_joinstyle="round", zorder=7.4)
    _axis(axes, pose, 1.3 * radius, loop.lowest, color=MEASURED, width=2.6, dashes=None)


def _axis(
    axes: Axes,
    pose: PlanarPose,
    half: float,
    direction: Array,
    *,
    color: str,
    width: float,
    dashes: tuple[float, float] | None,
) -> None:
    along = half * (pose.frame @ direction)
    line = np.array([pose.tool - along, pose.tool + along])
    axes.plot(
        *line.T,
        color=color,
        linewidth=width,
        linestyle="-" if dashes is None else (0, dashes),
        dash_capstyle="butt",
        solid_capstyle="round",
        zorder=7.5 if dashes is None else 7.3,
    )


def _clear_side(axes: Axes, pose: PlanarPose, radius: float) -> Array:
    """Direction from the tool in which a label is farthest from the arm and inside the frame."""
    corners = np.vstack([pose.joints, pose.tool])
    share = np.linspace(0.0, 1.0, 20)[:, None]
    along = np.vstack([start + share * (end - start) for start, end in pairwise(corners)])
    angles = np.radians(np.arange(20.0, 380.0, 40.0))
    sides = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    labels = pose.tool + 1.17 * radius * sides
    gaps = np.linalg.norm(labels[:, None] - along, axis=2).min(axis=1)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    margin = 0.4 * radius
    inside = (labels[:, 0] > left + margin) & (labels[:, 0] < right - margin)
    inside &= (labels[:, 1] > low + margin) & (labels[:, 1] < high - margin)
    # The ends of the tool frame's arrows stay clear as well.
    gaps = np.minimum(gaps, 0.9 * radius)
    best: Array = sides[int(np.argmax(np.where(inside, gaps, -1.0)))]
    return best
