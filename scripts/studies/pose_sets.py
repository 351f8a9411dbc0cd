"""Compare selection rules for pose sets: accuracy of the loose link, pose by pose.

Two levels. "directions": every pose gives the direction of looseness with a stated scatter, and
the posterior over links is exact; the limit that no choice of poses can pass is drawn in.
"records": simulated records of arms with hidden faults, one analytic posterior and one excitation
for all strategies. Rows are stored block by block; they are the same for any backend and number of
workers.

Usage: python scripts/studies/pose_sets.py [--level directions|records] [--quick]
           [--engine mujoco|reduced] [--learned AGENT ...] [--workers N] [--out FOLDER]
       python scripts/studies/pose_sets.py --level     (draws and prints what is stored)
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from loose_agents.base import Problem
from loose_agents.jobs import BackendSettings
from loose_agents.policies.pose_sets import (
    ARMS,
    GREEDY,
    LIMIT,
    Directions,
    Records,
    Task,
    directions_block,
    limit_rows,
    records_block,
)
from loose_agents.registry import make_agent

from loose_env.cli.command import command, one_of
from loose_env.diagnosis import PLANNED
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.evaluation import wilson
from loose_env.io import Count, written_beside
from loose_env.report import AGENTS as PALETTE
from loose_env.report import FAINT, INK, MUTED
from loose_env.typing import Array
from scripts.study import ROOT, Row, pyplot, read_study, save_figure, study_rows, write_between

STRATEGIES = (*PLANNED, GREEDY)
COLOURS = dict(zip(STRATEGIES, (6, 1, 3, 4, 5, 0, 2), strict=True))
LEVELS = ("directions", "records")
_LIMITS = Task(arm="", strategy=LIMIT, first=0, cases=0)


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Settings of both levels."""

    level: tuple[Annotated[str, one_of(LEVELS)], ...] = LEVELS
    """Levels that are worked out; none: print and draw what is stored."""
    arm: tuple[Annotated[str, one_of(tuple(ARMS))], ...] = tuple(ARMS)
    """Arms."""
    cases: Count | None = None
    """Cases for each arm, scatter and strategy."""
    engine: Literal["mujoco", "reduced"] = "mujoco"
    """Engine of the simulation."""
    excited: Literal["all", "first"] = "all"
    """Excited joints."""
    difficulty: str = "default"
    """Easy, default or hard."""
    learned: tuple[str, ...] = ("ppo",)
    """Agents of the registry; skipped if untrained."""
    seed: int = 0
    """Root of all draws."""
    quick: bool = False
    """A rough look with few cases."""
    out: Path | None = None
    """Folder of rows and figure; docs/figures by default, of a quick run out."""
    afresh: bool = False
    """Work out again what is stored."""


def playable(settings: Records) -> dict[str, list[str]]:
    """For each arm, the learned agents that can play there; says why others cannot."""
    found: dict[str, list[str]] = {name: [] for name in settings.arms}
    for name in settings.arms if settings.learned else ():
        problem = Problem.of(ARMS[name](), settings.rules())
        for agent in settings.learned:
            try:
                make_agent(agent, problem)
            except (LooseEnvError, ValueError, OSError, ImportError) as error:
                print(f"{agent} on {name} is left out: {error}", file=sys.stderr)
            else:
                found[name].append(agent)
    return found


def tasks_of(settings: Directions | Records) -> list[Task]:
    """All blocks, in an order in which a run cut short has a little of everything."""
    further = playable(settings) if isinstance(settings, Records) else {}
    blocks = [
        Task(arm=arm, strategy=s, first=k, cases=min(settings.block, settings.cases - k))
        for k in range(0, settings.cases, settings.block)
        for arm in settings.arms
        for s in (*STRATEGIES, *further.get(arm, []))
    ]
    return blocks if isinstance(settings, Records) else [_LIMITS, *blocks]


def work(task: Task, *, settings: Directions | Records) -> Sequence[Row]:
    """Rows of one block, or the limits of all directions."""
    if isinstance(settings, Records):
        return records_block(task, settings)
    return limit_rows(settings) if task == _LIMITS else directions_block(task, settings)


def task_of(settings: Directions | Records, row: Row) -> Task:
    """Block of a row."""
    if row["strategy"] == LIMIT:
        return _LIMITS
    first = row["first"]
    cases = min(settings.block, settings.cases - first)
    return Task(arm=row["arm"], strategy=row["strategy"], first=first, cases=cases)


def rows_of(
    folder: Path, settings: Directions | Records, backend: BackendSettings, *, afresh: bool = False
) -> list[Row]:
    """Rows of one level."""
    return study_rows(
        path_of(folder, settings),
        tasks_of(settings),
        work,
        partial(task_of, settings),
        script="scripts/studies/pose_sets.py",
        settings=settings,
        order=lambda row: (
            list(ARMS).index(row["arm"]),
            row["strategy"],
            row.get("sd", 0.0),
            row.get("first", 0),
        ),
        unit="blocks",
        backend=backend,
        afresh=afresh,
    )


