"""Drawing a planar arm: its links, joints and tool, and what is loose in it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loose_env.envs.rendering.palette import BODY, EDGE, INK, ON_SHAKEN, PAPER, SHAKEN, TRUTH
from loose_env.envs.rendering.planar.view import PlanarPose
from loose_env.envs.rendering.scenery import arrow, half_height, number_size, unit_vector
from loose_env.faults import Backlash, Fault, RotationalLooseness, StructuralLooseness, parts_of
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import PathPatch
    from matplotlib.transforms import Transform

__all__ = ["ArmDrawing"]


class ArmDrawing:
    """Draws one arm, in any pose, at one size.

    Parameters
    ----------
    reach : float
        Reach of the arm [m].
    links : int
        Number of links.
    vertical : bool
        Whether gravity points down in the picture; else the arm is seen from above.
    """

    def __init__(self, reach: float, links: int, *, vertical: bool) -> None:
        self.reach, self.vertical = reach, vertical
        thick = min(0.05 * reach, 0.25 * reach / links)
        self.radii = thick * np.linspace(1.0, 0.6, links + 1)
        """Half the width of the arm at each joint and at the tool [m] (n + 1,)."""

    def room(self, pose: PlanarPose) -> Array:
        """Points that the view must hold: the arm, its base and the arrows round it (k, 2)."""
        r = float(self.radii[0])
        corners = np.vstack([pose.joints, pose.tool])
        base = r * np.array([[-3.4, -3.4], [3.4, 0.0]] if self.vertical else [[-2.6, -2.6]])
        return np.vstack([corners - 2.6 * r, corners + 2.6 * r, base])

    def links(self, axes: Axes, pose: PlanarPose, *, loose: Collection[int] = ()) -> None:
        """Draw the links, distal ones on top; loose ones in the colour of the truth."""
        for i, (start, end) in enumerate(zip(pose.joints, pose.ends, strict=True)):
            link = self._link(start, end, self.radii[i], self.radii[i + 1])
            link.set_facecolor(TRUTH if i + 1 in loose else BODY)
            link.set_zorder(4 + 0.1 * i)
            axes.add_patch(link)

    def joints(self, axes: Axes, pose: PlanarPose, excited: NDArray[np.bool_] | None) -> None:
        """Draw the joints with their numbers; without a record, none is shaken or held."""
        from matplotlib.patches import FancyBboxPatch

        for j, centre in enumerate(pose.joints):
            r = 0.95 * float(self.radii[j])
            order = 8.0 + 0.01 * j
            on = excited is not None and bool(excited[j])
            held = excited is not None and not on
            if held:
                style = f"round,pad=0,rounding_size={0.3 * r}"
                clamp = FancyBboxPatch((-1.12 * r, -1.12 * r), 2.24 * r, 2.24 * r, boxstyle=style)
                clamp.set_transform(_placed(axes, pose, j))
                clamp.set(facecolor=EDGE, edgecolor=PAPER, linewidth=0.8, zorder=order)
                axes.add_patch(clamp)
            face = SHAKEN if on else (EDGE if held else PAPER)
            _disc(
                axes, centre, r, facecolor=face, edgecolor=EDGE, linewidth=1.2, zorder=order + 0.001
            )
            axes.text(
                float(centre[0]),
                float(centre[1]),
                str(j + 1),
                color=ON_SHAKEN if on else (PAPER if held else INK),
                fontsize=number_size(axes, r, 1.15, 4.5),
                fontweight="bold",
                ha="center",
                va="center_baseline",
                zorder=order + 0.002,
            )
            if on:
                self._swing(axes, pose, j)

    def tool(self, axes: Axes, pose: PlanarPose) -> None:
        """Draw the tool and the axes of its frame."""
        from matplotlib.patheffects import withStroke

        r, length = 0.7 * float(self.radii[-1]), 0.16 * half_height(axes)
        for name, axis in zip("xy", pose.frame.T, strict=True):
            end = pose.tool + length * axis
            arrow(axes, pose.tool, end, color=INK, width=1.2, zorder=9.0)
            label = pose.tool + 1.22 * length * axis
            text = axes.text(label[0], label[1], name, color=INK, fontsize=8.5, zorder=9)
            text.set(fontstyle="italic", ha="center", va="center")
            text.set_path_effects([withStroke(linewidth=2.0, foreground=PAPER)])
        _disc(axes, pose.tool, r, facecolor=INK, edgecolor=PAPER, linewidth=0.8, zorder=9.1)

    def fault(self, axes: Axes, pose: PlanarPose, fault: Fault) -> None:
        """Point at the loose seat: which way a link slides or turns, or where the play is."""
        for part in parts_of(fault):
            if isinstance(part, StructuralLooseness):
                where = part.link - 1
                direction = pose.seats[where] @ np.asarray(part.direction, dtype=float)
                direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
                along = pose.ends[where] - pose.joints[where]
                middle = pose.joints[where] + 0.45 * along
                half = 0.13 * half_height(axes) * direction
                start, end = middle - half, middle + half
                arrow(axes, start, end, color=INK, width=1.8, zorder=8.5, both=True)
            elif isinstance(part, RotationalLooseness):
                where = part.link - 1
                pivot = pose.joints[where] + pose.seats[where] @ np.asarray(part.pivot, dtype=float)
                out = unit_vector(pose.ends[where] - pose.joints[where])
                radius = 0.13 * half_height(axes)
                _arc(axes, pivot, out, radius, color=INK, zorder=8.5)
            elif isinstance(part, Backlash):
                joint = part.joint - 1
                _disc(
                    axes,
                    pose.joints[joint],
                    1.55 * float(self.radii[joint]),
                    facecolor="none",
                    edgecolor=TRUTH,
                    linewidth=3.2,
                    zorder=8.4,
                )

    def _link(self, start: Array, end: Array, wide: float, narrow: float) -> PathPatch:
        """Shape a link: two round ends and the straight sides that touch them."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path

        along = end - start
        length = float(np.linalg.norm(along))
        heading = np.arctan2(along[1], along[0])
        slant = np.arccos(np.clip((wide - narrow) / length, -1.0, 1.0))
        far = heading + np.linspace(-slant, slant, 24)
        near = heading + np.linspace(slant, 2 * np.pi - slant, 36)
        outline = np.vstack(
            [
                end + narrow * np.stack([np.cos(far), np.sin(far)], axis=1),
                start + wide * np.stack([np.cos(near), np.sin(near)], axis=1),
            ]
        )
        path = Path(np.vstack([outline, outline[:1]]), closed=True)
        return PathPatch(path, edgecolor=EDGE, linewidth=1.3, joinstyle="round")

    def _swing(self, axes: Axes, pose: PlanarPose, j: int) -> None:
        """Draw the arrow of a shaken joint, round the side where no link is."""
        centre = pose.joints[j]
        radius = max(2.0 * float(self.radii[j]), 0.08 * half_height(axes))
        out = unit_vector(pose.ends[j] - centre)
        back = unit_vector(pose.joints[j - 1] - centre) if j > 0 else -out
        free = -(out + back)
        if np.linalg.norm(free) < 0.35:
            free = np.array([-out[1], out[0]])
        _arc(axes, centre, free, radius, color=SHAKEN, zorder=6.6)


def _arc(
    axes: Axes, centre: Array, middle: Array, radius: float, *, color: str, zorder: float
) -> None:
    """Draw an arrow with two heads round a centre, its middle in the given direction."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    angle = np.degrees(np.arctan2(middle[1], middle[0]))
    arc = Path.arc(angle - 75, angle + 75)
    axes.add_patch(
        FancyArrowPatch(
            path=Path(centre + radius * np.asarray(arc.vertices), arc.codes),
            arrowstyle="<|-|>,head_width=3.2,head_length=5.5",
            facecolor=color,
            edgecolor=color,
            linewidth=2.0,
            mutation_scale=1.0,
            joinstyle="miter",
            zorder=zorder,
        )
    )


def _disc(axes: Axes, centre: Array, radius: float, **look: Any) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle((float(centre[0]), float(centre[1])), radius, **look))


def _placed(axes: Axes, pose: PlanarPose, j: int) -> Transform:
    """Return the transform from the frame of a link to the picture."""
    from matplotlib.transforms import Affine2D

    along = pose.ends[j] - pose.joints[j]
    turn = Affine2D().rotate(float(np.arctan2(along[1], along[0])))
    return turn.translate(float(pose.joints[j, 0]), float(pose.joints[j, 1])) + axes.transData
