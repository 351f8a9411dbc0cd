"""Figures of the section on modelling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, SHAKEN
from loose_env.report import new_figure
from loose_env.thesis.methods.looseness.inertia_condition import backlash_condition
from loose_env.thesis.methods.looseness.modelling_alternatives import Weighing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["condition_figure", "ratios_figure"]


def ratios_figure(weighed: Sequence[Weighing]) -> Figure:
    """Draw two bars an alternative: the gap over noise, and over noise and model error."""
    height = 0.52 * len(weighed) + 0.75
    figure = new_figure(height)
    axes = figure.add_axes((0.03, 0.5 / height, 0.94, 1 - 0.62 / height))
    values = [r for w in weighed for r in (w.against_noise, w.against_all)]
    low, high = 10 ** np.floor(np.log10(min(values))), 10 ** np.ceil(np.log10(max(values)))
    for k, w in enumerate(weighed):
        y = -float(k)
        for ratio, shift, colour, word in (
            (w.against_noise, 0.11, MEASURED, "noise"),
            (w.against_all, -0.11, SHAKEN, "noise and model"),
        ):
            left, width = min(ratio, 1.0), abs(ratio - 1.0)
            axes.barh(y + shift, width, left=left, height=0.17, color=colour, zorder=2)
            if k == 0:
                axes.text(
                    max(w.against_noise, 1.0) * 1.15,
                    y + shift,
                    f"over {word}",
                    color=INK,
                    fontsize=8,
                    va="center",
                )
        axes.text(low, y + 0.23, w.name, color=INK, fontsize=9.5, va="bottom")
        axes.text(
            high,
            y + 0.23,
            f"{w.against_noise:.2g} and {w.against_all:.2g}",
            color=INK,
            fontsize=9.5,
            ha="right",
            va="bottom",
        )
        axes.plot([1.0, 1.0], [y - 0.24, y + 0.22], color=INK, linewidth=1.2, zorder=3)
    axes.set_xscale("log")
    axes.set(xlim=(low, high), ylim=(0.6 - len(weighed), 0.62))
    axes.set_yticks([])
    ticks = 10.0 ** np.arange(np.log10(low), np.log10(high) + 0.5)
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    first, *_, last = axes.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    axes.minorticks_off()
    _plain(axes, "x")
    axes.set_xlabel("disagreement from the gap, over the rest", color=MUTED, fontsize=9)
    return figure


def condition_figure(points: Sequence[tuple[str, int, float]]) -> Figure:
    """Draw the closed form of `backlash_condition` and where the joints of the arms lie.

    Each point is an arm ("planar4" or "vera"), a joint, and its motor side over its link side.
    """
    figure = new_figure(2.9)
    axes = figure.add_axes((0.12, 0.17, 0.84, 0.72))
    ratio = np.logspace(-3, 2, 200)
    axes.plot(ratio, [backlash_condition(r) for r in ratio], color=MUTED, linewidth=1.8, zorder=2)
    for name, colour, marker, side in (("planar4", MEASURED, "o", 1), ("vera", SHAKEN, "s", -1)):
        own = [(j, r) for n, j, r in points if n == name]
        axes.plot(
            [r for _, r in own],
            [backlash_condition(r) for _, r in own],
            linestyle="none",
            marker=marker,
            markersize=6,
            color=colour,
            zorder=3,
        )
        middle = float(np.exp(np.mean([np.log(r) for _, r in own])))
        at = backlash_condition(middle)
        axes.annotate(
            f"joints of {'VERA' if name == 'vera' else 'the four-link arm'}",
            xy=(middle, at),
            xytext=(middle * (2.2 if side > 0 else 1 / 3), at * (6 if side > 0 else 1 / 3.2)),
            color=INK,
            fontsize=9,
            ha="left" if side > 0 else "right",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 1.0},
        )
    axes.set(xscale="log", yscale="log", xlim=(1e-3, 1e2), ylim=(1, 1e4))
    axes.grid(color=FAINT, linewidth=0.8)
    # Plain numbers: the exponents of a power of ten are too small to read.
    ratios, conditions = 10.0 ** np.arange(-3, 3), 10.0 ** np.arange(5)
    axes.set_xticks(ratios, [f"{r:g}" for r in ratios])
    axes.set_yticks(conditions, [f"{c:.0f}" for c in conditions])
    axes.minorticks_off()
    _plain(axes, "y")
    axes.set_xlabel("inertia of motor side over link side", color=MUTED, fontsize=9)
    axes.text(0.0, 1.04, "condition", color=MUTED, fontsize=9, transform=axes.transAxes)
    return figure


def _plain(axes: Axes, grid: str) -> None:
    axes.patch.set_alpha(0.0)
    axes.set_axisbelow(True)
    getattr(axes, f"{grid}axis").grid(color=FAINT, linewidth=0.8)
    axes.tick_params(which="both", length=0, pad=6, labelsize=9, labelcolor=MUTED)
    for spine in axes.spines.values():
        spine.set_visible(False)
