"""Figure of loose_env/Gap-v0: accuracy by machine time, calibration, and one episode."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scripts.model_gap.tables import curves

__all__ = ["draw", "write_curves"]

_COLOURS = {
    "greedy": "#0b6e99",
    "battery": "#c4622d",
    "random": "#7a7a7a",
    "brief": "#8e5ba6",
    "ppo": "#5b8c3a",
}


def write_curves(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the curves of accuracy by machine time as CSV."""
    found = curves(rows)
    with path.open("w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, fieldnames=list(found[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(found)


def draw(rows: Sequence[dict[str, Any]], path: Path, *, motions: Sequence[str] = ()) -> None:
    """Draw the curves, the calibration, and the belief of one episode of each agent."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(14, 3.4), layout="constrained")
    found = curves(rows)
    for axis, effects, title in ((axes[0], 1, "one effect"), (axes[1], 2, "two effects")):
        for agent, colour in _COLOURS.items():
            own = [c for c in found if c["agent"] == agent and c["effects"] == effects]
            if own:
                times = [c["seconds"] for c in own]
                shares = [100 * c["accuracy"] for c in own]
                axis.step(times, shares, color=colour, label=agent, where="post")
        axis.set(title=title, xlabel="machine time [s]", ylabel="named rightly [%]", ylim=(0, 100))
        axis.grid(alpha=0.3)
        axis.legend(loc="lower right", frameon=False)
    p = np.array([v for row in rows for v in row["probability"]])
    right = np.array([v for row in rows for v in row["right"]])
    edges = np.linspace(0, 1, 11)
    axes[2].plot([0, 1], [0, 1], color="#999999", linewidth=1)
    bins = np.clip(np.digitize(p, edges) - 1, 0, 9)
    points = [(p[bins == k].mean(), right[bins == k].mean(), (bins == k).sum()) for k in set(bins)]
    for x, y, count in points:
        axes[2].plot(x, y, "o", color="#0b6e99", markersize=3 + 2 * np.log10(count))
    axes[2].set(title="calibration", xlabel="probability of the set", ylabel="share right")
    axes[2].grid(alpha=0.3)
    episode = _shown(rows)
    for row in (r for r in rows if r["episode"] == episode and r["seconds"]):
        colour = _COLOURS.get(row["agent"], "black")
        axes[3].plot(
            row["seconds"], row["probability"], "-", color=colour, label=row["agent"], linewidth=1
        )
        for t, q, good in zip(row["seconds"], row["probability"], row["right"], strict=True):
            axes[3].plot(t, q, "o" if good else "x", color=colour, markersize=5)
        truth = row["truth"]
    axes[3].set(
        title=f"one episode: {truth}", xlabel="machine time [s]", ylabel="probability (x: wrong)"
    )
    axes[3].title.set_fontsize(8)
    axes[3].grid(alpha=0.3)
    figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _shown(rows: Sequence[dict[str, Any]]) -> int:
    """Episode that is drawn: the first with effects that greedy needed four motions for, if any."""
    hidden = [r for r in rows if r["effects"] and r["seconds"]]
    long = [r for r in hidden if r["agent"] == "greedy" and len(r["seconds"]) >= 4]
    return min(int(row["episode"]) for row in long or hidden)
