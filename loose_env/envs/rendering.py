"""Pictures of an episode: the arm in its pose, and the tool's correlation by direction."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from textwrap import fill
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.spatial import ConvexHull

from loose_env.arms import Arm, LinearArm, LinearPose
from loose_env.diagnosis import Prediction, SensorFloor, predict
from loose_env.envs.batch import Episode
from loose_env.envs.faults import fault_words, hypothesis_words
from loose_env.envs.palette import BODY, EDGE, FAINT, INK, MEASURED, MUTED, PAPER, SHAKEN, TRUTH
from loose_env.errors import MissingExtra
from loose_env.excitation import Excitation
from loose_env.faults import (
    UNSURE,
    Backlash,
    Fault,
    RotationalLooseness,
    StructuralLooseness,
    parts_of,
)
from loose_env.rig import Measurement
from loose_env.sensors import SensorSuite
from loose_env.statistics import Covariances, acceleration_from_angle, bandpass, covariances
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STILL = 1e-12
"""Share of the largest variance below which the tool counts as still along a direction."""
_FAINT_SECTION = 0.05
"""Correlation below which a section shows no direction of its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrelationByDirection:
    """Correlation of the tool with the excitation: r(u) = u.c / (sigma_x sqrt(u.S u)).

    Of several excited joints, the sum that correlates highest with the tool counts: the first
    canonical variate.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [0.0, 0.0, 0.0, 0.0]]
    >>> found = CorrelationByDirection.of(covariances(x, a))
    >>> found.along(np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])).round(3).tolist()
    [1.0, 0.707, 0.0]
    """

    peak: Array
    """c / sigma_x: covariance of the tool with the excitation of unit power [m/s²] (d,)."""
    tool: Array
    """S: covariance of the tool acceleration [m²/s⁴] (d, d)."""

    @classmethod
    def of(cls, cov: Covariances) -> CorrelationByDirection:
        """Take it from covariances of the excited joints and the tool."""
        weights = np.ones(1)
        if len(cov.xx) > 1:
            by_joint = np.linalg.solve(cov.xx, cov.xa)
            _, vectors = eigh(cov.xa.T @ by_joint, _invertible(cov.aa))
            weights = by_joint @ vectors[:, -1]
            if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0:  # most of its power is positive
                weights = -weights
        return cls(peak=weights @ cov.xa / np.sqrt(weights @ cov.xx @ weights), tool=cov.aa)

    @property
    def maximum(self) -> float:
        """Highest correlation over directions [1]."""
        best = np.linalg.solve(_invertible(self.tool), self.peak)
        return float(np.sqrt(np.clip(self.peak @ best, 0.0, 1.0)))

    def along(self, directions: Array) -> Array:
        """Correlation along directions (K, d) of any length [1] (K,); zero where all is still."""
        power = np.einsum("ki,ij,kj->k", directions, self.tool, directions)
        length = np.einsum("ki,ki->k", directions, directions)
        moving = power > _STILL * float(np.trace(self.tool)) * length
        spread = np.sqrt(np.where(moving, power, 1.0))
        return np.where(moving, directions @ self.peak / spread, 0.0)

    def section(self, first: int, second: int) -> tuple[Array, Array | None]:
        """Correlation along the directions of the plane of two measured axes.

        Points r(u) u for directions u in it [1] (K, 2), and the direction in it without
        correlation (2,); None where all of it is all but zero.
        """
        across = np.array([-self.peak[second], self.peak[first]])
        start = float(np.arctan2(across[1], across[0])) if across.any() else 0.0
        near = np.geomspace(1e-5, 0.1, 60)  # dense where the correlation passes zero
        angles = start + np.unique([*np.linspace(0.0, np.pi, 361), *near, *(np.pi - near)])
        flat = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        directions = np.zeros((len(flat), len(self.peak)))
        directions[:, [first, second]] = flat
        radius = self.along(directions)
        clear = np.abs(radius).max() > _FAINT_SECTION
        return radius[:, None] * flat, flat[0] if clear else None

    def facing(self, other: CorrelationByDirection) -> CorrelationByDirection:
        """Turn it to the same side as another one."""
        return self if self.peak @ other.peak >= 0 else replace(self, peak=-self.peak)


