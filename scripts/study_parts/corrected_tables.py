"""Tables and figure of the study of the corrected arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from loose_agents.execution.study import Row, StudyRun

from loose_env.evaluation import Interval, bootstrap_mean, wilson
from loose_env.faults import UNSURE
from loose_env.report import INK, MUTED, pyplot, save_figure
from scripts.study_parts.three_axis_arm import Settings

__all__ = ["MODELS", "draw", "mean_of", "row_of", "show"]

MODELS = {"nominal": "nominal model", "corrected": "corrected by loose gap", "true": "true model"}
COLOURS = {"nominal": "#d0451b", "corrected": "#0072b2", "true": "#4a8f5c"}


def show(rows: list[Row], settings: Settings, path: Path, run: StudyRun) -> None:
    """Print the tables."""
    print_tables(rows)


def row_of(rows: Sequence[Row], mode: float | None, model: str) -> Row | None:
    """Diagnoses of a mode with one model; None if they have not been made."""
    own = (row for row in rows if row["what"] == "diagnosis")
    return next((row for row in own if (row["mode_hz"], row["model"]) == (mode, model)), None)


def mean_of(row: Row, column: str, less: Row | None = None) -> Interval:
    """Mean of a column with its 95 % interval; of paired differences if another row is given."""
    values = np.array(row[column], dtype=float)
    if less is not None:
        if row["truth"] != less["truth"]:
            raise ValueError("only diagnoses of the same hidden arms are paired")
        values = values - np.array(less[column], dtype=float)
    return bootstrap_mean(values, rng=np.random.default_rng(0))


def success_of(row: Row) -> Interval:
    """Accuracy of the verdicts with Wilson's 95 % interval."""
    right, of = int(np.sum(row["success"])), len(row["success"])
    low, high = wilson(right, of)
    return Interval(estimate=right / of, low=low, high=high)


def print_tables(rows: Sequence[Row]) -> None:
    """Print the identified effects, and accuracy and return of the diagnosis by model."""
    print("Effects identified by loose gap\n")
    print(f"{'mode':>7} {'true stiffness':>14}  {'identified':<38} {'stiffness (95 %)':<35} gap")
    for row in (r for r in rows if r["what"] == "gap"):
        named = [f"{e['kind']}@{e['where']}" for e in row["effects"]] or [row["verdict"]]
        stiffness = [
            "{:.4g} ({:.4g} to {:.4g})".format(
                effect["parameters"]["stiffness"], *effect["interval_95"]["stiffness"]
            )
            for effect in row["effects"]
            if effect["kind"] == "joint_compliance"
        ]
        print(
            f"{row['mode_hz']:>4.0f} Hz {row['stiffness']:>14.4g}  {', '.join(named):<38} "
            f"{', '.join(stiffness):<35} {row['before']:.1f} to {row['after']:.2f}"
        )
    print("\nDiagnosis of the same hidden arms\n")
    print(
        f"{'mode':>7} {'model':<10} {'accuracy [%] (95 %)':>20} {'unsure':>7} "
        f"{'return (95 %)':>23} {'accuracy over nominal':>22} {'return over nominal':>24}"
    )
    for row in (r for r in rows if r["what"] == "diagnosis"):
        mode = "none" if row["mode_hz"] is None else f"{row['mode_hz']:.0f} Hz"
        right, earned = success_of(row), mean_of(row, "reward")
        unsure = np.mean([v == UNSURE for v in row["verdict"]])
        line = (
            f"{mode:>7} {row['model']:<10} {100 * right.estimate:>8.1f} "
            f"({100 * right.low:>4.1f}-{100 * right.high:>5.1f}) {100 * unsure:>6.1f} "
            f"{earned.estimate:>+7.3f} ({earned.low:+.3f},{earned.high:+.3f})"
        )
        nominal = row_of(rows, row["mode_hz"], "nominal")
        if nominal is not None and nominal is not row:
            r, e = mean_of(row, "success", nominal), mean_of(row, "reward", nominal)
            line += f" {100 * r.estimate:>+7.1f} ({100 * r.low:+.1f},{100 * r.high:+.1f})"
            line += f" {e.estimate:>+8.3f} ({e.low:+.3f},{e.high:+.3f})"
        print(line)


def draw(rows: list[Row], settings: Settings, path: Path) -> None:
    """Draw accuracy and return against the mode of the spring, a line for each model."""
    plt = pyplot()
    figure, panels = plt.subplots(1, 2, figsize=(8.6, 3.7), sharex=True)
    stiff = row_of(rows, None, "nominal")
    for panel, (column, label) in zip(
        panels, (("success", "accuracy [%]"), ("reward", "mean return")), strict=True
    ):
        scale = 100.0 if column == "success" else 1.0
        measure = success_of if column == "success" else lambda row: mean_of(row, "reward")
        panel.axvspan(30, 150, color="#eef1f4", lw=0, zorder=0)
        for shift, (model, words) in zip((0.97, 1.0, 1.03), MODELS.items(), strict=True):
            own = [(m, row_of(rows, m, model)) for m in settings.modes]
            found = [(m, measure(row)) for m, row in own if row is not None]
            panel.errorbar(
                [m * shift for m, _ in found],
                [scale * i.estimate for _, i in found],
                yerr=np.array(
                    [
                        [scale * (i.estimate - i.low) for _, i in found],
                        [scale * (i.high - i.estimate) for _, i in found],
                    ]
                ),
                color=COLOURS[model],
                lw=1.8,
                marker="o",
                ms=4,
                elinewidth=1,
                label=words,
            )
        if stiff is not None:
            at = scale * measure(stiff).estimate
            panel.axhline(at, color=MUTED, lw=1, ls=":", label="no spring, nominal model")
        panel.set_xscale("log")
        panel.set_xticks(list(settings.modes), [f"{m:g}" for m in settings.modes])
        panel.minorticks_off()
        panel.invert_xaxis()
        panel.set_xlabel(f"mode of the hidden spring in the {settings.joint} [Hz]")
        panel.set_ylabel(label, color=INK)
    panels[0].set_ylim(0, 102)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", ncols=4, frameon=False, fontsize=8)
    figure.text(
        0.01,
        0.012,
        "Shaded: band of the excitation. Bars: 95 % intervals.",
        fontsize=8,
        color=MUTED,
    )
    figure.tight_layout(rect=(0, 0.03, 1, 0.93))
    save_figure(plt, figure, path)
