"""The picture of an arm in space: the arm above, below it the correlation cut by three planes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.caption import (
    header_height,
    header_lines,
    write_header,
    write_legend,
)
from loose_env.envs.rendering.correlation_surface import (
    SurfacePair,
    measured_surface,
    predicted_surface,
)
from loose_env.envs.rendering.fault_text import loose_links_of
from loose_env.envs.rendering.palette import MUTED, PAPER
from loose_env.envs.rendering.scenery import arrow, half_height
from loose_env.envs.rendering.spatial.arm import SpaceDrawing
from loose_env.envs.rendering.spatial.correlation_surface import draw_sections
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
        self,
        figure: Figure,
        episode: Episode,
        measurement: Measurement | None,
        verdict: str | None,
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
            draw_sections(figure, box, surfaces, names, slides)
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

    def _surfaces(self, measurement: Measurement) -> SurfacePair:
        at = self.linear.at(measurement.pose)
        measured = measured_surface(measurement)
        healthy = predicted_surface(predict(at, measurement.excitation, self._floor))
        return SurfacePair(measured=measured, healthy=healthy.facing(measured))


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