def _invertible(tool: Array) -> Array:
    """Covariance of a tool that may be still along some direction, made invertible."""
    return np.asarray(tool + _STILL * float(np.trace(tool)) * np.eye(len(tool)))


def measured_correlation(measurement: Measurement) -> CorrelationByDirection:
    """Take the correlation that a measurement shows in the band of its excitation."""
    on = np.flatnonzero(measurement.excited)
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    return CorrelationByDirection.of(covariances(joint, bandpass(measurement.tool, rate, band)))


def predicted_correlation(prediction: Prediction) -> CorrelationByDirection:
    """Take the correlation that the nominal, healthy arm would show."""
    p = prediction
    return CorrelationByDirection.of(Covariances(xx=p.joint, xa=p.joint_tool, aa=p.tool, count=0))


def draw_section(
    axes: Axes,
    measured: CorrelationByDirection,
    healthy: CorrelationByDirection,
    names: Mapping[int, str],
) -> None:
    """Draw the correlation along the directions of a plane of two named axes, of a circle of 1."""
    from matplotlib.patches import Circle, Polygon

    axes.set_axis_off()
    axes.set(aspect="equal", xlim=(-1.35, 1.35), ylim=(-1.35, 1.35))
    axes.add_patch(Circle((0, 0), 1.0, facecolor="none", edgecolor=FAINT, linewidth=1.2))
    for end, name in zip(((1.08, 0.0), (0.0, 1.08)), names.values(), strict=True):
        axes.plot([-end[0], end[0]], [-end[1], end[1]], color=FAINT, linewidth=0.9, zorder=1)
        look: dict[str, Any] = {"fontsize": 9.5, "fontstyle": "italic", "ha": "center"}
        axes.text(1.12 * end[0], 1.12 * end[1], name, color=INK, va="center", **look)
    expected, (points, lowest) = healthy.section(*names)[0], measured.section(*names)
    axes.plot(*expected.T, color=MUTED, linewidth=1.4, dashes=(4, 2.5), zorder=4)
    axes.add_patch(Polygon(points, facecolor=MEASURED, alpha=0.22, linewidth=0, zorder=2))
    axes.plot(*points.T, color=MEASURED, linewidth=2.0, zorder=3)
    if lowest is not None:
        line = np.outer([-1.0, 1.0], lowest)
        axes.plot(*line.T, color=MEASURED, linewidth=2.4, zorder=3)


@dataclass(frozen=True, kw_only=True)
class _Mark:
    """One stroke of the drawing of an arm, in coordinates where gravity points down."""

    kind: str
    start: Array
    end: Array
    color: str
    label: str = ""