def path_of(folder: Path, settings: Directions | Records) -> Path:
    """File of the rows of a level."""
    return folder / f"pose_sets_{type(settings).__name__.lower()}.json"


def summed(rows: Sequence[Row]) -> dict[tuple[str, float, str], Row]:
    """Add the blocks up: by arm, scatter (0: records) and strategy."""
    found: dict[tuple[str, float, str], Row] = {}
    for row in rows:
        key = (row["arm"], float(row.get("sd", 0.0)), row["strategy"])
        if row["strategy"] == LIMIT:
            found[key] = row
            continue
        whole = found.setdefault(
            key, {"links": row["links"], "cases": 0, "right": 0, "informed": 0, "failed": 0}
        )
        whole["cases"] += row["cases"]
        whole["failed"] += row.get("failed", 0)
        for name in ("right", "informed"):
            whole[name] = whole[name] + np.array(row.get(name, 0))
    return found


def limit_of(whole: dict[tuple[str, float, str], Row], arm: str, sd: float) -> Array:
    """Limit to draw: that of directions; of records, were direction and friction known."""
    if sd > 0:
        return np.array(whole[arm, sd, LIMIT]["share"])
    own = [row for (name, part, _), row in whole.items() if name == arm and part == 0]
    return np.max([row["informed"] / row["cases"] for row in own], axis=0)  # type: ignore[no-any-return]


# Showing


def strategies_in(whole: dict[tuple[str, float, str], Row]) -> list[str]:
    """Names in the rows, the known ones first."""
    names = {name for _, _, name in whole} - {LIMIT}
    return [s for s in STRATEGIES if s in names] + sorted(names - set(STRATEGIES))


