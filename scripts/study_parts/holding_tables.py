"""Figure and table of the study of holding modes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.report import INK, MUTED, pyplot, save_figure

__all__ = ["ESTIMATORS", "LINES", "STIFF", "draw_holding", "median_error", "print_holding"]

_TITLES = {
    "planar3": "planar, 3 links, horizontal",
    "planar3v": "planar, 3 links, vertical",
    "six_axis": "six axes",
}
ESTIMATORS = {
    "lowest": "lowest coherence",
    "reference_encoder": "against healthy records, encoder",
    "reference_command": "against healthy records, command",
    "reference_played": "same, each less the model's answer",
    "kinematic_encoder": "against kinematics, encoder",
    "kinematic_command": "against kinematics, command",
    "dynamic_encoder": "against dynamic model, encoder",
    "dynamic_command": "against dynamic model, command",
    "dynamic_played": "same, model fed with what was played",
    "lines_healthy": "whole dynamic model, line by line, against healthy records",
    "lines_nominal": "whole dynamic model, line by line, no healthy records",
}
_DRAWN = ("lowest", "reference_command", "kinematic_command", "dynamic_command", "lines_healthy")
LINES = {"lines_healthy": True, "lines_nominal": False}
STIFF = "brake"
_COLOURS = {
    "lowest": "#4a8f5c",
    "reference": "#0072b2",
    "kinematic": "#d0451b",
    "dynamic": "#8a5fbf",
    "lines": "#1b2128",
}


def median_error(row: dict[str, Any], estimator: str) -> float:
    """Median error of an estimator over all cases [deg]; nan where all are lost."""
    values = row["errors"][estimator]
    return float(np.median(values)) if values else float("nan")


def draw_holding(rows: Sequence[dict[str, Any]], arms: Sequence[str], path: Path) -> None:
    """Draw the median error against the holding mode, a panel for each arm and holding."""
    plt = pyplot()
    kinds = {"servo": "joints on position servos", "gears": "brakes behind elastic gears"}
    figure, axes = plt.subplots(
        2,
        len(arms),
        figsize=(1.0 + 3.5 * len(arms), 6.6),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for i, (hold, label) in enumerate(kinds.items()):
        for panel, name in zip(axes[i], arms, strict=True):
            stiff = [r for r in rows if r["arm"] == name and r["hold"] == STIFF]
            own = [r for r in rows if r["arm"] == name and r["hold"] == hold]
            own.sort(key=lambda r: -r["mode_hz"])
            panel.axvspan(30, 150, color="#eef1f4", lw=0, zorder=0)
            for e in _DRAWN:
                colour = _COLOURS[e.partition("_")[0]]
                x = [r["mode_hz"] for r in own]
                y = [median_error(r, e) for r in own]
                panel.plot(
                    x,
                    y,
                    color=colour,
                    lw=1.8,
                    marker="o",
                    ms=3.5,
                    label=ESTIMATORS[e],
                )
                for r in stiff:
                    height = median_error(r, e)
                    panel.plot(600, height, "_", color=colour, ms=9, mew=2)
            for r in own:
                panel.text(
                    r["mode_hz"],
                    0.985,
                    f"{np.median(r['change']):.1f}",
                    transform=panel.get_xaxis_transform(),
                    ha="center",
                    va="top",
                    fontsize=7,
                    color=MUTED,
                )
            panel.set_xscale("log")
            panel.set_xlim(750, 12)
            panel.set_ylim(-2, 80)
            panel.minorticks_off()
            panel.set_xticks(
                [600, 300, 150, 100, 70, 30, 15], ["brake", "300", "150", "100", "70", "30", "15"]
            )
            panel.set_title(f"{_TITLES[name]}:\n{label}", fontsize=9.5, color=INK, loc="left")
            if i == 1:
                panel.set_xlabel("holding mode of each joint [Hz]")
        axes[i, 0].set_ylabel("median error of the direction [deg]")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", ncols=3, frameon=False, fontsize=8)
    figure.text(
        0.008,
        0.012,
        "Along the top: median |ΔB|/|B| against healthy records. Shaded: band of the excitation. "
        "Left: stiff brakes.",
        fontsize=8,
        color=MUTED,
    )
    figure.tight_layout(rect=(0, 0.03, 1, 0.915))
    save_figure(plt, figure, path)


def print_holding(rows: Sequence[dict[str, Any]]) -> None:
    """Print median errors, by arm, holding and mode."""
    short = (
        "lowest",
        "ref.enc",
        "ref.cmd",
        "played",
        "kin.enc",
        "kin.cmd",
        "dyn.enc",
        "dyn.cmd",
        "played",
        "lines",
        "l.nomin",
    )
    print(f"{'arm':<9} {'held by':<7} {'mode':>7} {'|dB|/|B|':>8} {'level':>6}", end=" ")
    print(" ".join(f"{s:>8}" for s in short), end=" ")
    print(" ".join(f"{'known':>8} {'link':>5}" for _ in LINES))
    for r in rows:
        change = np.median(r["change"])
        errors = " ".join(f"{median_error(r, e):8.1f}" for e in ESTIMATORS)
        named = " ".join(
            f"{np.median(r['errors_link_known'][e]):8.1f} {100 * np.mean(r['link_right'][e]):4.0f}%"
            for e in LINES
        )
        mode = "-" if r["hold"] == STIFF else f"{r['mode_hz']:.0f} Hz"
        print(
            f"{r['arm']:<9} {r['hold']:<7} {mode:>7} {change:6.2f} "
            f"{100 * r['level_reached']:5.0f}% {errors} {named}"
        )
