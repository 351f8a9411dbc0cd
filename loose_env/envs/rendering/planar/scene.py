"""The picture of a planar arm: the arm in its plane, the correlation loop on its tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
from loose_env.envs.rendering.correlation_loop import LoopPair, measured_loop, predicted_loop
from loose_env.envs.rendering.fault_text import loose_links_of
from loose_env.envs.rendering.palette import PAPER
from loose_env.envs.rendering.planar.arm import ArmDrawing
from loose_env.envs.rendering.planar.correlation_loop import draw_healthy, draw_measured, draw_scale
from loose_env.envs.rendering.planar.view import PlanarPose, PlanarView
from loose_env.envs.rendering.scenery import draw_base, draw_measure
from loose_env.rig import Measurement

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PlanarScene"]

_HEADER, _LEGEND = 0.185, 0.105  # least shares of the height
_LOOP = 0.34  # radius of r = 1 over half the height of the drawing


class PlanarScene:
    """Lays out the picture of an arm that moves in a plane.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    floor : SensorFloor
        Noise that the healthy arm's loop would show.

    Raises
    ------
    InvalidSetting
        If the arm does not move in a plane.
    """

    size = (4.5, 5.6)
    """Width and height [inches]."""

    def __init__(self, linear: LinearArm, floor: SensorFloor) -> None:
        self.linear = linear
        self._floor = floor
        self._view = PlanarView(linear.arm)
        self._drawing = ArmDrawing(linear.arm.reach, linear.arm.n, vertical=self._view.vertical)

    def compose(
        self,
        figure: Figure,
        episode: Episode,
        measurement: Measurement | None,
        verdict: str | None,
    ) -> None:
        """Draw an episode, with the record that is to be shown, into an empty figure."""
        figure.set_facecolor(PAPER)
        drawing = self._drawing
        excited = None if measurement is None else measurement.excited
        truth = episode.fault if episode.ended else None
        pose = self._view.at(episode.pose)
        loops = None if measurement is None else self._loops(measurement)
        lines = list(header_lines(self.linear, episode, measurement, loops, verdict))
        header = max(_HEADER, header_height(lines) / self.size[1])
        axes = figure.add_axes((0.0, _LEGEND, 1.0, 1.0 - header - _LEGEND))
        axes.set_axis_off()
        half = _frame(axes, pose, drawing)
        draw_measure(axes, vertical=drawing.vertical)
        draw_base(axes, float(drawing.radii[0]), vertical=drawing.vertical)
        drawing.links(axes, pose, loose=loose_links_of(truth))
        drawing.joints(axes, pose, excited)
        if loops is not None:
            radius = _LOOP * half
            draw_scale(axes, pose, radius)
            draw_healthy(axes, pose, radius, loops.healthy)
            draw_measured(axes, pose, radius, loops.measured)
        drawing.tool(axes, pose)
        if truth is not None:
            drawing.fault(axes, pose, truth)
        write_header(figure, lines)
        if measurement is not None:
            write_legend(figure, truth, some_held=not measurement.excited.all())

    def _loops(self, measurement: Measurement) -> LoopPair:
        at = self.linear.at(measurement.pose)
        measured = measured_loop(measurement)
        healthy = predicted_loop(predict(at, measurement.excitation, self._floor))
        return LoopPair(measured=measured, healthy=healthy.facing(measured))


def _frame(axes: Axes, pose: PlanarPose, drawing: ArmDrawing) -> float:
    """Fit the view round the arm and its loop; return half its height [m].

    The loop has the same size in every picture, so that records can be compared.
    """
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    assert figure is not None
    width, height = figure.get_size_inches() * (box.width, box.height)
    wide = width / height
    half = 0.42 * drawing.reach
    for _ in range(20):
        room = np.vstack(
            [drawing.room(pose), *(pose.tool + s * 1.35 * _LOOP * half for s in (-1, 1))]
        )
        low, high = room.min(axis=0), room.max(axis=0)
        low[1] -= 0.1 * half  # for the measure of length
        span = 0.5 * (high - low) + 0.06 * half
        half = max(0.42 * drawing.reach, float(span[0]) / wide, float(span[1]))
    middle = 0.5 * (low + high)
    axes.set(
        xlim=(middle[0] - wide * half, middle[0] + wide * half),
        ylim=(middle[1] - half, middle[1] + half),
    )
    return half
