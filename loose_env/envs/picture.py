"""The picture of an episode: the arm in its pose, with the latest record on its tool."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.linear import LinearArm
from loose_env.diagnosis.prediction import SensorFloor, predict
from loose_env.envs.drawing.arm import ArmDrawing
from loose_env.envs.drawing.caption import header_lines, write_header, write_legend
from loose_env.envs.drawing.ink import PAPER
from loose_env.envs.drawing.loop import LoopPair, measured_loop, predicted_loop
from loose_env.envs.drawing.loop_shapes import draw_healthy, draw_measured, draw_scale
from loose_env.envs.drawing.scenery import draw_base, draw_measure
from loose_env.envs.drawing.view import PlanarPose, PlanarView
from loose_env.envs.episode import Episode
from loose_env.errors import InvalidSetting, MissingExtra
from loose_env.faults import StructuralLooseness
from loose_env.rig.measurement import Measurement
from loose_env.sensors import SensorSuite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Picture"]

_SIZE = (4.5, 5.6)  # inches
_DPI = 160  # 720 x 896 pixels
_HEADER, _LEGEND = 0.185, 0.105  # shares of the height
_LOOP = 0.34  # radius of r = 1 over half the height of the drawing
_SHOWN = 0.5  # seconds that a window stays before the episode goes on


class Picture:
    """Draws the episodes of one arm, as arrays of pixels or in a window.

    The true fault shows once the episode has ended, never before.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm; it must move in a plane.
    show : bool
        Whether to draw in a window; else `draw` returns the pixels.
    sensors : SensorSuite, optional
        What reads the motion: the noise that the healthy arm's loop would show.

    Raises
    ------
    InvalidSetting
        If the arm does not move in a plane, or a window is wanted and there is no display.
    MissingExtra
        If matplotlib is not installed.
    """

    def __init__(
        self, linear: LinearArm, *, show: bool, sensors: SensorSuite | None = None
    ) -> None:
        _require_matplotlib()
        if show:
            _require_display()
        arm = linear.arm
        self.linear, self.show = linear, show
        self._view = PlanarView(arm)
        self._drawing = ArmDrawing(arm.reach, arm.n, vertical=self._view.vertical)
        self._floor = SensorFloor.of(SensorSuite() if sensors is None else sensors, arm.band)
        self._window: Any = None

    def draw(self, episode: Episode, *, verdict: str | None = None) -> NDArray[np.uint8] | None:
        """Draw an episode as it stands.

        Parameters
        ----------
        episode : Episode
            The episode.
        verdict : str, optional
            The hypothesis that the agent named; shown once the episode has ended.

        Returns
        -------
        ndarray (896, 720, 3) of uint8, or None
            The picture in red, green and blue; None where it is shown in a window.
        """
        if self.show:
            self._update_window(episode, verdict)
            return None
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        figure = self.figure(episode, verdict=verdict)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        return np.array(pixels[..., :3], dtype=np.uint8)

    def figure(self, episode: Episode, *, verdict: str | None = None) -> Figure:
        """Return the picture as a figure of matplotlib, for saving in any format."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=_SIZE, dpi=_DPI)
        self._compose(figure, episode, verdict)
        return figure

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window)
            self._window = None

    def _update_window(self, episode: Episode, verdict: str | None) -> None:
        from matplotlib import pyplot

        if self._window is None or not pyplot.fignum_exists(self._window.number):
            self._window = pyplot.figure(
                num=f"loose-env: {self.linear.arm.name}", figsize=_SIZE, clear=True
            )
            self._window.show()
        self._window.clear()
        self._compose(self._window, episode, verdict)
        self._window.canvas.draw()
        self._window.canvas.start_event_loop(_SHOWN)

    def _compose(self, figure: Figure, episode: Episode, verdict: str | None) -> None:
        figure.set_facecolor(PAPER)
        drawing = self._drawing
        measurement = _shown_measurement(episode)
        excited = None if measurement is None else measurement.excited
        truth = episode.fault if episode.ended else None
        pose = self._view.at(episode.pose)

        axes = figure.add_axes((0.0, _LEGEND, 1.0, 1.0 - _HEADER - _LEGEND))
        axes.set_axis_off()
        half = _frame(axes, pose, drawing)
        draw_measure(axes, vertical=drawing.vertical)
        draw_base(axes, float(drawing.radii[0]), vertical=drawing.vertical)
        loose = truth.link if isinstance(truth, StructuralLooseness) else None
        drawing.links(axes, pose, loose=loose)
        drawing.joints(axes, pose, excited)
        loops = None
        if measurement is not None:
            loops = self._loops(measurement)
            radius = _LOOP * half
            draw_scale(axes, pose, radius)
            draw_healthy(axes, pose, radius, loops.healthy)
            draw_measured(axes, pose, radius, loops.measured)
        drawing.tool(axes, pose)
        if truth is not None:
            drawing.fault(axes, pose, truth)
        write_header(figure, header_lines(self.linear, episode, measurement, loops, verdict))
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


def _shown_measurement(episode: Episode) -> Measurement | None:
    """Return the latest record's measurement, if it has one that makes statistics."""
    valid = episode.records > 0 and episode.slots[episode.records - 1, 0] > 0.5
    return episode.last if valid else None


def _require_matplotlib() -> None:
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtra(
            "pictures need matplotlib: install it with pip install 'loose-env[report]'"
        ) from error


def _require_display() -> None:
    from matplotlib import pyplot
    from matplotlib.backends.registry import BackendFilter, backend_registry

    why = (
        "render_mode='human' opens a window, which needs a display and a window toolkit "
        "(tkinter or PyQt6); without them use render_mode='rgb_array' and save the pictures"
    )
    silent = backend_registry.list_builtin(  # type: ignore[no-untyped-call]
        BackendFilter.NON_INTERACTIVE
    )
    try:
        backend = pyplot.get_backend()
        pyplot.switch_backend(backend)
    except ImportError as error:
        raise InvalidSetting(f"{why} ({error})") from error
    if backend.lower() in silent:
        raise InvalidSetting(f"{why} (matplotlib draws with {backend!r})")
