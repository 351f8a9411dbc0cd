"""Figures of a diagnosis: the arm in a pose, posterior by record, loops, transmissions."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from loose_env.arms import Arm
from loose_env.envs import EDGE, FAINT, INK, MEASURED, MUTED, SHAKEN, TRUTH, palette
from loose_env.errors import InvalidData
from loose_env.instrument import (
    HEALTHY,
    Diagnosis,
    Fault,
    Loop,
    RecordSeen,
    TransmissionSpectrum,
)
from loose_env.report.figures import (
    AGENTS,
    DASHED,
    arrow,
    ink_on,
    labels,
    legend,
    new_figure,
    panels,
    percent_ticks,
    plain,
    plain_log_ticks,
)
from loose_env.report.page import FigureCard
from loose_env.report.words import joint_words, short_name
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOSE = ("#d55e00", "#0173b2", "#e69f00", "#cc79a7", "#56b4e9")
_HEALTHY, _REST = "#009e73", AGENTS[-1]
"""Colours of the hypotheses, told apart by colour-blind eyes; none is one of the ink's."""
_SHOWN = 0.03  # probability that a hypothesis must have had once to get a colour of its own
_NARROW = 50.0  # half angle up to which a direction is drawn [degrees]
_CARDS = 2  # runs whose transmission is drawn
_AZIMUTH, _ELEVATION = np.radians(-58.0), np.radians(20.0)  # of the view of an arm in space


def arm_figure(
    arm: Arm,
    pose: Mapping[str, float],
    *,
    fault: Fault | None = None,
    excited: Collection[str] | None = None,
) -> Figure:
    """Draw an arm in a pose: links, numbered joints, tool frame, and what is suspected."""
    link, joint = _place(arm, fault)
    data = _posed(arm, pose)
    see, upright = _camera(arm, data)
    points = see @ _along_axes(arm, data).T  # joints and tool, (3, n + 1)
    figure, (axes,) = panels(1, 4.4, grid=None)
    axes.set_axis_off()
    size = float(max(np.ptp(points[:2], axis=1).max(), 0.6 * arm.reach))
    down = np.array([0.0, -0.16 * size]) if upright else np.zeros(2)
    foot = points[:2, 0] + down
    axes.plot(*np.stack([points[:2, 0], foot]).T, color=MUTED, linewidth=9, zorder=1)
    axes.plot(*foot, marker="_" if upright else "o", markersize=44, color=FAINT, mew=5, zorder=1)
    for k in np.argsort(points[2, :-1] + points[2, 1:]):
        ends, wide = points[:2, [k, k + 1]], 13 - 6 * k / arm.n
        own = k == link
        axes.plot(*ends, color=EDGE, linewidth=wide + 2, solid_capstyle="round", zorder=2)
        axes.plot(
            *ends, color=TRUTH if own else palette.BODY, linewidth=wide, zorder=2,
            solid_capstyle="round", label="suspected link" if own else None,
        )  # fmt: skip
    for k in np.argsort(points[2, :-1]):
        _joint(axes, arm, k, points[:2, k], excited, ringed=k == joint)
    if link is not None and fault is not None and fault.direction is not None:
        turn = data.body(arm.seat_bodies[link]).xmat.reshape(3, 3)
        along = 0.17 * size * (see @ turn @ np.array(fault.direction))[:2]
        middle = 0.55 * points[:2, link] + 0.45 * points[:2, link + 1]
        arrow(axes, middle - along, middle + along, color=INK, width=1.9, both=True)
        axes.plot([], [], color=INK, marker="$↔$", linestyle="", label="the way it slides")
    _tool(axes, see @ data.site(arm.tool).xmat.reshape(3, 3), points[:2, -1], arm, 0.12 * size)
    _measures(axes, size, upright=upright)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.14)
    if axes.get_legend_handles_labels()[0]:
        legend(figure, axes)
    return figure


def _place(arm: Arm, fault: Fault | None) -> tuple[int | None, int | None]:
    """Index of the suspected link and of the suspected joint."""
    if fault is None or fault.where is None:
        return None, None
    places = arm.joints if fault.kind == "backlash" else arm.seat_bodies
    if fault.where not in places:
        raise InvalidData(
            f"the diagnosis names {fault.where!r}, which arm {arm.name!r} does not have; it has "
            f"{', '.join(places)}: give the model that was diagnosed"
        )
    number = places.index(fault.where)
    return (None, number) if fault.kind == "backlash" else (number, None)


