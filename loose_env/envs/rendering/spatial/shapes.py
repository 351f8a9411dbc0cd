"""Solid shapes as a camera far away sees them: prisms, rods, discs and turning arrows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull

from loose_env.envs.rendering.palette import EDGE
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Prism", "circle", "draw_rod", "draw_turn", "outline_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prism:
    """A straight prism: a can with many sides, a box with four. Camera coordinates."""

    centre: Array
    """(3,) [m]."""
    axis: Array
    """Unit vector (3,)."""
    radius: float
    """From the axis to a corner [m]."""
    half: float
    """Half its length [m]."""
    sides: int = 40

    def rings(self, grow: float = 1.0) -> tuple[Array, Array]:
        """Corners of the end towards the eye, and of the far end (sides, 3)."""
        ring = circle(self.axis, self.sides) * self.radius * grow
        along = self.axis if self.axis[2] >= 0 else -self.axis
        shift = grow * self.half * along
        return self.centre + ring + shift, self.centre + ring - shift

    def draw(self, axes: Axes, *, face: str, cap: str, zorder: float) -> None:
        """Draw the body and, lighter or darker, the end that is seen."""
        from matplotlib.patches import Polygon

        near, far = self.rings()
        look: dict[str, Any] = {"edgecolor": EDGE, "linewidth": 1.1, "joinstyle": "round"}
        both = np.vstack([near, far])[:, :2]
        axes.add_patch(Polygon(outline_of(both), facecolor=face, zorder=zorder, **look))
        if self.sides <= 8:
            for k in range(self.sides):
                m = (k + 1) % self.sides
                side = np.array([near[k], near[m], far[m], far[k]])
                if np.cross(side[1] - side[0], side[2] - side[1])[2] * self._turn() > 0:
                    axes.add_patch(Polygon(side[:, :2], facecolor=face, zorder=zorder, **look))
        axes.add_patch(Polygon(near[:, :2], facecolor=cap, zorder=zorder + 1e-4, **look))

    def ring(self, axes: Axes, *, color: str, width: float, zorder: float) -> None:
        """Draw a line round the whole prism, a little off it."""
        from matplotlib.patches import Polygon

        both = np.vstack(self.rings(1.45))[:, :2]
        line = Polygon(outline_of(both), facecolor="none", edgecolor=color, linewidth=width)
        line.set(joinstyle="round", zorder=zorder)
        axes.add_patch(line)

    def _turn(self) -> float:
        """1 where the corners run so that outer sides turn left as seen, else -1."""
        near, _ = self.rings()
        flat = near[:, :2]
        x, y = flat.T
        area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
        return -1.0 if area >= 0 else 1.0


def circle(axis: Array, count: int) -> Array:
    """Points of the unit circle about an axis, in camera coordinates (count, 3)."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside = aside / np.linalg.norm(aside)
    ahead = np.cross(axis, aside)
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return np.asarray(np.outer(np.cos(angle), aside) + np.outer(np.sin(angle), ahead))


def outline_of(points: Array) -> Array:
    """Corners of the convex outline of points (k, 2) in the picture."""
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 2:
        return points
    return np.asarray(points[ConvexHull(points).vertices])


def draw_rod(
    axes: Axes, start: Array, end: Array, wide: float, narrow: float, *, face: str, zorder: float
) -> None:
    """Draw a round rod with round ends, of half-widths ``wide`` and ``narrow`` [m]."""
    from matplotlib.patches import Polygon

    turn = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    ball = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    outline = outline_of(np.vstack([start[:2] + wide * ball, end[:2] + narrow * ball]))
    rod = Polygon(outline, facecolor=face, edgecolor=EDGE, linewidth=1.2)
    rod.set(joinstyle="round", zorder=zorder)
    axes.add_patch(rod)


def draw_turn(
    axes: Axes, centre: Array, axis: Array, radius: float, *, color: str, zorder: float
) -> None:
    """Draw an arrow with two heads round an axis, on the side towards the eye and below."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    ring = circle(axis, 96) * radius
    # Off the link, which mostly leaves upwards, and in front of it.
    front = int(np.argmax(ring @ np.array([0.35, -0.6, 0.7])))
    chosen = ring[(front + np.arange(-22, 23)) % 96]
    path = Path(centre[:2] + chosen[:, :2])
    arrow = FancyArrowPatch(
        path=path,
        arrowstyle="<|-|>,head_width=3.0,head_length=5.0",
        facecolor=color,
        edgecolor=color,
        linewidth=2.0,
        mutation_scale=1.0,
        joinstyle="miter",
    )
    arrow.set_zorder(zorder)
    axes.add_patch(arrow)
