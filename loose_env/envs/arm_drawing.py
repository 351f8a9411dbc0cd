"""Drawing a planar arm: base, links, joints and tool, and how big it all is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loose_env.envs.ink import BODY, EDGE, INK, MUTED, PAPER, SHAKEN, TRUTH
from loose_env.envs.planar_view import PlanarPose
from loose_env.faults import Backlash, Fault, StructuralLooseness

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import PathPatch
    from matplotlib.transforms import Transform

__all__ = ["ArmDrawing"]

Array = NDArray[np.float64]


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
        r = 2.6 * float(self.radii[0])
        foot = -3.3 * float(self.radii[0]) if self.vertical else -r
        corners = np.vstack([pose.joints, pose.tool])
        return np.vstack([corners - r, corners + r, [[0.0, foot]]])

    def base(self, axes: Axes) -> None:
        """Draw what the arm stands on."""
        from matplotlib.patches import Circle, Polygon, Rectangle

        r = self.radii[0]
        style = {"facecolor": PAPER, "edgecolor": EDGE, "linewidth": 1.0, "zorder": 2}
        if not self.vertical:
            axes.add_patch(Circle((0.0, 0.0), 2.0 * r, **style))
            for angle in np.radians([45, 135, 225, 315]):
                at = 1.6 * r * np.array([np.cos(angle), np.sin(angle)])
                axes.add_patch(Circle((at[0], at[1]), 0.14 * r, **style))
            return
        foot = -2.6 * r
        axes.add_patch(
            Polygon([(-1.9 * r, foot), (-0.9 * r, 0.0), (0.9 * r, 0.0), (1.9 * r, foot)], **style)
        )
        ground = Rectangle(
            (-3.2 * r, foot - 0.6 * r),
            6.4 * r,
            0.6 * r,
            facecolor="none",
            edgecolor=MUTED,
            linewidth=0.0,
            hatch="/////",
            zorder=1,
        )
        axes.add_patch(ground)
        axes.plot([-3.2 * r, 3.2 * r], [foot, foot], color=EDGE, linewidth=1.4, zorder=2)

    def links(self, axes: Axes, pose: PlanarPose, *, loose: int | None = None) -> None:
        """Draw the links, distal ones on top; the loose one in the colour of the truth."""
        for i, (start, end) in enumerate(zip(pose.joints, pose.ends, strict=True)):
            link = self._link(start, end, self.radii[i], self.radii[i + 1])
            link.set_facecolor(TRUTH if i + 1 == loose else BODY)
            link.set_zorder(4 + 0.1 * i)
            axes.add_patch(link)

    def joints(
        self,
        axes: Axes,
        pose: PlanarPose,
        excited: NDArray[np.bool_] | None,
    ) -> None:
        """Draw the joints with their numbers; without a record, none is shaken or held."""
        from matplotlib.patches import Circle, FancyBboxPatch

        for j, centre in enumerate(pose.joints):
            r = 0.95 * float(self.radii[j])
            x, y = float(centre[0]), float(centre[1])
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
            axes.add_patch(
                Circle(
                    (x, y),
                    r,
                    facecolor=face,
                    edgecolor=EDGE,
                    linewidth=1.2,
                    zorder=order + 0.001,
                )
            )
            axes.text(
                x,
                y,
                str(j + 1),
                color=PAPER if held else INK,
                fontsize=_number_size(axes, r),
                fontweight="bold",
                ha="center",
                va="center_baseline",
                zorder=order + 0.002,
            )
            if on:
                self._swing(axes, pose, j)

    def tool(self, axes: Axes, pose: PlanarPose) -> None:
        """Draw the tool and the axes of its frame."""
        from matplotlib.patches import Circle

        r, length = 0.7 * float(self.radii[-1]), 0.16 * _half_height(axes)
        for name, axis in zip("xy", pose.frame.T, strict=True):
            end = pose.tool + length * axis
            axes.annotate(
                "",
                xy=(end[0], end[1]),
                xytext=(pose.tool[0], pose.tool[1]),
                arrowprops={
                    "arrowstyle": "-|>,head_width=0.18,head_length=0.35",
                    "color": INK,
                    "linewidth": 1.2,
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
                zorder=9,
            )
            label = pose.tool + 1.22 * length * axis
            axes.text(
                label[0],
                label[1],
                name,
                color=INK,
                fontsize=8.5,
                fontstyle="italic",
                ha="center",
                va="center",
                zorder=9,
            )
        axes.add_patch(
            Circle(
                (pose.tool[0], pose.tool[1]), r, facecolor=INK, edgecolor=PAPER, lw=0.8, zorder=9.1
            )
        )

    def fault(self, axes: Axes, pose: PlanarPose, fault: Fault) -> None:
        """Point at the loose seat: which way a link slides, or where the play is."""
        if isinstance(fault, StructuralLooseness):
            where = fault.link - 1
            direction = pose.seats[where] @ np.asarray(fault.direction, dtype=float)
            direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
            # Beside the joint's number, on the link that slides.
            along = pose.ends[where] - pose.joints[where]
            middle = pose.joints[where] + 0.45 * along
            half = 0.13 * _half_height(axes) * direction
            axes.annotate(
                "",
                xy=tuple(middle + half),
                xytext=tuple(middle - half),
                arrowprops={
                    "arrowstyle": "<|-|>,head_width=0.22,head_length=0.4",
                    "color": INK,
                    "linewidth": 1.8,
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
                zorder=8.5,
            )
        elif isinstance(fault, Backlash):
            self._ring(
                axes, pose.joints[fault.joint - 1], 1.55 * float(self.radii[fault.joint - 1])
            )

    def surroundings(self, axes: Axes) -> None:
        """Draw which way gravity pulls, and a measure of length."""
        half = _half_height(axes)
        left, right, bottom, top = *axes.get_xlim(), *axes.get_ylim()
        inset = 0.05 * half
        side = 0.04 * (right - left)
        length = 10.0 ** np.floor(np.log10(0.6 * half))
        length *= max(k for k in (1, 2, 5) if k * length <= 0.6 * half)
        x, y = left + side, bottom + inset
        axes.plot([x, x + length], [y, y], color=MUTED, linewidth=1.2, solid_capstyle="butt")
        for end in (x, x + length):
            axes.plot([end, end], [y - 0.3 * inset, y + 0.3 * inset], color=MUTED, linewidth=1.2)
        small = {"color": MUTED, "fontsize": 8.5}
        axes.text(x, y + 0.5 * inset, f"{length:g} m", ha="left", va="bottom", **small)
        if self.vertical:
            x = right - 1.4 * side
            axes.annotate(
                "",
                xy=(x, bottom + inset),
                xytext=(x, bottom + inset + 0.2 * half),
                arrowprops={
                    "arrowstyle": "-|>,head_width=0.2,head_length=0.4",
                    "color": MUTED,
                    "linewidth": 1.4,
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
            )
            axes.text(x - 0.9 * inset, bottom + inset, "gravity", ha="right", va="bottom", **small)
        else:
            axes.text(
                right - side,
                bottom + 0.7 * inset,
                "seen from above",
                ha="right",
                va="bottom",
                **small,
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
        from matplotlib.patches import FancyArrowPatch
        from matplotlib.path import Path

        centre = pose.joints[j]
        radius = max(2.0 * float(self.radii[j]), 0.08 * _half_height(axes))
        out = _unit(pose.ends[j] - centre)
        back = _unit(pose.joints[j - 1] - centre) if j > 0 else -out
        free = -(out + back)
        if np.linalg.norm(free) < 0.35:
            free = np.array([-out[1], out[0]])
        middle = np.degrees(np.arctan2(free[1], free[0]))
        arc = Path.arc(middle - 75, middle + 75)
        axes.add_patch(
            FancyArrowPatch(
                path=Path(centre + radius * arc.vertices, arc.codes),
                arrowstyle="<|-|>,head_width=3.2,head_length=5.5",
                facecolor=SHAKEN,
                edgecolor=SHAKEN,
                linewidth=2.0,
                mutation_scale=1.0,
                joinstyle="miter",
                zorder=6.6,
            )
        )

    def _ring(self, axes: Axes, centre: Array, radius: float) -> None:
        from matplotlib.patches import Circle

        axes.add_patch(
            Circle(
                (centre[0], centre[1]),
                radius,
                facecolor="none",
                edgecolor=TRUTH,
                linewidth=3.2,
                zorder=8.4,
            )
        )


def _placed(axes: Axes, pose: PlanarPose, j: int) -> Transform:
    """Return the transform from the frame of a link to the picture."""
    from matplotlib.transforms import Affine2D

    along = pose.ends[j] - pose.joints[j]
    turn = Affine2D().rotate(float(np.arctan2(along[1], along[0])))
    return turn.translate(float(pose.joints[j, 0]), float(pose.joints[j, 1])) + axes.transData


def _number_size(axes: Axes, radius: float) -> float:
    """Font size [pt] that fits a joint of a radius [m]."""
    low, high = axes.transData.transform([(0.0, 0.0), (radius, 0.0)])
    figure = axes.get_figure(root=True)
    assert figure is not None
    return float(np.clip(1.15 * (high[0] - low[0]) * 72.0 / figure.dpi, 4.5, 11.0))


def _half_height(axes: Axes) -> float:
    low, high = axes.get_ylim()
    return 0.5 * (high - low)


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
