"""The confusion matrix of one agent: verdicts against true faults."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loose_env.envs import FAINT, INK, MUTED
from loose_env.errors import InvalidData
from loose_env.evaluation import Row
from loose_env.faults import SEVERAL_FAULTS, UNSURE, place_of
from loose_env.report.pages.figures import WIDTH, new_figure
from loose_env.report.pages.palette import AGENTS, is_light

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def ordered_hypotheses(rows: Sequence[Row]) -> tuple[str, ...]:
    """All hypotheses that rows mention: healthy, then links, then joints, each by number.

    Truths that no verdict can name come last. "unsure" is no hypothesis.

    Examples
    --------
    >>> rows = [dict(truth="backlash@joint1", verdict="structural_looseness@link2")]
    >>> ordered_hypotheses(rows)
    ('healthy', 'structural_looseness@link2', 'backlash@joint1')
    """
    named = {str(row[k]) for row in rows for k in ("truth", "verdict") if row[k] is not None}
    named.discard(UNSURE)

    def rank(hypothesis: str) -> tuple[int, int]:
        return _kind(hypothesis), place_of(hypothesis) or 0

    return tuple(sorted(named | {"healthy"}, key=rank))


def confusion_counts(rows: Sequence[Row], hypotheses: Sequence[str]) -> NDArray[np.intp]:
    """Confusion counts by truth and verdict; last columns unsure and none (h, h + 2).

    Raises
    ------
    InvalidData
        If a row's truth or verdict is none of the hypotheses.
    """
    index = {name: k for k, name in enumerate(hypotheses)}
    columns: dict[Any, int] = {**index, UNSURE: len(index), None: len(index) + 1}
    counts = np.zeros((len(index), len(columns)), dtype=np.intp)
    for row in rows:
        if row["truth"] not in index or row["verdict"] not in columns:
            raise InvalidData(
                f"an episode has the truth {row['truth']!r} and the verdict {row['verdict']!r}, of "
                f"which one is none of the hypotheses {list(hypotheses)}; ordered_hypotheses(rows) "
                "finds all that rows mention"
            )
        counts[index[row["truth"]], columns[row["verdict"]]] += 1
    return counts


def confusion_matrix(
    rows: Sequence[Row], *, hypotheses: Sequence[str] | None = None, colour: str = AGENTS[0]
) -> Figure:
    """Draw the confusion matrix of one agent's rows.

    The number in a cell counts arms; the darker the cell, the larger their share of the arms
    with that truth. Correct verdicts lie in the framed cells.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of one agent.
    hypotheses : sequence of str, optional
        All hypotheses in order; by default those that the rows mention.
    colour : str
        Colour of the agent.
    """
    names = ordered_hypotheses(rows) if hypotheses is None else tuple(hypotheses)
    counts = confusion_counts(rows, names)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    down, across = counts.shape
    left, top, edge = 1.0, 0.95, 0.08
    cell = (WIDTH - left - edge) / across
    height = top + cell * down + edge
    figure = new_figure(height)
    axes = figure.add_axes(
        (left / WIDTH, edge / height, cell * across / WIDTH, cell * down / height)
    )
    size = float(np.clip(31 * cell, 7.0, 10.0))
    for i in range(down):
        for j in range(across):
            _cell(axes, i, j, int(counts[i, j]), float(share[i, j]), colour, size, right=i == j)
    axes.set(xlim=(0, across), ylim=(down, 0))
    axes.set_axis_off()
    _labels(axes, names, 1.0 / cell, size)
    return figure


def _cell(
    axes: Axes, i: int, j: int, count: int, share: float, colour: str, size: float, *, right: bool
) -> None:
    from matplotlib.patches import Rectangle

    pad = 0.04
    box = Rectangle((j + pad, i + pad), 1 - 2 * pad, 1 - 2 * pad, facecolor=FAINT, alpha=0.28)
    box.set_linewidth(0)
    axes.add_patch(box)
    if count:
        depth = 0.15 + 0.85 * share
        filled = Rectangle(box.get_xy(), 1 - 2 * pad, 1 - 2 * pad, facecolor=colour, linewidth=0)
        filled.set_alpha(depth)
        axes.add_patch(filled)
        strong = "#16191d" if is_light(colour) else "#fefefe"
        axes.text(
            j + 0.5,
            i + 0.5,
            str(count),
            color=strong if depth > 0.6 else INK,
            fontsize=size,
            ha="center",
            va="center_baseline",
        )
    if right:
        frame = Rectangle(box.get_xy(), 1 - 2 * pad, 1 - 2 * pad, facecolor="none", edgecolor=MUTED)
        frame.set_linewidth(1.0)
        axes.add_patch(frame)


def _labels(axes: Axes, names: Sequence[str], inch: float, size: float) -> None:
    """Label cells with location numbers and kinds; ``inch`` in cells."""
    muted: dict[str, Any] = {"color": MUTED, "fontsize": 9.0}
    plain: dict[str, Any] = {"color": INK, "fontsize": size}
    near, far = 0.07 * inch, 0.28 * inch
    start = 0
    for kind, group in groupby(names, key=_kind):
        count = len(list(group))
        words = ("healthy", "link loose", "joint play", "several")[kind]
        middle = start + count / 2
        if kind in (0, 3):
            axes.text(-near, middle, words, ha="right", va="center", **plain)
            axes.text(middle, -near, words, ha="center", va="bottom", rotation=90, **plain)
        else:
            for k in range(start, start + count):
                number = str(place_of(names[k]))
                axes.text(-near, k + 0.5, number, ha="right", va="center", **plain)
                axes.text(k + 0.5, -near, number, ha="center", va="bottom", **plain)
            beside, along = (-far, -far), (start + 0.1, start + count - 0.1)
            axes.plot(beside, along, color=FAINT, linewidth=1.2, clip_on=False)
            axes.plot(along, beside, color=FAINT, linewidth=1.2, clip_on=False)
            axes.text(
                -far - near,
                middle,
                words,
                ha="center",
                va="bottom",
                rotation=90,
                rotation_mode="anchor",
                **muted,
            )
            axes.text(middle, -far - near, words, ha="center", va="bottom", **muted)
        start += count
    for k, words in enumerate((UNSURE, "none")):
        middle = start + k + 0.5
        axes.text(middle, -near, words, ha="center", va="bottom", rotation=90, **plain)
    corner = muted | {"fontstyle": "italic"}
    axes.text(start / 2 + 1, -0.72 * inch, "verdict", ha="center", va="bottom", **corner)
    axes.text(
        -0.72 * inch,
        start / 2,
        "truth",
        ha="center",
        va="bottom",
        rotation=90,
        rotation_mode="anchor",
        **corner,
    )


def _kind(hypothesis: str) -> int:
    if hypothesis == "healthy":
        return 0
    if hypothesis == SEVERAL_FAULTS:
        return 3
    return 2 if hypothesis.startswith("backlash") else 1