def tables(rows: Sequence[Row]) -> str:
    """Success after 2, 3 and 4 poses as Markdown, a table for each scatter and one for records."""
    whole = summed(rows)
    arms = [a for a in ARMS if any(key[0] == a for key in whole)]
    parts = []
    for sd in sorted({key[1] for key in whole}, key=lambda s: (s == 0, s)):
        here = [a for a in arms if any(key[:2] == (a, sd) for key in whole)]
        own = {key: row for key, row in whole.items() if key[1] == sd}
        counts = {row["cases"] for key, row in own.items() if key[2] != LIMIT}
        least, most = min(counts), max(counts)
        cases = f"{most}" if least == most else f"{least} to {most} (a run cut short)"
        what = f"Directions with a scatter of {sd:g}°" if sd else "Simulated records"
        first = "1 / 2 / 3 / 5" if sd == 0 else "2 / 3 / 4"
        chosen = [int(x) - 1 for x in first.split("/")]
        lines = [
            f"**{what}**: the right link in %, after {first} poses, {cases} cases "
            f"(95 % interval at most ±{100 * _half(least):.1f}).",
            "",
            "| strategy | " + " | ".join(_title(a) for a in here) + " |",
            "| --- |" + " --- |" * len(here),
        ]
        for name in strategies_in(own):
            cells = []
            for a in here:
                row = own.get((a, sd, name))
                share = None if row is None else row["right"] / row["cases"]
                cells.append("" if share is None else _cell(share, chosen))
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        name = "limit" if sd else "direction and friction known"
        cells = [_cell(limit_of(own, a, sd), chosen) for a in here]
        lines.append(f"| *{name}* | " + " | ".join(cells) + " |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _cell(share: Array, chosen: Sequence[int]) -> str:
    return " / ".join(f"{100 * share[t]:.0f}" for t in chosen if t < len(share))


def _half(cases: int) -> float:
    low, high = wilson(cases // 2, cases)
    return (high - low) / 2


def _title(arm: str) -> str:
    return f"{arm.removeprefix('planar')} links" if arm.startswith("planar") else "six-axis arm"


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw success by number of poses, as PNG and SVG: a column an arm, a row a scatter."""
    plt = pyplot()
    whole = summed(rows)
    arms = [a for a in ARMS if any(key[0] == a for key in whole)]
    sds = sorted({key[1] for key in whole}, key=lambda s: (s == 0, s))
    names = strategies_in(whole)
    colours = {s: PALETTE[k] for s, k in COLOURS.items()}
    colours |= {s: INK for s in names if s not in colours}
    figure, axes = plt.subplots(
        len(sds),
        len(arms),
        figsize=(1.2 + 2.15 * len(arms), 1.5 + 2.1 * len(sds)),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for panels, sd in zip(axes, sds, strict=True):
        for panel, arm in zip(panels, arms, strict=True):
            _panel(panel, whole, arm, sd, colours)
        what = f"directions ± {sd:g}°" if sd else "simulated records"
        panels[0].set_ylabel(f"{what}\nright link [%]")
    for panel, arm in zip(axes[0], arms, strict=True):
        panel.set_title(_title(arm), fontsize=9.5, color=INK, loc="left")
    for panel in axes[-1]:
        panel.set_xlabel("poses")
    handles = [plt.Line2D([], [], color=colours[s], lw=2, label=s) for s in names]
    handles += [
        plt.Line2D([], [], color=INK, lw=1.2, ls=(0, (4, 2)), label="limit (see below)"),
        plt.Line2D([], [], color=MUTED, lw=1, ls=":", label="one joint, perfect directions"),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=5, frameon=False, fontsize=8.5)
    low = 0.62 / figure.get_figheight()
    figure.text(0.008, 0.08 / figure.get_figheight(), _caption(sds), fontsize=8, color=MUTED)
    figure.tight_layout(rect=(0, low, 1, 1 - 0.5 / figure.get_figheight()))
    # The same file for the same rows.
    with plt.rc_context({"svg.hashsalt": "pose sets"}):
        written_beside(
            path.with_suffix(".svg"), lambda beside: figure.savefig(beside, metadata={"Date": None})
        )
    save_figure(plt, figure, path.with_suffix(".png"))


def _caption(sds: Sequence[float]) -> str:
    words = []
    if any(sds):
        words.append(
            "Directions, dashed: no choice of poses, fixed or adaptive, and no rule can pass it "
            "when every direction scatters so (sphere-packing bound). "
        )
    if 0.0 in sds:
        words.append(
            "Records, dashed: best of the strategies if the slide's direction and friction were "
            "known beside the same records. "
        )
    words.append(
        "Dotted: t of n links named after t poses, one joint moved at a time from the base, "
        "directions perfect. Bands: 95 % (Wilson)."
    )
    return "\n".join("".join(words[k : k + 1]) for k in range(len(words)))


def _panel(panel: Any, whole: dict[Any, Row], arm: str, sd: float, colours: dict[str, str]) -> None:
    own = {s: row for (a, part, s), row in whole.items() if (a, part) == (arm, sd) and s != LIMIT}
    if not own:
        panel.set_axis_off()
        return
    links = next(iter(own.values()))["links"]
    for name, colour in colours.items():
        if name not in own:
            continue
        right, cases = own[name]["right"], own[name]["cases"]
        x = np.arange(1, len(right) + 1)
        low, high = np.array([wilson(int(r), cases) for r in right]).T
        panel.fill_between(x, 100 * low, 100 * high, color=colour, alpha=0.15, lw=0)
        panel.plot(x, 100 * right / cases, color=colour, lw=1.5)
    best = limit_of(whole, arm, sd)
    x = np.arange(1, len(best) + 1)
    panel.plot(x, 100 * best, color=INK, lw=1.2, ls=(0, (4, 2)))
    # One joint at a time, directions perfect: a move settles one link; one of the rest is guessed.
    share = 100 * np.minimum(1.0, x / links)
    panel.plot(x, share, color=MUTED, lw=1, ls=":")
    panel.set_ylim(0, 103)
    panel.set_xticks(x)
    panel.grid(axis="y", color=FAINT, lw=0.5)


def evaluate(chosen: Options) -> None:
    """Run the levels, print the tables, write the figure and the tables of the page."""
    directions = Directions(arms=chosen.arm, seed=chosen.seed)
    records = Records(
        arms=chosen.arm,
        difficulty=chosen.difficulty,
        engine=chosen.engine,
        excited=chosen.excited,
        learned=chosen.learned,
        seed=chosen.seed,
    )
    if chosen.quick:
        directions = replace(directions, cases=40, block=20, poses=4, samples=4000)
        records = replace(records, cases=12, block=12, poses=3)
    if chosen.cases is not None:
        directions = replace(directions, cases=chosen.cases)
        records = replace(records, cases=chosen.cases)
    rows: list[Row] = []
    folder = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    both: tuple[Directions | Records, ...] = (directions, records)
    for level, settings in zip(LEVELS, both, strict=True):
        if level in chosen.level:
            rows += rows_of(folder, settings, chosen, afresh=chosen.afresh)
        elif path_of(folder, settings).exists():  # drawn and printed as it was stored
            rows += read_study(path_of(folder, settings))["rows"]
    if not rows:
        raise InvalidSetting(f"no rows lie in {folder}: name a --level")
    draw(rows, folder / "pose_sets.png")
    print(tables(rows))
    if folder == ROOT / "docs/figures":
        write_between(ROOT / "docs/pose_sets.md", tables(rows))
    print(f"\npicture: {folder / 'pose_sets.png'}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the levels asked for, with errors in one line."""
    interrupted = "the same command goes on"
    command("pose_sets", __doc__, Options, evaluate, arguments, interrupted=interrupted)


if __name__ == "__main__":
    main()