def _posed(arm: Arm, pose: Mapping[str, float]) -> mujoco.MjData:
    unknown = sorted(set(pose) - set(arm.joints))
    if unknown:
        raise InvalidData(
            f"the diagnosis has a pose of the joints {unknown}, which are none of arm "
            f"{arm.name!r}; it has {', '.join(arm.joints)}: give the model that was diagnosed"
        )
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = [float(pose.get(joint, 0.0)) for joint in arm.joints]
    mujoco.mj_forward(arm.model, data)
    return data


def _camera(arm: Arm, data: mujoco.MjData) -> tuple[Array, bool]:
    """Axes of the picture (right, up, towards the eye) in rows, and whether gravity is down.

    An arm whose joint axes are parallel is seen along them, any other from a side and above.
    """
    axes = np.array([data.joint(name).xaxis for name in arm.joints])
    gravity = np.asarray(arm.model.opt.gravity, dtype=float)
    up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() < 1e-6 and len(arm.axes) == 2:
        eye = axes[0]
    else:
        ahead = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
        ahead = ahead - (ahead @ up) * up
        ahead /= np.linalg.norm(ahead)
        level = np.cos(_AZIMUTH) * ahead + np.sin(_AZIMUTH) * np.cross(up, ahead)
        eye = np.cos(_ELEVATION) * level + np.sin(_ELEVATION) * up
    right = np.cross(up, eye)
    upright = bool(np.linalg.norm(right) > 0.1)
    if not upright:  # from above
        right = np.eye(3)[0 if abs(eye[0]) < 0.9 else 1]
        right = right - (right @ eye) * eye
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(eye, right), eye]), upright


def _along_axes(arm: Arm, data: mujoco.MjData) -> Array:
    """A point on every joint's axis, so that joints are seen apart, and the tool (n + 1, 3).

    A joint that turns about the link before it is drawn half way along that link; one in the same
    place as the joint before is drawn towards what comes next, if its axis leads there.
    """
    near = 0.06 * arm.reach
    points = [data.joint(name).xanchor.copy() for name in arm.joints]
    points.append(data.site(arm.tool).xpos.copy())
    for j in range(1, arm.n):
        axis, back = data.joint(arm.joints[j]).xaxis, points[j - 1] - points[j]
        foot = points[j] + (back @ axis) * axis
        apart = np.linalg.norm(back)
        if apart > 3 * near and np.linalg.norm(points[j - 1] - foot) < near:
            points[j] = foot + 0.55 * (points[j] - foot)
        elif apart < near:
            points[j] = points[j] + 0.6 * ((points[j + 1] - points[j]) @ axis) * axis
    return np.array(points)


def _joint(
    axes: Axes, arm: Arm, k: int, at: Array, excited: Collection[str] | None, *, ringed: bool
) -> None:
    """A numbered disc for a hinge, a square for a slide; a ring round the suspected one."""
    shape, colour, said = "s" if arm.sliding[k] else "o", palette.CAP, None
    if excited is not None:
        on = arm.joints[k] in excited
        colour, said = (SHAKEN, "shaken") if on else (palette.HELD_CAP, "braked or servoed")
    if ringed:
        look: dict[str, Any] = {"color": "none", "mec": TRUTH, "mew": 3, "zorder": 5}
        axes.plot(*at, "o", markersize=22, linestyle="", label="suspected joint", **look)
    axes.plot(*at, shape, color=colour, mec=EDGE, markersize=15, linestyle="", label=said, zorder=4)
    ink = {SHAKEN: ink_on(SHAKEN), palette.HELD_CAP: palette.PAPER}.get(colour, INK)
    axes.text(at[0], at[1], str(k + 1), color=ink, fontsize=9, fontweight="bold", ha="center",
              va="center_baseline", zorder=4.5)  # fmt: skip


def _tool(axes: Axes, frame: Array, at: Array, arm: Arm, length: float) -> None:
    """The tool and the axes of its frame that are measured."""
    axes.plot(*at, "o", color=INK, markersize=7, zorder=7)
    for k in arm.axes:
        along = length * frame[:2, k]
        if np.linalg.norm(along) > 0.15 * length:
            arrow(axes, at, at + along, color=INK, width=1.3)
        end = at + along + 0.25 * along / max(float(np.linalg.norm(along)) / length, 0.15)
        axes.text(end[0], end[1], "xyz"[k], color=INK, fontsize=9, fontstyle="italic", ha="center",
                  va="center", zorder=8)  # fmt: skip


def _measures(axes: Axes, size: float, *, upright: bool) -> None:
    """A measure of length, and the direction of gravity."""
    from mpl_toolkits.axes_grid1.anchored_artists import (  # type: ignore[import-untyped]
        AnchoredSizeBar,
    )

    decade = 10.0 ** float(np.floor(np.log10(0.4 * size)))
    length = max(k * decade for k in (1, 2, 5) if k * decade <= 0.4 * size)
    bar = AnchoredSizeBar(
        axes.transData, length, f"{length:g} m", "lower left", frameon=False, color=MUTED, pad=0.1
    )
    axes.add_artist(bar)
    look: dict[str, Any] = {"xycoords": "axes fraction", "color": MUTED, "fontsize": 9}
    axes.annotate("gravity ↓" if upright else "seen from above", (0.98, 0.02), ha="right", **look)


