"""The picture of a planar arm: the arm in its plane, the correlation loop on its tool."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.caption import header_height, header_lines, write_header, write_legend
from loose_env.envs.rendering.correlation import Loop, Pair, measured_loop, predicted_loop
from loose_env.envs.rendering.fault_text import loose_links_of
from loose_env.envs.rendering.palette import FAINT, MEASURED, MUTED, PAPER
from loose_env.envs.rendering.planar.arm import ArmDrawing
from loose_env.envs.rendering.planar.view import PlanarPose, PlanarView
from loose_env.envs.rendering.scenery import draw_base, draw_measure
from loose_env.rig import Measurement
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PlanarScene"]

_HEADER, _LEGEND = 0.185, 0.105  # least shares of the height
_LOOP = 0.34  # radius of r = 1 over half the height of the drawing


def _draw_scale(axes: Axes, pose: PlanarPose, radius: float) -> None:
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


def _draw_healthy(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
    """Draw what the nominal, healthy arm would show: dashed and grey."""
    points = pose.tool + radius * loop.points @ pose.frame.T
    axes.plot(*points.T, color=MUTED, linewidth=1.3, linestyle=(0, (4, 2.5)), zorder=7.3)
    _axis(axes, pose, 1.08 * radius, loop.lowest, color=MUTED, width=1.3, dashes=(4, 2.5))


def _draw_measured(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
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
        self, figure: Figure, episode: Episode, measurement: Measurement | None, verdict: str | None
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
            _draw_scale(axes, pose, radius)
            _draw_healthy(axes, pose, radius, loops.healthy)
            _draw_measured(axes, pose, radius, loops.measured)
        drawing.tool(axes, pose)
        if truth is not None:
            drawing.fault(axes, pose, truth)
        write_header(figure, lines)
        if measurement is not None:
            write_legend(figure, truth, some_held=not measurement.excited.all())

    def _loops(self, measurement: Measurement) -> Pair[Loop]:
        at = self.linear.at(measurement.pose)
        measured = measured_loop(measurement)
        healthy = predicted_loop(predict(at, measurement.excitation, self._floor))
        return Pair(measured=measured, healthy=healthy.facing(measured))


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
