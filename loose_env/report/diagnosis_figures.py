"""Figures of a diagnosis: arm in a pose, posterior by record, loops and transmissions by run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import Arm
from loose_env.envs import EDGE, FAINT, INK, MEASURED, MUTED, SHAKEN, TRUTH, ArmDrawing, draw_arrow
from loose_env.errors import InvalidData
from loose_env.faults import Backlash, StructuralLooseness
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOSE = ("#d55e00", "#0173b2", "#e69f00", "#cc79a7", "#56b4e9")
_HEALTHY, _REST = "#009e73", AGENTS[-1]
"""Colours of the hypotheses, told apart by colour-blind eyes; none is one of the ink's."""
_SHOWN = 0.03  # probability that a hypothesis must have had once to get a colour of its own
_NARROW = 50.0  # half angle up to which a direction is drawn [degrees]
_CARDS = 2  # runs whose transmission is drawn


def arm_figure(
    arm: Arm,
    pose: Mapping[str, float],
    *,
    fault: Fault | None = None,
    excited: Collection[str] | None = None,
) -> Figure:
    """Draw an arm in a pose: links, numbered joints, tool frame, and what is suspected."""
    unknown = sorted(set(pose) - set(arm.joints))
    if unknown:
        raise InvalidData(
            f"the diagnosis has a pose of the joints {unknown}, which are none of arm "
            f"{arm.name!r}; it has {', '.join(arm.joints)}: give the model that was diagnosed"
        )
    link, joint = _place(arm, fault)
    seat: StructuralLooseness | Backlash | None = None
    if joint is not None:
        seat = Backlash(joint=joint + 1, gap=0.0, stiffness=(1.0, 1.0))
    elif link is not None and fault is not None and fault.direction is not None:
        seat = StructuralLooseness(
            link=link + 1, direction=fault.direction, gap=0.0, stiffness=(1.0, 1.0)
        )
    shaken = None if excited is None else np.array([name in excited for name in arm.joints])
    at = np.array([float(pose.get(name, 0.0)) for name in arm.joints])
    figure, drawing = new_figure(4.6), ArmDrawing(arm)
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.92))
    loose = [] if link is None else [link + 1]
    drawing.draw(axes, drawing.marks(at, excited=shaken, loose=loose, fault=seat))
    _size_bar(axes)
    figure.text(0.97, 0.03, drawing.seen, color=MUTED, fontsize=9, ha="right")
    for label, mark, colour, drawn in (
        ("suspected link", "s", TRUTH, link is not None),
        ("the way it slides", "$↔$", INK, isinstance(seat, StructuralLooseness)),
        ("suspected joint", "o", TRUTH, joint is not None),
        ("shaken", "o", SHAKEN, shaken is not None and shaken.any()),
        ("braked or servoed", "o", EDGE, shaken is not None and not shaken.all()),
    ):
        if drawn:
            axes.plot([], [], color=colour, marker=mark, linestyle="", label=label)
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


def _size_bar(axes: Axes) -> None:
    """A measure of length."""
    from mpl_toolkits.axes_grid1.anchored_artists import (  # type: ignore[import-untyped]
        AnchoredSizeBar,
    )

    most = 0.3 * float(np.ptp(axes.get_xlim()))
    decade = 10.0 ** float(np.floor(np.log10(most)))
    length = max(k * decade for k in (1, 2, 5) if k * decade <= most)
    look: dict[str, Any] = {"frameon": False, "color": MUTED, "pad": 0.1}
    axes.add_artist(AnchoredSizeBar(axes.transData, length, f"{length:g} m", "lower left", **look))


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
    draw_arrow(axes, -seen, seen, color=TRUTH, both=True)


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