def shown_hypotheses(steps: Sequence[Mapping[str, float]]) -> list[str]:
    """Hypotheses with a colour of their own: healthy, and the most probable ones.

    Examples
    --------
    >>> shown_hypotheses([{"healthy": 0.5, "a": 0.48, "b": 0.02}, {"healthy": 0.0, "a": 1.0}])
    ['healthy', 'a']
    """
    most = {name: max(s.get(name, 0.0) for s in steps) for step in steps for name in step}
    named = [n for n, p in most.items() if p >= _SHOWN and n != HEALTHY]
    named.sort(key=lambda n: (-steps[-1].get(n, 0.0), -most[n]))
    return [*([HEALTHY] if HEALTHY in most else []), *named[: len(_LOOSE)]]


def posterior_figure(
    steps: Sequence[Mapping[str, float]], bars: Sequence[str], names: Mapping[str, str]
) -> Figure:
    """Draw the posterior after each record: a bar a record, divided among the hypotheses."""
    paints = iter(_LOOSE)
    parts = [
        (words, _HEALTHY if name == HEALTHY else next(paints), [s.get(name, 0.0) for s in steps])
        for name, words in names.items()
    ]
    rest = 1.0 - np.sum([shares for *_, shares in parts], axis=0)
    if rest.max() > 0.005:
        parts.append(("all others", _REST, rest.clip(0.0).tolist()))
    figure, (axes,) = panels(1, 0.36 * len(steps) + 0.4, rows=len(parts), grid=None)
    start, y = np.zeros(len(steps)), -np.arange(len(steps))
    for words, colour, shares in parts:
        drawn = axes.barh(y, shares, left=start, height=0.74, color=colour, label=words)
        whole = ["over 99" if p > 0.995 else f"{100 * p:.0f}" if p >= 0.085 else "" for p in shares]
        axes.bar_label(drawn, whole, label_type="center", color=ink_on(colour), fontsize=9.5)
        start += shares
    axes.set_ylim(0.5 - len(steps), 0.5)
    axes.set_yticks(y, bars)
    percent_ticks(axes, "x")
    legend(figure, axes)
    return figure


