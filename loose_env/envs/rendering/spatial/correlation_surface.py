"""How well the tool follows the shaken joints along every direction in space.

Drawing the correlation in space: its cuts by the planes of the tool frame, side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from loose_env.diagnosis.records.prediction import Prediction
from loose_env.envs.rendering.palette import FAINT, INK, MEASURED, MUTED, PAPER
from loose_env.envs.rendering.planar.correlation_loop import record_of
from loose_env.envs.rendering.scenery import arrow
from loose_env.rig.measurement import Measurement
from loose_env.statistics import Covariances, covariances

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Section",
    "Surface",
    "SurfacePair",
    "draw_sections",
    "measured_surface",
    "predicted_surface",
    "surface_of",
]

Array = NDArray[np.float64]
_STILL = 1e-12
"""Share of the largest variance below which the tool counts as still along a direction."""
_FAINT = 0.05
"""Correlation below which a section shows no direction of its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """The surface cut by a plane through two axes of the tool frame."""

    axes: tuple[int, int]
    """Which of the measured axes span the plane."""
    points: Array
    """r(u) u for directions u in the plane [1] (K, 2)."""
    lowest: Array | None
    """Direction in the plane without correlation, unit vector (2,); None where the whole
    section is all but zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Correlation along u, r(u) = u.c / (sigma_x sqrt(u.S u)), over all directions."""

    peak: Array
    """c / sigma_x: covariance of the tool with the excitation of unit power [m/s²] (d,)."""
    tool: Array
    """S: covariance of the tool acceleration [m²/s⁴] (d, d)."""

    @property
    def maximum(self) -> float:
        """Highest correlation over directions [1]."""
        best = np.linalg.solve(_widened(self.tool), self.peak)
        return float(np.sqrt(np.clip(self.peak @ best, 0.0, 1.0)))

    def along(self, directions: Array) -> Array:
        """Correlation along directions (K, d) of any length [1] (K,); zero where all is still."""
        power = np.einsum("ki,ij,kj->k", directions, self.tool, directions)
        length = np.einsum("ki,ki->k", directions, directions)
        moving = power > _STILL * float(np.trace(self.tool)) * length
        spread = np.sqrt(np.where(moving, power, 1.0))
        return np.where(moving, directions @ self.peak / spread, 0.0)

    def section(self, first: int, second: int) -> Section:
        """Cut the surface by the plane of two measured axes."""
        across = np.array([-self.peak[second], self.peak[first]])
        start = float(np.arctan2(across[1], across[0])) if across.any() else 0.0
        # Close to the notch the correlation turns fast, so the angles crowd there.
        near = np.geomspace(1e-5, 0.1, 60)
        turn = np.unique(np.concatenate([np.linspace(0.0, np.pi, 361), near, np.pi - near]))
        flat = np.stack([np.cos(start + turn), np.sin(start + turn)], axis=1)
        directions = np.zeros((len(flat), len(self.peak)))
        directions[:, [first, second]] = flat
        radius = self.along(directions)
        clear = np.abs(radius).max() > _FAINT
        return Section(
            axes=(first, second), points=radius[:, None] * flat, lowest=flat[0] if clear else None
        )

    @property
    def sections(self) -> tuple[Section, ...]:
        """The cuts by all planes of two measured axes: x-y, x-z, y-z of three."""
        return tuple(self.section(i, j) for i, j in combinations(range(len(self.peak)), 2))

    def facing(self, other: Surface) -> Surface:
        """Turn the surface to the same side as another one."""
        if self.peak @ other.peak >= 0:
            return self
        return Surface(peak=-self.peak, tool=self.tool)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePair:
    """What a record shows, and what it would show on the healthy arm."""

    measured: Surface
    healthy: Surface


def surface_of(cov: Covariances) -> Surface:
    """Take the surface of a record with one or several shaken joints.

    Of several joints, the sum that correlates highest with the tool counts: the first canonical
    variate. Three axes and one sum leave a plane without correlation; it shows as a line in
    every section.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [0.0, 0.0, 0.0, 0.0]]
    >>> surface = surface_of(covariances(x, a))
    >>> surface.along(np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])).round(
    ...     3
    ... ).tolist()
    [1.0, 0.707, 0.0]
    """
    weights = np.ones(1)
    if len(cov.xx) > 1:
        by_joint = np.linalg.solve(cov.xx, cov.xa)
        _, vectors = eigh(cov.xa.T @ by_joint, _widened(cov.aa))
        weights = by_joint @ vectors[:, -1]
        # The sign of a sum is free: take the one in which most of it counts upwards.
        if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0:
            weights = -weights
    return Surface(peak=weights @ cov.xa / np.sqrt(weights @ cov.xx @ weights), tool=cov.aa)


def measured_surface(measurement: Measurement) -> Surface:
    """Take the surface of a measurement."""
    return surface_of(covariances(*record_of(measurement)))


def predicted_surface(prediction: Prediction) -> Surface:
    """Take the surface that the nominal, healthy arm would show."""
    return surface_of(
        Covariances(xx=prediction.joint, xa=prediction.joint_tool, aa=prediction.tool, count=0)
    )


def _widened(tool: Array) -> Array:
    """Add what keeps a covariance invertible where the tool does not move along some axis."""
    return np.asarray(tool + _STILL * float(np.trace(tool)) * np.eye(len(tool)))


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