class ArmDrawing:
    """An arm in any pose, seen from one side.

    An arm whose joint axes are parallel and whose tool measures two axes is seen along its joint
    axes, any other one from aside and a little above. Gravity points down.

    Examples
    --------
    >>> from loose_env.arms import planar, scara
    >>> ArmDrawing(planar(2)).planar, ArmDrawing(scara()).planar
    (True, False)
    """

    def __init__(self, arm: Arm) -> None:
        self.arm, self._data = arm, mujoco.MjData(arm.model)
        gravity = np.asarray(arm.model.opt.gravity, dtype=float)
        self.gravity = float(np.linalg.norm(gravity))
        """Strength of gravity [m/s²]."""
        up = -gravity / self.gravity if self.gravity else np.eye(3)[2]
        ahead = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
        ahead = ahead - (ahead @ up) * up
        ahead = ahead / np.linalg.norm(ahead)
        self.turn = np.stack([ahead, np.cross(up, ahead), up])
        """From the world to coordinates in which gravity points down (3, 3)."""
        mujoco.mj_forward(arm.model, self._data)
        axes = np.array([self._data.joint(name).xaxis for name in arm.joints]) @ self.turn.T
        parallel = np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() < 1e-6
        self.planar = len(arm.axes) == 2 and bool(parallel)
        """Whether the arm moves in a plane."""
        eye = np.array([0.498, -0.797, 0.342])
        if self.planar:
            eye = -axes[0] if axes[0][2] < -1e-6 else axes[0]
        aside = float(np.hypot(eye[0], eye[1]))
        right = np.array([-eye[1], eye[0], 0.0]) / aside if aside > 0.14 else np.eye(3)[0]
        self.camera = np.stack([right, np.cross(eye, right), eye])
        """Rows: right, up and towards the eye, where gravity points down (3, 3)."""
        self.thickness = min(0.045 * arm.reach, 0.21 * arm.reach / arm.n)
        """Half the width of a link [m]."""

    @property
    def seen(self) -> str:
        """Whence the arm is seen, or which way gravity pulls, in words."""
        if self.planar and self.camera[2, 2] > 0.7:
            return "seen from above"
        return "gravity ↓" if self.gravity else "no gravity"

    def marks(
        self,
        pose: Array,
        *,
        excited: NDArray[np.bool_] | None = None,
        loose: Collection[int] = (),
        fault: Fault | None = None,
    ) -> list[_Mark]:
        """Strokes of an arm in a pose [rad or m] (n,).

        Excited joints are marked, the others as held; without ``excited`` joints are neither.
        Loose links and the play of a fault are in the colour of the truth; its directions and
        axes are pointed at.
        """
        arm, data, turn, r = self.arm, self._data, self.turn, self.thickness
        mujoco.mj_resetData(arm.model, data)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(arm.model, data)
        site = data.site(arm.tool)
        tool, frame = turn @ site.xpos, turn @ site.xmat.reshape(3, 3)
        axes = np.array([turn @ data.joint(name).xaxis for name in arm.joints])
        anchors = np.array([turn @ data.joint(name).xanchor for name in arm.joints])
        points = np.vstack([_apart(anchors, axes, tool, 0.06 * arm.reach), tool])
        parts = () if fault is None else parts_of(fault)
        play = {part.joint for part in parts if isinstance(part, Backlash)}
        flanged = [p for p in parts if isinstance(p, (StructuralLooseness, RotationalLooseness))]
        loose = {*loose, *(part.link for part in flanged)}
        found = []
        for k in range(arm.n):
            color = TRUTH if k + 1 in loose else BODY
            found.append(_Mark(kind="link", start=points[k], end=points[k + 1], color=color))
        for k, (at, axis) in enumerate(zip(points, axes, strict=False)):
            color = BODY if excited is None else SHAKEN if excited[k] else EDGE
            color = TRUTH if k + 1 in play else color
            kind, half = ("slide", 2.0 * r) if arm.sliding[k] else ("hinge", 1.3 * r)
            start, end = at - half * axis, at + half * axis
            found.append(_Mark(kind=kind, start=start, end=end, color=color, label=str(k + 1)))
        for k in arm.axes:
            end = tool + 0.16 * arm.reach * frame[:, k]
            found.append(_Mark(kind="axis", start=tool, end=end, color=INK, label="xyz"[k]))
        for part in flanged:
            k, body = part.link - 1, data.body(arm.seat_bodies[part.link - 1])
            seat, middle = turn @ body.xmat.reshape(3, 3), 0.55 * points[k] + 0.45 * points[k + 1]
            if isinstance(part, RotationalLooseness):
                middle = turn @ body.xpos + seat @ np.asarray(part.pivot, dtype=float)
            given = part.direction if isinstance(part, StructuralLooseness) else part.axis
            along = seat @ (np.asarray(given, dtype=float) / np.linalg.norm(given))
            half = 0.14 * arm.reach * along
            found.append(_Mark(kind="arrow", start=middle - half, end=middle + half, color=INK))
        return found

    def draw(self, axes: Axes, marks: Collection[_Mark]) -> None:
        """Draw marks, those nearer to the eye over those behind them."""
        from matplotlib.colors import to_rgb
        from matplotlib.patches import Polygon
        from matplotlib.patheffects import withStroke

        figure = axes.get_figure(root=True)
        assert figure is not None
        inches = axes.get_position().size * figure.get_size_inches()
        wide = float(inches[0] / inches[1])
        seen = [(m, self.camera @ m.start, self.camera @ m.end) for m in marks]
        ends = np.array([end for _, *both in seen for end in both])[:, :2]
        low, high = ends.min(axis=0), ends.max(axis=0)
        across, tall = high - low + 6 * self.thickness
        half = 0.5 * max(tall, across / wide, 0.8 * self.arm.reach)
        x, y = 0.5 * (low + high)
        axes.set_axis_off()
        axes.set(xlim=(x - wide * half, x + wide * half), ylim=(y - half, y + half), aspect="auto")
        r = 36 * self.thickness * inches[1] / half  # points

        def depth(own: tuple[_Mark, Array, Array]) -> float:
            first, last = own[1][2], own[2][2]
            # A link ends in its joints: it lies behind the farther one of them.
            far = min(first, last) - self.thickness
            return float(far if own[0].kind == "link" else 0.5 * (first + last))

        for k, (mark, start, end) in enumerate(sorted(seen, key=depth)):
            over = 3.0 + k / len(seen)
            text: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 6}
            if mark.kind in ("axis", "arrow"):
                style: Any = {"arrowstyle": "<|-|>" if mark.kind == "arrow" else "-|>"}
                style |= {"color": mark.color, "linewidth": 1.7, "shrinkA": 0, "shrinkB": 0}
                style |= {"path_effects": [withStroke(linewidth=3.9, foreground=PAPER)]}
                axes.annotate("", tuple(end[:2]), tuple(start[:2]), arrowprops=style, zorder=7)
                at = 1.25 * end - 0.25 * start
                axes.text(at[0], at[1], mark.label, color=INK, **text)
            elif mark.kind == "link":
                for color, width in ((EDGE, 1.5 * r + 2.0), (mark.color, 1.5 * r)):
                    line = axes.plot(*np.array([start, end]).T[:2], color=color, linewidth=width)
                    line[0].set(solid_capstyle="round", zorder=over)
            else:
                dark = mark.color in (EDGE, TRUTH)
                outline, cap = _cylinder(start, end, 1.3 * self.thickness)
                rim: Any = {"edgecolor": PAPER if dark else EDGE, "linewidth": 0.8, "zorder": over}
                side = [0.8 * part for part in to_rgb(mark.color)]
                axes.add_patch(Polygon(outline, facecolor=side, **rim))
                axes.add_patch(Polygon(cap, facecolor=mark.color, linewidth=0, zorder=over))
                text |= {"fontsize": float(np.clip(2 * r, 5.5, 11))}
                ink = PAPER if dark else INK
                at = 0.5 * (start + end)
                axes.text(at[0], at[1], mark.label, color=ink, **text)


