"""Pictures of the pose choice: ellipsoids by pose, chosen sets, and sets drawn at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import Arm
from loose_env.envs import EDGE, FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.kinematics import Chain
from loose_env.report import WIDTH, new_figure, quiet_axes
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LINK = "#8e9aa6"
_FLAT = 0.8  # height of an ellipsoid panel over its width


@dataclass(frozen=True, kw_only=True, eq=False)
class EllipsoidPanel:
    """The arm in one pose with its ellipsoid; directions in the tool frame, from its x axis."""

    title: str
    """Title of the panel."""
    pose: Array
    """Joint positions [rad] (n,)."""
    half_axes: Array
    """Half axes in columns, tool frame [m] (2, 2)."""
    line: Array
    """Direction in which joint 1 moves the tool, tool frame (2,)."""
    printed: Array
    """Printed direction of the major axis, tool frame (2,)."""
    agrees: bool
    """True if the printed direction is that of the ellipsoid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Drive of chosen poses against sets drawn at random, in one arm and unit of drive."""

    title: str
    """Arm and unit of drive."""
    random: Array
    """Mean drive of each random set [any] (S,)."""
    chosen: Sequence[tuple[str, float]]
    """Name and mean drive of each chosen set, in the same unit."""


def ellipsoid_figure(arm: Arm, panels: Sequence[EllipsoidPanel], *, columns: int = 3) -> Figure:
    """Draw the arm and its manipulability ellipsoid in the tool frame, y up, a panel a pose.

    The ellipsoids are drawn about the tool at a third of their size.
    """
    from matplotlib.lines import Line2D

    rows = -(-len(panels) // columns)
    side, top = _FLAT * WIDTH / columns, 0.3
    height = rows * (side + top) + 0.02
    figure = new_figure(height)
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        bottom = 1 - ((row + 1) * (side + top)) / height
        axes = figure.add_axes(
            (column / columns, bottom, 1 / columns, side / height), aspect="equal"
        )
        _ellipsoid(axes, arm, panel)
    entries = [
        Line2D([], [], color=MEASURED, linewidth=1.6),
        Line2D([], [], color=MEASURED, linewidth=1.1),
        Line2D([], [], color=TRUTH, linewidth=1.5, linestyle=(0, (4, 2))),
        Line2D([], [], color=INK, linewidth=1.3, linestyle=(0, (1.2, 1.2))),
    ]
    words = ["ellipsoid", "its major axis", "major axis, printed", "line of joint 1"]
    place: dict[str, Any] = {"loc": "center", "bbox_to_anchor": (1 - 0.5 / columns, 0.23)}
    figure.legend(entries, words, frameon=False, fontsize=8.5, labelcolor=INK, **place)
    return figure


def set_figure(arms: Sequence[tuple[Arm, Array, Array]]) -> Figure:
    """Draw the chosen poses, a row an arm, with the pushes on the last link's seat.

    ``arms`` (Arm, ndarray (P, n), ndarray (P, 2, n)): arm, poses [rad] and push of the seat from
    each joint, in the last link's axes.
    """
    columns = max(len(poses) for _, poses, _ in arms)
    side, top = WIDTH / columns, 0.42
    height = len(arms) * (side + top)
    figure = new_figure(height)
    for row, (arm, poses, pushes) in enumerate(arms):
        drawn = [_drawn(arm, pose, push) for pose, push in zip(poses, pushes, strict=True)]
        low = [np.vstack([points, ends]).min(axis=0) for points, ends in drawn]
        high = [np.vstack([points, ends]).max(axis=0) for points, ends in drawn]
        half = 0.56 * float(
            max(np.ptp([a, b], axis=0).max() for a, b in zip(low, high, strict=True))
        )
        for column, (points, ends) in enumerate(drawn):
            bottom = 1 - ((row + 1) * (side + top)) / height
            axes = figure.add_axes(
                (column / columns, bottom, 1 / columns, side / height), aspect="equal"
            )
            _arm(axes, points)
            for end in ends:
                axes.annotate(
                    "",
                    xy=(float(end[0]), float(end[1])),
                    xytext=(float(points[-2, 0]), float(points[-2, 1])),
                    arrowprops={
                        "arrowstyle": "-|>",
                        "color": TRUTH,
                        "linewidth": 1.4,
                        "shrinkA": 0,
                        "shrinkB": 0,
                    },
                    zorder=4,
                )
            x, y = (low[column] + high[column]) / 2
            axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
            axes.axis("off")
            angles = [f"{a:.0f}°".replace("-", "−") for a in np.degrees(poses[column])]
            lines = [", ".join(angles[k : k + 2]) for k in range(0, len(angles), 2)]
            axes.set_title("\n".join(lines), fontsize=8.5, color=MUTED, pad=1)
    return figure


def _drawn(arm: Arm, pose: Array, push: Array) -> tuple[Array, Array]:
    """Joints and tool, and the ends of the pushes on the last seat, in the plane [m]."""
    chain = Chain.of(arm, pose)
    points = np.vstack([chain.anchors, chain.tool])[:, :2]
    size = 0.3 * arm.reach / float(np.linalg.norm(push, axis=0).max())
    return points, points[-2] + size * (chain.tool_axes[:2, :2] @ push).T


def comparison_figure(comparisons: Sequence[Comparison], *, columns: int = 2) -> Figure:
    """Draw the spread of random sets' drive and mark the chosen sets on it."""
    rows = -(-len(comparisons) // columns)
    each, below = 1.4, 0.3
    height = rows * each + below
    figure = new_figure(height)
    for k, item in enumerate(comparisons):
        row, column = divmod(k, columns)
        bottom = (below + (rows - 1 - row) * each + 0.16) / height
        axes = figure.add_axes((0.04 + 0.5 * column, bottom, 0.42, 0.78 / height))
        unit = float(item.random.mean())
        counts, edges = np.histogram(item.random / unit, bins=24)
        axes.stairs(counts / counts.max(), edges, fill=True, color=FAINT)
        smaller = min(value for _, value in item.chosen)
        for level, (name, value) in enumerate(item.chosen):
            at, colour = value / unit, (TRUTH, MEASURED)[level % 2]
            axes.plot([at, at], [0, 1.32], color=colour, linewidth=1.8)
            left = value == smaller
            shift, side = (-0.03, "right") if left else (0.03, "left")
            axes.text(at + shift, 1.32, name, color=colour, fontsize=8.5, ha=side, va="top")
        most = max([2.0, *(value / unit for _, value in item.chosen)])
        axes.set(xlim=(0.0, 1.12 * most), ylim=(0, 1.35))
        axes.text(0, 1.1, item.title, transform=axes.transAxes, color=INK, fontsize=9)
        axes.set_yticks([])
        quiet_axes(axes, grid=None, pad=4, size=8)
        if row == rows - 1:
            words = "drive over the mean of random poses"
            axes.set_xlabel(words, color=MUTED, fontsize=8.5, labelpad=3)
    return figure


def _ellipsoid(axes: Axes, arm: Arm, panel: EllipsoidPanel) -> None:
    chain = Chain.of(arm, panel.pose)
    world = np.vstack([chain.anchors, chain.tool])
    points = ((world - chain.tool) @ chain.tool_axes)[:, :2]
    _arm(axes, points)
    turn = np.linspace(0, 2 * np.pi, 121)
    small = panel.half_axes / 3
    ring = small @ np.array([np.cos(turn), np.sin(turn)])
    axes.plot(ring[0], ring[1], color=MEASURED, linewidth=1.6, zorder=3)
    length = 0.36 * arm.reach
    for vector, colour, width, style in (
        (small[:, 0] / np.linalg.norm(small[:, 0]), MEASURED, 1.1, "-"),
        (panel.printed, TRUTH, 1.5, (0, (4, 2))),
        (panel.line, INK, 1.3, (0, (1.2, 1.2))),
    ):
        ends = np.outer([-length, length], vector)
        look: dict[str, Any] = {"color": colour, "linewidth": width, "linestyle": style}
        axes.plot(ends[:, 0], ends[:, 1], zorder=4, **look)
    wide, middle = 0.72 * arm.reach, -0.38 * arm.reach
    axes.set(xlim=(middle - wide, middle + wide), ylim=(-_FLAT * wide, _FLAT * wide))
    axes.axis("off")
    colour = INK if panel.agrees else TRUTH
    axes.set_title(panel.title, fontsize=8.5, color=colour, pad=2)


def _arm(axes: Axes, points: Array) -> None:
    axes.plot(points[:, 0], points[:, 1], color=_LINK, linewidth=4, solid_capstyle="round")
    axes.plot(
        points[:-1, 0], points[:-1, 1], "o", markersize=5, color="white", markeredgecolor=EDGE
    )
    axes.plot(points[-1, 0], points[-1, 1], "s", markersize=4, color=EDGE)
    axes.plot(points[0, 0], points[0, 1], "o", markersize=5, color=EDGE)
