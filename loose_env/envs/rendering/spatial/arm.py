"""Drawing an arm in space: its base, links, joints and tool, and what is loose in it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs.rendering.palette import (
    BODY,
    CAP,
    EDGE,
    FAINT,
    HELD_CAP,
    INK,
    ON_SHAKEN,
    PAPER,
    SHADOW,
    SHAKEN,
    TRUTH,
)
from loose_env.envs.rendering.scenery import arrow, half_height, number_size, unit_vector
from loose_env.envs.rendering.spatial.shapes import Prism, draw_rod, draw_turn
from loose_env.envs.rendering.spatial.view import SpacePose
from loose_env.faults import Backlash, Fault, RotationalLooseness, StructuralLooseness, parts_of
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["SpaceDrawing"]


_SHAKEN_SIDE = "#cf8a05"
"""Sides of shaken joints: as the ink, in shade."""


class SpaceDrawing:
    """Draws one arm, in any pose, at one size.

    Parameters
    ----------
    arm : Arm
        The arm.
    """

    def __init__(self, arm: Arm) -> None:
        self.reach, self.sliding = arm.reach, arm.sliding
        thick = min(0.045 * arm.reach, 0.21 * arm.reach / arm.n)
        self.radii = thick * np.linspace(1.0, 0.6, arm.n + 1)
        """Half the width of the arm at each joint and at the tool [m] (n + 1,)."""

    def room(self, pose: SpacePose) -> Array:
        """Points that the view must hold, in the picture (k, 2)."""
        corners = np.vstack([pose.joints, pose.tool])
        wide = 2.2 * float(self.radii[0])
        low, high = self._patch(pose)
        patch = [self._on_grid(pose, a, b) for a in (low[0], high[0]) for b in (low[1], high[1])]
        frame = pose.tool + 0.13 * self.reach * np.array([[-1.0], [1.0]])  # and its letters
        foot = pose.foot[None] - 1.2 * wide
        points = np.vstack([corners - wide, corners + wide, frame, patch, foot])
        return np.asarray(points[:, :2])

    @property
    def spacing(self) -> float:
        """Spacing of the grid on the floor [m]."""
        most = 0.3 * self.reach
        decade = 10.0 ** float(np.floor(np.log10(most)))
        return float(max(k * decade for k in (1, 2, 5) if k * decade <= most))

    def _patch(self, pose: SpacePose) -> tuple[Array, Array]:
        """First and last lines of the grid, either way, counted from the base."""
        corners = np.vstack([pose.joints, pose.tool, pose.foot])
        seen = (corners - pose.foot) @ pose.floor[:, :2] / self.spacing
        return np.floor(seen.min(axis=0) - 0.3), np.ceil(seen.max(axis=0) + 0.3)

    def _on_grid(self, pose: SpacePose, a: float, b: float) -> Array:
        return np.asarray(pose.foot + self.spacing * (pose.floor[:, :2] @ np.array([a, b])))

    def ground(self, axes: Axes, pose: SpacePose) -> None:
        """Draw the grid that the base stands on, and the shadow of the arm on it."""
        corners = np.vstack([pose.joints, pose.tool])
        low, high = self._patch(pose)
        for a in np.arange(low[0], high[0] + 0.5):
            line = np.array([self._on_grid(pose, a, b) for b in (low[1], high[1])])
            axes.plot(line[:, 0], line[:, 1], color=FAINT, linewidth=0.7, zorder=1)
        for b in np.arange(low[1], high[1] + 0.5):
            line = np.array([self._on_grid(pose, a, b) for a in (low[0], high[0])])
            axes.plot(line[:, 0], line[:, 1], color=FAINT, linewidth=0.7, zorder=1)
        shadow = pose.on_floor(corners)
        points = axes.transData.transform([(0.0, 0.0), (2 * float(self.radii[0]), 0.0)])
        figure = axes.get_figure(root=True)
        assert figure is not None
        width = 0.7 * float(points[1, 0] - points[0, 0]) * 72.0 / figure.dpi
        axes.plot(
            shadow[:, 0],
            shadow[:, 1],
            color=SHADOW,
            linewidth=width,
            solid_capstyle="round",
            solid_joinstyle="round",
            zorder=1.5,
        )

    def base(self, axes: Axes, pose: SpacePose) -> None:
        """Draw the column from the floor to the first joint."""
        r = float(self.radii[0])
        normal = pose.floor[:, 2]
        height = float((pose.joints[0] - pose.foot) @ normal)
        plate = 0.25 * r
        for centre, radius, half in (
            (pose.foot + plate * normal, 2.3 * r, plate),
            (pose.foot + 0.5 * height * normal, 1.15 * r, 0.5 * height),
        ):
            column = Prism(centre=centre, axis=normal, radius=radius, half=half)
            column.draw(axes, face=PAPER, cap=PAPER, zorder=2)

    def arm(
        self, axes: Axes, pose: SpacePose, excited: NDArray[np.bool_] | None, loose: Collection[int]
    ) -> None:
        """Draw links and joints, the nearer ones over the others.

        Parameters
        ----------
        axes : Axes
            Where to draw.
        pose : SpacePose
            The arm in its pose.
        excited : ndarray (n,), optional
            Which joints are shaken, the others being held; without a record there are neither.
        loose : collection of int
            Links that are drawn in the colour of the truth.
        """
        n = len(pose.joints)
        depth = np.concatenate([0.5 * (pose.joints + pose.ends)[:, 2], pose.joints[:, 2]])
        # A joint lies over both links that meet in it, so that its number can be read.
        links = np.concatenate([depth[:1], depth[:n]])
        depth[n:] = np.maximum(depth[n:], np.maximum(links[:-1], links[1:]) + 1e-6)
        for rank, part in enumerate(np.argsort(depth, kind="stable")):
            order = 4.0 + 0.02 * rank
            k = int(part) % n
            if part < n:
                face = TRUTH if k + 1 in loose else BODY
                start, end = pose.joints[k], pose.ends[k]
                wide, narrow = float(self.radii[k]), float(self.radii[k + 1])
                draw_rod(axes, start, end, 0.7 * wide, 0.7 * narrow, face=face, zorder=order)
            else:
                self._joint(axes, pose, k, excited, order)
        for link in loose:
            self._uncover(axes, pose, link - 1)

    def tool(self, axes: Axes, pose: SpacePose, measured: tuple[int, ...]) -> None:
        """Draw the tool and the axes of its frame that are measured."""
        from matplotlib.patches import Circle
        from matplotlib.patheffects import withStroke

        r, length = 0.75 * float(self.radii[-1]), 0.2 * half_height(axes)
        labels: list[Array] = []
        for k in measured:
            along = pose.frame[:2, k]
            end = pose.tool[:2] + length * along
            seen = float(np.linalg.norm(along))
            if seen > 0.15:
                arrow(axes, pose.tool, end, color=INK, width=1.3, zorder=9.0)
            beyond = 0.2 * length * along / max(seen, 0.15)
            label = end + beyond
            for other in labels:
                if np.linalg.norm(label - other) < 0.4 * length:
                    label = label + 0.4 * length * np.array([-along[1], along[0]]) / max(seen, 0.15)
            labels.append(label)
            text = axes.text(
                float(label[0]), float(label[1]), "xyz"[k], color=INK, fontsize=9, zorder=9.2
            )
            text.set(fontstyle="italic", ha="center", va="center")
            text.set_path_effects([withStroke(linewidth=2.0, foreground=PAPER)])
        dot = Circle((float(pose.tool[0]), float(pose.tool[1])), r, facecolor=INK, zorder=9.1)
        dot.set(edgecolor=PAPER, linewidth=0.8)
        axes.add_patch(dot)

    def fault(self, axes: Axes, pose: SpacePose, fault: Fault) -> None:
        """Point at what is loose: which way a link slides or turns, or where the play is."""
        for part in parts_of(fault):
            if isinstance(part, Backlash):
                can = self._body(pose, part.joint - 1)
                can.ring(axes, color=TRUTH, width=3.0, zorder=8.4)
            elif isinstance(part, StructuralLooseness):
                where = part.link - 1
                middle = pose.joints[where] + 0.45 * (pose.ends[where] - pose.joints[where])
                along = unit_vector(pose.seats[where] @ np.asarray(part.direction, dtype=float))
                self._slide(axes, middle, along)
            elif isinstance(part, RotationalLooseness):
                turn = pose.seats[part.link - 1]
                pivot = pose.origins[part.link - 1] + turn @ np.asarray(part.pivot, dtype=float)
                axis = unit_vector(turn @ np.asarray(part.axis, dtype=float))
                size = 0.14 * half_height(axes)
                draw_turn(axes, pivot, axis, size, color=INK, zorder=8.5)

    def _uncover(self, axes: Axes, pose: SpacePose, k: int) -> None:
        """Show a loose link that is hidden under its joints by a thin rod over them."""
        start, end = pose.joints[k], pose.ends[k]
        wide = float(self.radii[k])
        if np.linalg.norm((end - start)[:2]) > 4.5 * wide:
            return
        begin = start + 0.3 * (end - start)
        draw_rod(axes, begin, end, 0.35 * wide, 0.35 * wide, face=TRUTH, zorder=8.3)

    def _slide(self, axes: Axes, middle: Array, along: Array) -> None:
        """Draw the two ways of a sliding link; a dot in a ring where they are seen end on."""
        half = 0.17 * half_height(axes) * along[:2]
        if np.linalg.norm(along[:2]) < 0.3:
            self._towards_the_eye(axes, middle)
            return
        start, end = middle[:2] - half, middle[:2] + half
        arrow(axes, start, end, color=INK, width=1.9, zorder=8.5, both=True, halo=True)

    def _joint(
        self, axes: Axes, pose: SpacePose, j: int, excited: NDArray[np.bool_] | None, order: float
    ) -> None:
        on = excited is not None and bool(excited[j])
        held = excited is not None and not on
        body = self._body(pose, j)
        face = _SHAKEN_SIDE if on else (EDGE if held else BODY)
        cap = SHAKEN if on else (HELD_CAP if held else CAP)
        body.draw(axes, face=face, cap=cap, zorder=order)
        # The number stands on the end that is seen, or on the side of a can seen sidewise.
        ends = abs(float(body.axis[2])) > 0.45
        lift = np.sign(body.axis[2]) * body.half * body.axis if ends else np.zeros(3)
        place = body.centre + lift
        axes.text(
            float(place[0]),
            float(place[1]),
            str(j + 1),
            color=(ON_SHAKEN if on else (PAPER if held else INK)),
            fontsize=number_size(axes, body.radius, 1.25, 5.5),
            fontweight="bold",
            ha="center",
            va="center_baseline",
            zorder=order + 0.002,
        )
        if not on:
            return
        size = max(2.1 * body.radius, 0.1 * half_height(axes))
        if self.sliding[j]:
            aside = np.array([body.axis[1], -body.axis[0]])
            aside = 1.7 * body.radius * aside / max(float(np.linalg.norm(aside)), 1e-9)
            middle = body.centre[:2] + aside
            reach = 1.2 * size * body.axis[:2]
            arrow(
                axes, middle - reach, middle + reach, color=SHAKEN, width=2.0, zorder=9, both=True
            )
        else:
            draw_turn(axes, body.centre, body.axis, size, color=SHAKEN, zorder=8.0)

    def _body(self, pose: SpacePose, j: int) -> Prism:
        """Shape a joint: a can about the axis of a hinge, a box along a slide."""
        r = float(self.radii[j])
        shape = {"radius": 1.45 * r, "half": 1.6 * r, "sides": 4} if self.sliding[j] else {}
        return Prism(
            centre=pose.joints[j],
            axis=pose.axes[j],
            radius=float(shape.get("radius", 1.15 * r)),
            half=float(shape.get("half", 1.15 * r)),
            sides=int(shape.get("sides", 40)),
        )

    def _towards_the_eye(self, axes: Axes, middle: Array) -> None:
        """Draw the sign of a direction along the line of sight: a dot in a ring."""
        from matplotlib.patches import Circle

        place, size = (float(middle[0]), float(middle[1])), 0.045 * half_height(axes)
        ring = Circle(place, size, facecolor=PAPER, edgecolor=INK, linewidth=1.6, zorder=8.5)
        axes.add_patch(ring)
        axes.add_patch(Circle(place, 0.3 * size, facecolor=INK, zorder=8.6))