def _cylinder(start: Array, end: Array, radius: float) -> tuple[Array, Array]:
    """Outline (K, 2) of a cylinder seen along the third axis, and of its end near the eye."""
    across, turn = np.linalg.svd((end - start)[None])[2][1:], np.linspace(0, 2 * np.pi, 60)
    rim = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1) @ across
    both = np.concatenate([start + rim, end + rim])[:, :2]
    near = end if end[2] > start[2] else start
    return both[ConvexHull(both).vertices], (near + rim)[:, :2]


def _apart(anchors: Array, axes: Array, tool: Array, near: float) -> Array:
    """Choose a point on every joint's axis so that joints of a wrist are seen apart (n, 3)."""
    points = anchors.copy()
    for j in range(1, len(points)):
        before, axis = points[j - 1], axes[j]
        foot = points[j] + ((before - points[j]) @ axis) * axis
        apart = float(np.linalg.norm(points[j] - before))
        if apart > 3 * near and float(np.linalg.norm(before - foot)) < near:
            points[j] = foot + 0.55 * (points[j] - foot)  # it turns about the link before it
        elif apart < near:
            after = points[j + 1] if j + 1 < len(points) else tool
            ahead = float((after - points[j]) @ axis)
            points[j] = points[j] + 0.6 * (abs(ahead) > 0.3 * near) * ahead * axis
    return points


