"""The picture of an episode: the arm in its pose, with the latest record on its tool."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import SensorFloor
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.planar.scene import PlanarScene
from loose_env.envs.rendering.planar.view import moves_in_a_plane
from loose_env.envs.rendering.spatial.scene import SpaceScene
from loose_env.errors import InvalidSetting, MissingExtra
from loose_env.rig import Measurement
from loose_env.sensors import SensorSuite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Picture"]

_DPI = 160
_SHOWN = 0.5  # seconds that a window stays before the episode goes on


class Picture:
    """Draws the episodes of one arm, as arrays of pixels or in a window.

    The true fault shows once the episode has ended, never before.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm. One that moves in a plane is drawn in it, any other one in space.
    show : bool
        Whether to draw in a window; else `draw` returns the pixels.
    sensors : SensorSuite, optional
        What reads the motion: the noise that the healthy arm's loop would show.

    Raises
    ------
    InvalidSetting
        If a window is wanted and there is no display.
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
        floor = SensorFloor.of(SensorSuite() if sensors is None else sensors, arm.band)
        scene = PlanarScene if moves_in_a_plane(arm) else SpaceScene
        self._scene: PlanarScene | SpaceScene = scene(linear, floor)
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
        ndarray (height, width, 3) of uint8, or None
            The picture in red, green and blue, 720 pixels wide and 896 high for an arm in a
            plane, 896 wide and 1200 high for one in space; None where it is shown in a window.
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

        figure = Figure(figsize=self._scene.size, dpi=_DPI)
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
                num=f"loose-env: {self.linear.arm.name}", figsize=self._scene.size, clear=True
            )
            self._window.show()
        self._window.clear()
        self._compose(self._window, episode, verdict)
        self._window.canvas.draw()
        self._window.canvas.start_event_loop(_SHOWN)

    def _compose(self, figure: Figure, episode: Episode, verdict: str | None) -> None:
        self._scene.compose(figure, episode, _shown_measurement(episode), verdict)


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
