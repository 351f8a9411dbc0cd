"""Figures of a comparison: accuracy against cost and by stratum, reliability diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import INK, MUTED
from loose_env.evaluation import (
    Division,
    Row,
    Standing,
    by_agent,
    claims_of,
    pareto_front,
    reliability,
)
from loose_env.report.pages.figures import WIDTH, new_figure, quiet_axes
from loose_env.report.pages.palette import agent_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = "osD^vP*Xhd"
_LINE = 0.19  # of the legend [inch]
_HEIGHT = 2.4  # of the axes [inch]
_MOST = 250  # points of a reliability curve that count as enough for a full marker


def success_and_records(
    found: Sequence[Standing],
    *,
    curves: Mapping[str, Sequence[float]] | None = None,
    colours: Mapping[str, str] | None = None,
) -> Figure:
    """Draw accuracy against mean records: a point an agent, and the Pareto front.

    Parameters
    ----------
    found : sequence of Standing
        The agents.
    curves : mapping, optional
        Success after record 1, 2, ... of agents that may not stop, from
        `loose_env.evaluation.success_after`.
    colours : mapping, optional
        Colour of each agent.
    """
    names = [s.agent for s in found]
    paint = agent_colours(names) if colours is None else colours
    figure, axes = _axes(1 + len(names))
    for agent, curve in (curves or {}).items():
        counts = np.arange(1, len(curve) + 1)
        axes.plot(counts, curve, color=paint[agent], linewidth=1.3, alpha=0.75, zorder=2)
    records = np.array([s.records for s in found])
    success = np.array([s.success for s in found])
    front = np.flatnonzero(pareto_front(records, success))
    front = front[np.argsort(records[front])]
    axes.step(
        records[front],
        success[front],
        where="post",
        color=MUTED,
        linewidth=1.0,
        linestyle=(0, (3, 2)),
        zorder=1,
        label="Pareto front",
    )
    for k, s in enumerate(found):
        axes.plot([s.records] * 2, [s.low, s.high], color=paint[s.agent], linewidth=1.4, zorder=3)
        axes.plot(
            s.records,
            s.success,
            color=paint[s.agent],
            marker=_MARKERS[k % len(_MARKERS)],
            markersize=7.0,
            markeredgecolor=INK,
            markeredgewidth=0.7,
            linestyle="",
            label=s.agent,
            zorder=4,
        )
    most = max([*records, *(len(curve) for curve in (curves or {}).values())])
    low = min([*(s.low for s in found), *(min(c) for c in (curves or {}).values())])
    axes.set(xlim=(0, 1.04 * most), ylim=(max(0.0, np.floor(10 * low - 0.5) / 10), 1.0))
    axes.set_xlabel("mean records", color=MUTED, fontsize=9)
    _finish(figure, axes, "accuracy")
    return figure


def success_by_group(division: Division, *, colours: Mapping[str, str] | None = None) -> Figure:
    """Draw the accuracy of every agent in every stratum, with 95 % intervals."""
    names = list(division.cells)
    paint = agent_colours(names) if colours is None else colours
    figure, axes = _axes(len(names), lines=2)
    place = np.arange(len(division.groups), dtype=float)
    for k, (agent, cells) in enumerate(division.cells.items()):
        at = place + 0.045 * (k - 0.5 * (len(names) - 1))
        success = np.array([cell.success for cell in cells])
        ends = np.array([[cell.low, cell.high] for cell in cells])
        full = np.isfinite(success)
        for x, (low, high) in zip(at[full], ends[full], strict=True):
            axes.plot([x, x], [low, high], color=paint[agent], linewidth=1.2, alpha=0.7)
        axes.plot(
            at[full],
            success[full],
            color=paint[agent],
            marker=_MARKERS[k % len(_MARKERS)],
            markersize=5.0,
            linewidth=1.4,
            linestyle="-" if division.ordered else "",
            clip_on=False,
            zorder=3,
            label=agent,
        )
    counts = [cell.episodes for cell in next(iter(division.cells.values()))]
    ticks = [f"{name}\n{n} arms" for name, n in zip(division.groups, counts, strict=True)]
    axes.set_xticks(place, ticks)
    axes.set(xlim=(-0.4, len(place) - 0.6), ylim=(0.0, 1.0))
    axes.set_xlabel(division.heading, color=MUTED, fontsize=9)
    _finish(figure, axes, "accuracy")
    return figure


def reliability_curves(
    rows: Sequence[Row], *, colours: Mapping[str, str] | None = None, bins: int = 10
) -> Figure | None:
    """Draw a reliability diagram; None where no agent has probabilities.

    On the diagonal probabilities are calibrated; below it the agent is overconfident. The smaller
    a marker, the fewer the predictions behind it.
    """
    own = by_agent(rows)
    paint = agent_colours(list(own)) if colours is None else colours
    beliefs = {agent: claims_of(some) for agent, some in own.items()}
    beliefs = {agent: claims for agent, claims in beliefs.items() if len(claims.record)}
    if not beliefs:
        return None
    figure, axes = _axes(len(beliefs))
    axes.plot([0, 1], [0, 1], color=MUTED, linewidth=1.0, linestyle=(0, (3, 2)), zorder=1)
    for k, (agent, claims) in enumerate(beliefs.items()):
        found = reliability(claims.confidence, claims.right, bins=bins)
        area = 8.0 + 34.0 * np.minimum(found.count / _MOST, 1.0)
        mark = _MARKERS[k % len(_MARKERS)]
        axes.plot(found.confidence, found.right, color=paint[agent], linewidth=1.3, zorder=2)
        axes.scatter(
            found.confidence,
            found.right,
            s=area,
            color=paint[agent],
            marker=mark,
            label=agent,
            zorder=3,
            clip_on=False,
        )
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0 %", "25 %", "50 %", "75 %", "100 %"])
    axes.set_xlabel("probability of the best hypothesis", color=MUTED, fontsize=9)
    _finish(figure, axes, "accuracy")
    return figure


def _axes(entries: int, *, lines: int = 1) -> tuple[Figure, Axes]:
    """A figure with room below the axes for ticks of so many lines and a legend."""
    below = 0.53 + 0.15 * lines + _LINE * ((entries + 1) // 2)
    left, top = 0.62, 0.3
    whole = _HEIGHT + below + top
    figure = new_figure(whole)
    box = (left / WIDTH, below / whole, 1 - (left + 0.12) / WIDTH, _HEIGHT / whole)
    return figure, figure.add_axes(box)


def _finish(figure: Figure, axes: Axes, what: str) -> None:
    """Style the axes, label their height, and put the legend below."""
    low, high = axes.get_ylim()
    step = 0.25 if high - low > 0.6 else 0.1
    ticks = np.arange(np.ceil(low / step) * step, high + 1e-9, step)
    axes.set_yticks(ticks, [f"{100 * t:.0f} %" for t in ticks])
    axes.set_ylim(low, high)
    quiet_axes(axes)
    above: dict[str, Any] = {"color": MUTED, "fontsize": 9, "ha": "left", "va": "bottom"}
    axes.text(0.0, 1.025, what, transform=axes.transAxes, **above)
    marks, labels = axes.get_legend_handles_labels()
    figure.legend(
        marks,
        labels,
        loc="lower left",
        bbox_to_anchor=(0.02, 0.0),
        ncols=2,
        frameon=False,
        fontsize=8.5,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.6,
    )