class Picture:
    """Pictures of the episodes of one arm, as arrays of pixels or for saving.

    Above, the arm in its pose; below, the correlation of its latest record along the directions
    of each plane of the tool frame, measured and as the healthy arm would show it. The true fault
    shows once the episode has ended, never before.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite, optional
        What reads the motion: the noise that the healthy arm's correlation would show.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """

    size = (5.6, 6.6)
    """Width and height [inches]."""

    def __init__(self, linear: LinearArm, *, sensors: SensorSuite | None = None) -> None:
        if importlib.util.find_spec("matplotlib") is None:
            raise MissingExtra(
                "pictures need matplotlib: install it with pip install 'loose-env[report]'"
            )
        self.linear = linear
        self._floor = SensorFloor.of(sensors or SensorSuite(), linear.arm.band)
        self._drawing = ArmDrawing(linear.arm)

    def draw(self, episode: Episode, *, verdict: str | None = None) -> NDArray[np.uint8]:
        """Draw an episode as it stands; the verdict shows once it has ended.

        Returns
        -------
        ndarray (1056, 896, 3) of uint8
            The picture in red, green and blue.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas = FigureCanvasAgg(self.figure(episode, verdict=verdict))
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        return np.array(pixels[..., :3], dtype=np.uint8)

    def figure(self, episode: Episode, *, verdict: str | None = None) -> Figure:
        """Return the picture as a figure of matplotlib."""
        from matplotlib.figure import Figure

        figure, drawing, height = Figure(figsize=self.size, dpi=160), self._drawing, self.size[1]
        valid = episode.records > 0 and episode.slots[episode.records - 1, 0] > 0.5
        record = episode.last if valid else None
        truth = episode.fault if episode.ended else None
        figure.set_facecolor(PAPER)
        both = None
        if record is not None:
            measured, at = measured_correlation(record), self.linear.at(record.pose)
            healthy = predicted_correlation(predict(at, record.excitation, self._floor))
            both = measured, healthy.facing(measured)
        title, lines = self._words(episode, record, verdict)
        if both is not None:
            own, usual = (each.maximum for each in both)
            lines.append(f"Highest correlation {own:.3f}, {usual:.3f} on a healthy arm")
        head, body = fill(title, 44), "\n".join(fill(line, 70) for line in lines)
        look: dict[str, Any] = {"ha": "left", "va": "top"}
        color = TRUTH if truth is not None else INK
        figure.text(0.04, 1 - 0.14 / height, head, color=color, fontsize=13, **look)
        below = 0.14 + 0.25 * (1 + head.count("\n"))
        figure.text(0.04, 1 - below / height, body, color=MUTED, fontsize=9.5, **look)
        top = below + 0.19 * (1 + body.count("\n"))
        bottom = 2.25 if both is not None else 0.4
        axes = figure.add_axes((0.0, bottom / height, 1.0, 1 - (top + bottom) / height))
        excited = None if record is None else record.excited
        marks = drawing.marks(episode.pose, excited=excited, fault=truth)
        drawing.draw(axes, marks)
        figure.text(
            0.96, bottom / height, drawing.seen, color=MUTED, fontsize=9, ha="right", va="bottom"
        )
        if both is not None and record is not None:
            pairs = list(combinations([*enumerate("xyz"[a] for a in self.linear.arm.axes)], 2))
            left = 0.5 - len(pairs) / 6
            for k, pair in enumerate(pairs):
                panel = figure.add_axes((left + k / 3, 0.36 / height, 1 / 3, 1.86 / height))
                draw_section(panel, *both, dict(pair))
            self._legend(figure, record, truth)
        return figure

    def _words(
        self, episode: Episode, record: Measurement | None, verdict: str | None
    ) -> tuple[str, list[str]]:
        """Title, and lines below it; the truth first, once it is out."""
        if record is not None:
            said = shaking_words(self.linear.at(record.pose), record.excitation)
        elif episode.records == 0:
            said = "The arm takes its first pose."
        elif episode.last is not None and episode.last.failure is not None:
            said = "The measurement failed: this record says nothing."
        else:
            said = "Nothing was shaken, so there is nothing to see on the tool."
        pose = f"ose {pose_words(episode.pose, self.linear.arm.sliding)}"
        if not episode.ended:
            title = f"Record {episode.records}" if episode.records else "Not measured yet"
            return title, [said, f"P{pose}"]
        truth = fault_words(episode.fault, self.linear.arm)
        lines = [said, f"Record {episode.records}, p{pose}"]
        if verdict is not None:
            mark = " – right" if verdict == episode.fault.hypothesis else " – wrong"
            mark = "" if verdict == UNSURE else mark
            lines.insert(0, f"Verdict: {hypothesis_words(verdict)}{mark}")
        return truth[0].upper() + truth[1:], lines

    def _legend(self, figure: Figure, record: Measurement, truth: Fault | None) -> None:
        """Name the colours at the bottom."""
        entries = [("■", MEASURED, "measured"), ("- -", MUTED, "healthy arm")]
        entries.append(("●", SHAKEN, "shaken"))
        if not record.excited.all():
            entries.append(("●", EDGE, "held"))
        if truth is not None and truth.kind != "healthy":
            entries.append(("■", TRUTH, "loose"))
        x, y = 0.04, 0.18 / self.size[1]
        for mark, color, words in entries:
            figure.text(x, y, mark, color=color, fontsize=11, ha="left", va="center")
            figure.text(x + 0.035, y, words, color=INK, fontsize=9, ha="left", va="center")
            x += 0.075 + 0.016 * len(words)


def pose_words(pose: Array, sliding: NDArray[np.bool_]) -> str:
    """Write a pose in whole degrees, and whole millimetres where a joint slides."""
    words = (
        f"{round(1e3 * float(q))} mm" if slides else f"{round(float(np.degrees(q)))}°"
        for q, slides in zip(pose, sliding, strict=True)
    )
    return ", ".join(words).replace("-", "−")


def shaking_words(at: LinearPose, excitation: Excitation) -> str:
    """Say which joints are shaken, how hard and for how long."""
    arm = at.linear.arm
    joints = np.flatnonzero(excitation.excited)
    tool = at.response(excitation.excited).tool
    rms = np.array(excitation.torque_rms)[joints]
    rms = rms * np.sqrt(np.mean(np.sum(np.abs(tool) ** 2, axis=1), axis=0))
    near = np.isclose(rms[:, None], np.array(arm.levels), rtol=0.01)
    alike = bool(np.ptp(rms) < 0.01 * rms.max())
    top = int(near[0].argmax())
    if not near.any(axis=1).all():  # the torque limits left less
        hard = " and ".join(f"{a:.2g}" for a in (rms[:1] if alike else rms)) + " m/s²"
    elif alike:
        hard = f"level {top + 1} ({arm.levels[top]:g} m/s²)"
    else:
        hard = _list("level", near.argmax(axis=1) + 1)
    who = "All joints" if len(joints) == arm.n else _list("Joint", joints + 1)
    return f"{who} shaken at {hard} for {excitation.duration:g} s"


def _list(noun: str, items: Iterable[object]) -> str:
    """Join items with commas and "and" behind their noun."""
    *first, last = map(str, items)
    return f"{noun}s {', '.join(first)} and {last}" if first else f"{noun} {last}"
