"""The picture of an arm in space: the arm above, below it the correlation cut by three planes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.caption import header_height, header_lines, write_header, write_legend
from loose_env.envs.rendering.correlation import (
    Pair,
    Section,
    Surface,
    measured_surface,
    predicted_surface,
)
from loose_env.envs.rendering.fault_text import loose_links_of
from loose_env.envs.rendering.palette import FAINT, INK, MEASURED, MUTED, PAPER
from loose_env.envs.rendering.scenery import arrow, half_height
from loose_env.envs.rendering.spatial.arm import SpaceDrawing
from loose_env.envs.rendering.spatial.view import SpacePose, SpaceView
from loose_env.faults import Fault, StructuralLooseness, parts_of
from loose_env.rig import Measurement
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["SpaceScene"]


_HEADER, _CUTS, _LEGEND = 1.04, 2.0, 0.6  # heights, the first the least [inches]
_LETTERS = 70  # that fit beside each other
_ROOM = 1.42
"""Half the width of a cut's drawing, over the circle r = 1."""


def _draw_sections(
    figure: Figure,
    box: tuple[float, float, float, float],
    surfaces: Pair[Surface],
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
    surfaces : Pair
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


class SpaceScene:
    """Lays out the picture of an arm that does not move in a plane.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    floor : SensorFloor
        Noise that the healthy arm's correlation would show.
    """

    size = (5.6, 7.5)
    """Width and height [inches]."""

    def __init__(self, linear: LinearArm, floor: SensorFloor) -> None:
        self.linear = linear
        self._floor = floor
        self._view = SpaceView(linear.arm)
        self._drawing = SpaceDrawing(linear.arm)

    def compose(
        self, figure: Figure, episode: Episode, measurement: Measurement | None, verdict: str | None
    ) -> None:
        """Draw an episode, with the record that is to be shown, into an empty figure."""
        figure.set_facecolor(PAPER)
        arm, drawing = self.linear.arm, self._drawing
        truth = episode.fault if episode.ended else None
        pose = self._view.at(episode.pose)
        height = self.size[1]
        below = (_LEGEND + _CUTS + 0.22 if measurement is not None else 0.15) / height
        surfaces = None if measurement is None else self._surfaces(measurement)
        lines = list(header_lines(self.linear, episode, measurement, surfaces, verdict))
        header = max(_HEADER, header_height(lines, letters=_LETTERS)) / height
        axes = figure.add_axes((0.0, below, 1.0, 1.0 - header - below))
        axes.set_axis_off()
        _frame(axes, drawing.room(pose), drawing.reach)
        drawing.ground(axes, pose)
        self._surroundings(axes)
        drawing.base(axes, pose)
        excited = None if measurement is None else measurement.excited
        drawing.arm(axes, pose, excited, loose_links_of(truth))
        drawing.tool(axes, pose, arm.axes)
        if truth is not None:
            drawing.fault(axes, pose, truth)
        if surfaces is not None:
            names = tuple("xyz"[a] for a in arm.axes)
            box = (0.02, _LEGEND / height, 0.96, _CUTS / height)
            slides = _slides_in_tool_frame(truth, pose, arm.axes)
            _draw_sections(figure, box, surfaces, names, slides)
            figure.text(
                0.04,
                (_LEGEND + _CUTS + 0.12) / height,
                "Correlation r of the tool with the shaking, along directions in its planes",
                color=MUTED,
                fontsize=9,
                va="center",
            )
        write_header(figure, lines, letters=_LETTERS)
        if measurement is not None:
            held = not measurement.excited.all()
            write_legend(
                figure, truth, some_held=held, curve="correlation r", slides=len(slides) > 0
            )

    def _surroundings(self, axes: Axes) -> None:
        """Say how wide the grid is and which way gravity pulls."""
        half = half_height(axes)
        (left, right), (bottom, _) = axes.get_xlim(), axes.get_ylim()
        side = 0.04 * (right - left)
        look: dict[str, Any] = {"color": MUTED, "fontsize": 8.5}
        axes.text(
            left + side,
            bottom + 0.05 * half,
            f"grid {self._drawing.spacing:g} m",
            va="bottom",
            **look,
        )
        if not self._view.gravity:
            axes.text(right - side, bottom + 0.05 * half, "no gravity", ha="right", **look)
            return
        tip = np.array([right - 1.2 * side, bottom + 0.06 * half])
        arrow(axes, tip + np.array([0.0, 0.22 * half]), tip, color=MUTED, width=1.4, zorder=1.0)
        x = tip[0] - 0.04 * half
        axes.text(x, bottom + 0.05 * half, "gravity", ha="right", va="bottom", **look)

    def _surfaces(self, measurement: Measurement) -> Pair[Surface]:
        at = self.linear.at(measurement.pose)
        measured = measured_surface(measurement)
        healthy = predicted_surface(predict(at, measurement.excitation, self._floor))
        return Pair(measured=measured, healthy=healthy.facing(measured))


def _frame(axes: Axes, room: Array, reach: float) -> None:
    """Fit the view round the arm."""
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    assert figure is not None
    width, height = figure.get_size_inches() * (box.width, box.height)
    wide = width / height
    low, high = room.min(axis=0), room.max(axis=0)
    span = 0.5 * (high - low)
    half = max(0.45 * reach, 1.04 * float(span[0]) / wide, 1.06 * float(span[1]))
    middle = 0.5 * (low + high)
    axes.set(
        xlim=(middle[0] - wide * half, middle[0] + wide * half),
        ylim=(middle[1] - half, middle[1] + half),
    )


def _slides_in_tool_frame(fault: Fault | None, pose: SpacePose, measured: tuple[int, ...]) -> Array:
    """Directions in which a link slides, along the measured axes of the tool frame (k, d)."""
    parts = () if fault is None else parts_of(fault)
    slides = [part for part in parts if isinstance(part, StructuralLooseness)]
    directions = np.zeros((len(slides), len(measured)))
    for row, part in zip(directions, slides, strict=True):
        seen = pose.seats[part.link - 1] @ np.asarray(part.direction, dtype=float)
        row[:] = (pose.frame.T @ seen / np.linalg.norm(seen))[list(measured)]
    return directions
