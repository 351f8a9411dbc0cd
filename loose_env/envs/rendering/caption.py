"""The words above the drawing and the legend below it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal

from loose_env.arms import LinearArm
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.correlation import Loop, Pair, Surface
from loose_env.envs.rendering.fault_text import (
    fault_words,
    hypothesis_words,
    loose_links_of,
    pose_words,
    shaking_words,
)
from loose_env.envs.rendering.palette import EDGE, INK, MEASURED, MUTED, SHAKEN, TRUTH
from loose_env.faults import UNSURE, Backlash, Fault, parts_of
from loose_env.rig import Measurement

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Line", "header_height", "header_lines", "write_header", "write_legend"]

_LETTERS = 56  # that fit beside each other
_LARGE = 0.64  # as many large letters fit in the place of a small one
_TOP = 0.16  # above the first line [inches]
_STEP = {"title": 0.28, "truth": 0.28, "plain": 0.195, "muted": 0.195}  # heights [inches]


@dataclass(frozen=True)
class Line:
    """A line above the drawing."""

    text: str
    rank: Literal["title", "truth", "plain", "muted"]


def header_lines(
    linear: LinearArm,
    episode: Episode,
    measurement: Measurement | None,
    loops: Pair[Loop] | Pair[Surface] | None,
    verdict: str | None,
) -> Iterator[Line]:
    """Say what the picture shows; the truth first, once it is out."""
    if measurement is not None:
        shaking = shaking_words(linear.at(measurement.pose), measurement.excitation)
    elif episode.records == 0:
        shaking = "The arm takes its first pose."
    elif episode.last is not None and episode.last.failure is not None:
        shaking = "The measurement failed: this record says nothing."
    else:
        shaking = "Nothing was shaken, so there is nothing to see on the tool."
    if episode.ended:
        truth = fault_words(episode.fault, linear.arm)
        yield Line(truth[0].upper() + truth[1:], "truth")
        if verdict is not None:
            mark = " – right" if verdict == episode.fault.hypothesis else " – wrong"
            if verdict == UNSURE:  # neither
                mark = ""
            yield Line(f"Verdict: {hypothesis_words(verdict)}{mark}", "plain")
        yield Line(shaking, "muted")
    else:
        yield Line(f"Record {episode.records}" if episode.records else "Not measured yet", "title")
        yield Line(shaking, "plain")
    spent = f"Record {episode.records}, pose" if episode.ended else "Pose"
    yield Line(f"{spent} {pose_words(episode.pose, linear.arm.sliding)}", "muted")
    if loops is not None:
        measured, healthy = loops.measured.maximum, loops.healthy.maximum
        yield Line(
            rf"$r_\mathrm{{max}}$ {measured:.3f} measured, {healthy:.3f} on a healthy arm", "muted"
        )


def header_height(lines: Sequence[Line], *, letters: int = _LETTERS) -> float:
    """Room that lines above the drawing take [inches]."""
    return _TOP + sum(_STEP[line.rank] for line in _broken(lines, letters))


def write_header(figure: Figure, lines: Sequence[Line], *, letters: int = _LETTERS) -> None:
    """Write the lines at the top of a figure, ``letters`` beside each other."""
    height = float(figure.get_size_inches()[1])
    large: dict[str, Any] = {"fontsize": 14.0, "fontweight": "bold"}
    small: dict[str, Any] = {"fontsize": 9.5}
    looks = {
        "title": large | {"color": INK},
        "truth": large | {"color": TRUTH},
        "plain": small | {"color": INK},
        "muted": small | {"color": MUTED},
    }
    y = 1.0 - _TOP / height
    for line in _broken(lines, letters):
        figure.text(0.04, y, line.text, ha="left", va="top", **looks[line.rank])
        y -= _STEP[line.rank] / height


def _broken(lines: Sequence[Line], letters: int) -> Iterator[Line]:
    """Break lines that are too long for the figure."""
    for line in lines:
        room = round(_LARGE * letters) if line.rank in ("title", "truth") else letters
        # A number stays with its unit.
        for text in wrap(line.text.replace(" mm", "\N{NO-BREAK SPACE}mm"), room):
            yield Line(text.replace("\N{NO-BREAK SPACE}", " "), line.rank)


def write_legend(
    figure: Figure,
    truth: Fault | None,
    *,
    some_held: bool,
    curve: str = "correlation r(φ)",
    slides: bool = False,
) -> None:
    """Write the legend at the bottom of a figure.

    Parameters
    ----------
    figure : Figure
        The figure.
    truth : Fault, optional
        What was loose, once it may be shown.
    some_held : bool
        Whether some joint was held.
    curve : str
        Name of the curve of the correlation.
    slides : bool
        Whether arrows show which way a link slides.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    loop = Patch(facecolor=(MEASURED, 0.22), edgecolor=MEASURED, linewidth=1.6)
    loop.set_label(curve)
    lowest = Line2D([], [], color=MEASURED, linewidth=2.6, label="lowest correlation")
    healthy = Line2D([], [], color=MUTED, linewidth=1.3, label="healthy arm")
    healthy.set_linestyle((0, (4, 2.5)))
    entries: list[Any] = [loop, lowest, healthy, _mark("o", SHAKEN, "shaken joint")]
    if some_held:
        entries.append(_mark("s", EDGE, "held joint"))
    if loose_links_of(truth):
        entries.append(Patch(facecolor=TRUTH, edgecolor=EDGE, label="loose link"))
    if truth is not None and any(isinstance(part, Backlash) for part in parts_of(truth)):
        ring = _mark("o", "none", "joint with play")
        ring.set(markeredgecolor=TRUTH, markeredgewidth=2.2)
        entries.append(ring)
    if slides:
        entries.append(_mark(r"$\leftrightarrow$", INK, "the way it slides"))
    _place(figure, entries)


def _place(figure: Figure, entries: Sequence[Any]) -> None:
    figure.legend(
        handles=entries,
        loc="lower left",
        bbox_to_anchor=(0.04, 0.018),
        borderpad=0.0,
        borderaxespad=0.0,
        ncols=3 if len(entries) > 4 else 2,
        frameon=False,
        fontsize=8.5,
        labelcolor=INK,
        columnspacing=1.3,
        handlelength=1.7,
        handletextpad=0.6,
    )


def _mark(marker: str, colour: str, label: str) -> Any:
    from matplotlib.lines import Line2D

    mark = Line2D([], [], linestyle="", marker=marker, markersize=8, label=label)
    mark.set(markerfacecolor=colour, markeredgecolor=EDGE, markeredgewidth=1.0)
    return mark
