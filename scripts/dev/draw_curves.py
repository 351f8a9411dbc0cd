"""Draw learning curves with bands over seeds, and print the table of the last evaluations.

Usage: python scripts/dev/draw_curves.py curves [--out FOLDER]

Reads ENV/LEARNER/seed_K/curve.csv, as scripts/agents/learning_curves.py writes it. A line is the
mean over the seeds, its band the 95 % confidence interval of that mean (Student's t).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.rl.end_to_end.learning_curve import CurvePoint, read_curve
from scipy.stats import t as student

from loose_env.errors import InvalidData
from loose_env.report import pyplot, save_figure
from loose_env.typing import Array

SHOWN = {
    "mean_return": ("mean return", (-1.0, 1.0)),
    "right": ("share right", (0.0, 1.0)),
    "unsure": ("share unsure", (0.0, 1.0)),
    "records_per_episode": ("records an episode", (0.0, None)),
}
"""Columns of the curves, their words and the ends of their axis: bands of few seeds are wide."""
COLOURS = ("#0072b2", "#d0451b", "#009e73", "#cc79a7", "#f0a30a")
"""A colour for each learner, told apart by colour-blind readers too."""
GRID = 60
"""Places at which curves are averaged."""

Curves = dict[str, dict[str, list[list[CurvePoint]]]]


def read_curves(folder: Path) -> Curves:
    """Curves of each environment, learner and seed.

    Raises
    ------
    InvalidData
        If there are none.
    """
    found: Curves = {}
    for path in sorted(folder.glob("*/*/seed_*/curve.csv")):
        points = read_curve(path)
        if points:
            env, learner = path.parts[-4:-2]
            # A folder's name cannot hold the id's stroke.
            found.setdefault(env.replace("-", "/", 1), {}).setdefault(learner, []).append(points)
    if not found:
        raise InvalidData(
            f"{folder} holds no curves ENV/LEARNER/seed_K/curve.csv; "
            "scripts/agents/learning_curves.py --out writes them"
        )
    return found


def mean_and_half(values: Array) -> tuple[Array, Array]:
    """Mean over seeds (seeds, ...) and half width of its 95 % interval; NaN for a single seed."""
    count = len(values)
    if count == 1:
        return values[0], np.full(values.shape[1:], np.nan)
    error = values.std(axis=0, ddof=1) / np.sqrt(count)
    return values.mean(axis=0), student.ppf(0.975, count - 1) * error


def band(seeds: list[list[CurvePoint]], name: str) -> tuple[Array, Array, Array]:
    """Records taken, mean and half width, over the range that all seeds have reached."""
    places = [np.array([p.records for p in points], dtype=float) for points in seeds]
    grid = np.linspace(max(x[0] for x in places), min(x[-1] for x in places), GRID)
    values = np.array(
        [
            np.interp(grid, x, [getattr(p, name) for p in points])
            for x, points in zip(places, seeds, strict=True)
        ]
    )
    return grid, *mean_and_half(values)


def table(curves: Curves) -> str:
    """The last evaluation of each learner, mean over the seeds with its 95 % interval."""
    lines = [
        "| environment | learner | seeds | records taken | return | right [%] | unsure [%] | "
        "records an episode |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for env, learners in curves.items():
        for learner, seeds in learners.items():
            last = [points[-1] for points in seeds]
            cells = [f"{np.mean([p.records for p in last]):.0f}"]
            for name, scale, form in (
                ("mean_return", 1, "+.3f"),
                ("right", 100, ".1f"),
                ("unsure", 100, ".1f"),
                ("records_per_episode", 1, ".2f"),
            ):
                mean, half = mean_and_half(np.array([scale * getattr(p, name) for p in last]))
                shown = f" ± {half:{form.lstrip('+')}}" if len(last) > 1 else ""
                cells.append(f"{mean:{form}}{shown}")
            lines.append(f"| {env} | {learner} | {len(seeds)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(curves: Curves, path: Path) -> None:
    """Draw a column for each environment and a row for each quantity."""
    plt = pyplot()
    figure, axes = plt.subplots(
        len(SHOWN),
        len(curves),
        figsize=(4.2 * len(curves), 2.1 * len(SHOWN)),
        sharex="col",
        squeeze=False,
        layout="constrained",
    )
    learners = sorted({learner for own in curves.values() for learner in own})
    colours = {each: COLOURS[k % len(COLOURS)] for k, each in enumerate(learners)}
    for column, (env, own) in enumerate(curves.items()):
        for row, (name, (words, ends)) in enumerate(SHOWN.items()):
            panel: Any = axes[row][column]
            for learner, seeds in own.items():
                grid, mean, half = band(seeds, name)
                panel.plot(grid / 1000, mean, color=colours[learner], lw=1.6, label=learner)
                if len(seeds) > 1:
                    panel.fill_between(
                        grid / 1000,
                        mean - half,
                        mean + half,
                        color=colours[learner],
                        alpha=0.2,
                        lw=0,
                    )
            highest = max(band(seeds, name)[1].max() for seeds in own.values())
            panel.set_ylim(ends[0], max(1.1 * highest, 1.0) if ends[1] is None else ends[1])
            if column == 0:
                panel.set_ylabel(words)
            if row == 0:
                panel.set_title(env)
                panel.legend(frameon=False, loc="lower right")
        axes[-1][column].set_xlabel("records taken [thousands]")
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(plt, figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and draw the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the runs")
    parser.add_argument("--out", type=Path, default=Path("docs/figures"), help="folder")
    options = parser.parse_args(arguments)
    with errors_in_one_line("draw_curves"):
        curves = read_curves(options.folder)
        print(table(curves))
        path = options.out / "learning_curves.svg"
        draw(curves, path)
        print(f"Figure: {path}")


if __name__ == "__main__":
    main()
