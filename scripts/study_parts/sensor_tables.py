"""Table and figure of the study of sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from loose_agents.execution.study import Row, StudyRun

from loose_env.report import FAINT, INK, MUTED, pyplot, save_figure

__all__ = ["REFERENCES", "draw", "show"]

REFERENCES = ("healthy", "nominal", "nominal, rigid")
"""References of the records: those of the same arm when it was healthy, or the nominal arm; and the
nominal arm again where healthy arms have rigid seats."""


def show(rows: list[Row], settings: Any, path: Path, run: StudyRun) -> None:
    """Print the table."""
    gaps = (1e3 * settings.gaps[0], 1e3 * settings.gaps[-1])
    print_table(rows, gaps)


def print_table(rows: Sequence[Row], ends: tuple[float, float]) -> None:
    """Print a line for each arm and set: healthy reference / nominal / with rigid seats.

    Of the detected faults: accuracy of the link and its posterior probability, and the share of
    true directions within two standard deviations. ``ends``: lowest and highest gap [mm].
    """

    def gap_text(gap: float | None) -> str:
        if gap is None:
            return f"> {ends[1]:.2g}"
        return f"< {gap:.2g}" if gap <= 1.001 * ends[0] else f"{gap:.2g}"

    print(
        f"{'arm':9} {'sensors':34} {'axes':>4}  {'direction [deg]':>15}  {'accuracy [%]':>14}  "
        f"{'detected [%]':>16}  {'post. [%]':>9}  {'in 2 sd [%]':>11}  "
        f"{'50 % detected from [mm]':>27}  {'90 % detected from [mm]':>27}"
    )
    for group in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
        head = group[0]
        error, right, found, said, inside, half, most = (
            " / ".join(form(row[key]) for row in group[:count])
            for key, form, count in (
                ("direction_error", "{:.1f}".format, 2),
                ("link_right", percent, 2),
                ("link_right_found", percent, 2),
                ("link_said_found", percent, 2),
                ("within_two_sd", percent, 2),
                ("gap_half_mm", gap_text, 3),
                ("gap_most_mm", gap_text, 3),
            )
        )
        print(
            f"{head['arm']:9} {head['sensors']:34} {head['channels']:4d}  "
            f"{error:>15}  {right:>14}  {found:>16}  {said:>9}  {inside:>11}  "
            f"{half:>27}  {most:>27}"
        )


def percent(share: float | None) -> str:
    """Spell out a share [%]; a dash where there was nothing to count."""
    return "-" if share is None else f"{100 * share:.0f}"


FAMILIES = {
    "growing": ("tool, then links one by one", "#0072b2", "o", "-"),
    "tangential": ("tool and all links, tangential only", "#d0451b", "s", "none"),
    "links only": ("all links tangential, no tool", "#5b8c5a", "D", "none"),
}
"""Words, colour, marker and line of each family of sensor sets."""


def draw(rows: list[Row], settings: Any, path: Path) -> None:
    """Draw accuracy of the link, direction error and smallest gap against the number of axes."""
    ends = (1e3 * settings.gaps[0], 1e3 * settings.gaps[-1])
    plt = pyplot()
    arms = list(dict.fromkeys(row["arm"] for row in rows))
    errors = [row["direction_error"] for row in rows]
    lines: tuple[tuple[str, Callable[[Row], float], tuple[float, float]], ...] = (
        ("accuracy of the link [%]", lambda r: 100 * r["link_right"], (0, 104)),
        (
            "direction error [deg]",
            lambda r: r["direction_error"],
            (0.8 * min(errors), 1.25 * max(errors)),
        ),
        (
            "50 % detected from gap [mm]",
            lambda r: 1.5 * ends[1] if r["gap_half_mm"] is None else r["gap_half_mm"],
            (0.7 * ends[0], 2 * ends[1]),
        ),
    )
    wide = len(arms) >= 3
    height, head = (7.0, 0.75) if wide else (7.6, 1.3)
    figure, axes = plt.subplots(
        3, len(arms), figsize=(1.1 + 2.0 * len(arms), height), sharey="row", squeeze=False
    )
    for panels, (label, value, limits) in zip(axes, lines, strict=True):
        for panel, arm in zip(panels, arms, strict=True):
            _draw_families(panel, [r for r in rows if r["arm"] == arm], value)
            panel.set_ylim(*limits)
            if panels is not axes[0]:
                panel.set_yscale("log")
                panel.yaxis.set_major_formatter("{x:g}")
            panel.tick_params(labelsize=8)
            panel.grid(color="#eef1f4", zorder=0)
        panels[0].set_ylabel(label, color=INK, fontsize=9)
    for top, bottom, arm in zip(axes[0], axes[-1], arms, strict=True):
        top.set_title(arm, fontsize=10, color=INK, loc="left")
        bottom.axhline(ends[1], color=FAINT, linewidth=0.9, zorder=0)
        bottom.set_xlabel("axes", color=MUTED)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, names, loc="upper left", ncols=2 if wide else 1, frameon=False, fontsize=8
    )
    figure.tight_layout(rect=(0, 0, 1, 1 - head / height))
    save_figure(plt, figure, path, dpi=150)


def _draw_families(panel: Any, rows: Sequence[Row], value: Callable[[Row], float]) -> None:
    for reference, fill in (("healthy", 1.0), ("nominal", 0.35)):
        for family, (name, colour, marker, style) in FAMILIES.items():
            own = [r for r in rows if (r["family"], r["reference"]) == (family, reference)]
            panel.plot(
                [r["channels"] for r in own],
                [value(r) for r in own],
                linestyle=style,
                color=colour,
                alpha=fill,
                marker=marker,
                markersize=5,
                markerfacecolor=colour if fill == 1 else "none",
                linewidth=1.4,
                label=f"{name}; {reference} reference",
            )
