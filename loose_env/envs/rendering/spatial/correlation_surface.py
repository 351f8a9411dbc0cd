"""Drawing of the correlation in space: cuts by the planes of the tool frame, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs.rendering.palette import FAINT, INK, MEASURED, MUTED, PAPER
from loose_env.envs.rendering.scenery import arrow
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
from loose_env.envs.rendering.correlation_surface import Section, SurfacePair

__all__ = ["draw_sections"]


_ROOM = 1.42
"""Half the width of a cut's drawing, over the circle r = 1."""


def draw_sections(
    figure: Figure,
    box: tuple[float, float, float, float],
    surfaces: SurfacePair,
    names: tuple[str, ...],
    slides: Array,
) -> None:
    """Draw every cut into a part of a figure.

    Parameters
    ----------
    figure : Figure
        The figure.
    box : tuple of float
        Left, bottom, width and height of the part, as shares of the figure.
    surfaces : SurfacePair
        What the record shows, and the healthy arm would.
    names : tuple of str
        Names of the measured axes.
    slides : ndarray (k, d)
        Directions in the tool frame in which a loose link slides, once they may be shown.
    """
    left, bottom, width, height = box
    measured, healthy = surfaces.measured.sections, surfaces.healthy.sections
    each = width / max(len(measured), 3)
    start = left + 0.5 * (width - each * len(measured))
    for k, (found, expected) in enumerate(zip(measured, healthy, strict=True)):
        axes = figure.add_axes((start + k * each, bottom, each, height))
        axes.set_axis_off()
        axes.set_aspect("equal")
        axes.set(xlim=(-_ROOM, _ROOM), ylim=(-_ROOM, _ROOM))
        first, second = (names[a] for a in found.axes)
        _circle(axes, first, second, number=k)
        _healthy(axes, expected)
        _measured(axes, found)
        for direction in slides:
            _truth(axes, direction[list(found.axes)])


def _circle(axes: Axes, first: str, second: str, *, number: int) -> None:
    """Draw the circle r = 1 with the two axes of the tool frame."""
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="none", edgecolor=FAINT, linewidth=1.1))
    for end, name in (((1.12, 0.0), first), ((0.0, 1.12), second)):
        axes.plot([-end[0], 0.0], [-end[1], 0.0], color=FAINT, linewidth=0.8, zorder=1)
        arrow(axes, np.zeros(2), np.array(end), color=MUTED, width=0.9, zorder=1.5)
        text = axes.text(end[0] * 1.14, end[1] * 1.14, name, color=INK, fontsize=9)
        text.set(fontstyle="italic", ha="center", va="center")
    if number == 0:
        place = -1.2 * float(np.sqrt(0.5))
        axes.text(place, place, "r = 1", color=MUTED, fontsize=8, ha="right", va="top")


def _healthy(axes: Axes, section: Section) -> None:
    axes.plot(*section.points.T, color=MUTED, linewidth=1.3, linestyle=(0, (4, 2.5)), zorder=3)
    if section.lowest is not None:
        line = np.outer([-1.0, 1.0], section.lowest)
        axes.plot(*line.T, color=MUTED, linewidth=1.2, linestyle=(0, (4, 2.5)), zorder=3)


def _measured(axes: Axes, section: Section) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(section.points, facecolor=MEASURED, alpha=0.22, linewidth=0, zorder=2))
    axes.plot(*section.points.T, color=MEASURED, linewidth=1.9, zorder=3.2)
    if section.lowest is not None:
        line = 1.15 * np.outer([-1.0, 1.0], section.lowest)
        axes.plot(*line.T, color=MEASURED, linewidth=2.3, solid_capstyle="round", zorder=3.3)


def _truth(axes: Axes, direction: Array) -> None:
    """Draw the part of the loose direction that lies in this plane, as long as that part is."""
    from matplotlib.patches import Circle

    if np.linalg.norm(direction) < 0.12:
        axes.add_patch(Circle((0.0, 0.0), 0.05, facecolor=INK, edgecolor=PAPER, zorder=5))
        return
    arrow(axes, -direction, direction, color=INK, width=1.6, zorder=4.1, both=True, halo=True)