def loop_figure(record: RecordSeen) -> Figure:
    """Draw the correlation loops of one record, a panel for each joint and plane."""
    loops, across = record.loops, min(3, max(len(record.loops), 2))
    down = -(-len(loops) // across)
    height = 5.4 * down / across + 0.5
    figure = new_figure(height)
    many = figure.subplots(down, across, squeeze=False).flatten().tolist()
    figure.subplots_adjust(0, 0, 1, 1 - 0.5 / height, 0, 0)
    for axes in many[len(loops) :]:
        axes.remove()
    for axes, loop in zip(many, loops, strict=False):
        _loop(axes, loop, record)
        if len({each.joint for each in loops}) > 1:
            axes.set_title(plain(loop.joint, 22), color=MUTED, fontsize=9)
        axes.set_axis_off()
        axes.set(aspect="equal", xlim=(-1.38, 1.38), ylim=(-1.38, 1.38))
    legend(figure, many[0])
    return figure


def _loop(axes: Axes, loop: Loop, record: RecordSeen) -> None:
    from matplotlib.patches import Circle, Wedge

    axes.add_patch(Circle((0, 0), 1.0, facecolor="none", edgecolor=FAINT, linewidth=1.1))
    for end, name in zip(np.eye(2), loop.plane, strict=True):
        axes.plot(*(1.1 * np.outer([-1, 1], end)).T, color=FAINT, linewidth=0.8, zorder=1)
        x, y = 1.24 * end
        axes.text(x, y, name, color=INK, fontsize=9, fontstyle="italic", ha="center", va="center")
    # Half a turn further the correlation has the other sign, and the point is the same: closed.
    angle = np.radians(np.asarray([*loop.angle_deg, *loop.angle_deg[:1]]))
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    measured, expected = (
        np.asarray([*values, *values[:1]])[:, None] * way
        for values in (loop.correlation, loop.expected)
    )
    axes.fill(*measured.T, color=MEASURED, alpha=0.22, linewidth=0, zorder=2)
    axes.plot(*measured.T, color=MEASURED, linewidth=1.9, zorder=3, label="measured")
    healthy: dict[str, Any] = {"color": MUTED, "linewidth": 1.3, "linestyle": DASHED}
    axes.plot(*expected.T, zorder=3, label="healthy arm", **healthy)
    if np.abs(loop.correlation).max(initial=0.0) > 0.05:
        waist = 1.12 * np.outer([-1, 1], way[int(np.argmin(np.abs(loop.correlation)))])
        axes.plot(*waist.T, color=MEASURED, linewidth=2.1, zorder=3, label="lowest correlation")
    half = record.half_angle_deg
    if record.direction_tool is None or (half or 0.0) > _NARROW:
        return
    seen = np.array([record.direction_tool["xyz".index(axis)] for axis in loop.plane])
    length = float(np.linalg.norm(seen))
    axes.plot([], [], color=TRUTH, marker="$↔$", linestyle="", label="motion lost along")
    if length < 0.12:
        axes.plot(0, 0, "o", color=TRUTH, markersize=5, zorder=5)
        return
    heading = float(np.degrees(np.arctan2(seen[1], seen[0])))
    if half is not None and length > 0.7:
        for turned in (heading, heading + 180.0):
            wedge = Wedge((0, 0), 1.0, turned - half, turned + half, alpha=0.16, zorder=2.5)
            axes.add_patch(wedge)
            wedge.set(facecolor=TRUTH, linewidth=0)
    arrow(axes, -seen, seen, color=TRUTH, width=1.7, both=True)


def transmission_cards(diagnosis: Diagnosis, arm: Arm) -> list[FigureCard]:
    """Cards of the runs in which the hypotheses differ most, one for each excited joint."""
    by_run: dict[int, list[TransmissionSpectrum]] = {}
    for spectrum in diagnosis.spectra:
        records = diagnosis.records[spectrum.record : spectrum.record + 1]
        if any(record.condition != HEALTHY for record in records):
            by_run.setdefault(spectrum.record, []).append(spectrum)
    chosen: dict[str, int] = {}
    for record in sorted(by_run, key=lambda record: -_difference(by_run[record])):
        chosen.setdefault(by_run[record][0].joint, record)
    cards = []
    for joint, record in list(chosen.items())[:_CARDS]:
        own = by_run[record]
        names = {n: short_name(arm, n) for n in own[0].predicted}
        cards.append(
            FigureCard(
                title=f"Record {record + 1}: {joint_words(arm, joint)} excited",
                image=transmission_figure(own, names),
                caption=f"Transmission from {joint_words(arm, joint)} to each axis of the "
                f"accelerometer, {own[0].unit}. The better hypothesis is the one whose curve lies "
                "on the measured one. The motion of a loose seat and unknown forces of the joints "
                "(friction, brakes, servos) are estimated from the same readings.",
            )
        )
    return cards


def transmission_figure(
    spectra: Sequence[TransmissionSpectrum], names: Mapping[str, str]
) -> Figure:
    """Draw the transmission of one run, a panel for each axis of the accelerometer."""
    figure, many = panels(len(spectra), 1.65, rows=2, grid="both")
    faults = [name for name in names if name != HEALTHY]
    looks: dict[str, tuple[str, Any]] = {HEALTHY: (MUTED, DASHED)}
    looks |= zip(faults, ((_LOOSE[0], "-"), (_LOOSE[3], (0, (1.5, 1.5)))), strict=False)
    for axes, spectrum in zip(many, spectra, strict=True):
        x = np.array(spectrum.frequency_hz)
        floor = 1e-3 * max([max(spectrum.measured, default=0.0), 1e-12])
        y = np.maximum(spectrum.measured, floor)
        axes.plot(x, y, "o", color=MEASURED, markersize=3.4, zorder=5, label="measured")
        for name, (colour, line) in looks.items():
            if name in spectrum.predicted and name in names:
                y = np.maximum(spectrum.predicted[name], floor)
                look: dict[str, Any] = {"color": colour, "linestyle": line, "linewidth": 1.6}
                axes.plot(x, y, label=names[name], **look)
        axes.set_yscale("log")
        plain_log_ticks(axes, "y")
        labels(axes, above=spectrum.channel)
    for axes in many[:-1]:
        axes.tick_params(labelbottom=False)
    labels(many[-1], x="frequency [Hz]")
    legend(figure, many[0])
    return figure


def _difference(spectra: Sequence[TransmissionSpectrum]) -> float:
    """Largest rms log ratio of measured and predicted, or of two predictions, over the axes."""
    found = 0.0
    for spectrum in spectra:
        rows = [np.array(spectrum.measured), *map(np.array, spectrum.predicted.values())]
        logs = np.log(np.maximum(rows, 1e-12))
        found = max(found, float(np.sqrt(np.mean((logs - logs[0]) ** 2))))
    return found
