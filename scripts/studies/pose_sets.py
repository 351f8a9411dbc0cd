"""Compare selection rules for pose sets: accuracy of the loose link, pose by pose.

Every pose gives the direction of looseness with a stated scatter, and the posterior over links is
exact; the limit that no choice of poses can pass is drawn in. Rows are stored block by block; they
are the same for any backend and number of workers.

Usage: python scripts/studies/pose_sets.py [--quick] [--workers N] [--out FOLDER]
       python scripts/studies/pose_sets.py --stored     (draws and prints what is stored)
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from loose_agents.jobs import BackendSettings

from loose_env.arms import Arm, planar, six_axis
from loose_env.cli.command import command, one_of
from loose_env.diagnosis import (
    PLANNED,
    PoseSets,
    bingham_width,
    candidate_poses,
    choose_move,
    direction_limit,
    link_posterior,
    log_mean_bingham,
    scattered_axes,
)
from loose_env.evaluation import wilson
from loose_env.io import Count, plain
from loose_env.report import AGENTS as PALETTE
from loose_env.report import INK, MUTED
from loose_env.typing import Array
from scripts.charts import DASHED, Curve, Panel, chart, curve, save
from scripts.study import ROOT, write_between
from scripts.suites.rows import Row, code_of_study, run_cases

ARMS: dict[str, Callable[[], Arm]] = {
    **{f"planar{n}": functools.partial(planar, n) for n in range(2, 8)},
    "six_axis": six_axis,
}
GREEDY, LIMIT = "greedy separation", "limit"
ROWS = "pose_sets_directions.jsonl"
"""File of the rows."""
SCATTERS, BLOCK = (5.0, 10.0, 20.0), 50
"""Standard deviations of a direction [deg], and cases that are worked on together."""
MOVES = np.radians([m for m in range(-90, 91, 15) if m])
"""Moves of a hinge at the level of directions [rad]."""


@dataclass(frozen=True, kw_only=True)
class Directions:
    """Directions with a stated scatter: what rows rest on beside their task."""

    poses: int = 7
    samples: int = 40_000
    """Draws for each limit."""
    seed: int = 0


class Task(NamedTuple):
    """Block of cases for one strategy on one arm at one scatter; the limit has no cases."""

    arm: str
    strategy: str
    sd: float
    """Standard deviation of a direction [deg]."""
    first: int = 0
    cases: int = 0


@functools.cache
def sets_of(arm: str, moves: tuple[float, ...]) -> PoseSets:
    """Factory of pose sets that caches pose scores."""
    return PoseSets(ARMS[arm](), moves=np.array(moves))


def stream(seed: int, arm: str, case: int, *kind: int) -> np.random.Generator:
    """Generator of one kind of draw of one case, common to strategies and workers."""
    key = (list(ARMS).index(arm), case, *kind)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def link_log_likelihoods(images: Array, seen: Array, width: float) -> Array:
    """Log-likelihood of each link after each pose; vectorised `link_posterior`."""
    d = seen.shape[-1]
    across = (np.eye(d) - seen[..., :, None] * seen[..., None, :]) / width**2
    carried = np.einsum("ctkia,ctij,ctkjb->ctkab", images, across, images).cumsum(axis=1)
    alone = np.cumsum(log_mean_bingham(across), axis=1)
    return np.asarray(log_mean_bingham(carried) - alone[..., None])


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Case of a loose link whose direction is observed with scatter."""

    link: int
    direction: Array
    start: Array

    @classmethod
    def draw(cls, sets: PoseSets, rng: np.random.Generator) -> Case:
        """Sample link, direction in the link frame, and initial pose."""
        z = rng.standard_normal(sets.frames.dimension)
        link = 1 + int(rng.integers(sets.arm.n))
        start = sets.arm.random_pose(rng)
        return cls(link=link, direction=z / np.linalg.norm(z), start=start)

    def seen(self, images: Array, width: float, rng: np.random.Generator) -> Array:
        """Observed axes for given images (poses, n, d, d)."""
        return scattered_axes(images[:, self.link - 1] @ self.direction, width, rng)


def greedy_poses(
    sets: PoseSets, case: Case, count: int, sd: float, rngs: Sequence[np.random.Generator]
) -> Array:
    """Maximise the separation of the candidate links' images, pose by pose."""
    frames, width = sets.frames, bingham_width(sd, sets.frames.dimension)
    noise, draw = rngs
    poses: list[Array] = [case.start]
    seen: list[Array] = []
    while len(poses) < count:
        seen.append(case.seen(frames.images(poses[-1]), width, noise)[0])
        known = link_posterior(frames, poses, seen, width=width)
        where = candidate_poses(frames, poses[-1], MOVES, most=192, rng=draw)
        poses.append(where[choose_move(frames, known, where, sd=sd)])
    return np.array(poses)


def directions_block(task: Task, settings: Directions) -> Row:
    """Number of correctly identified links after each pose, or the limit of their share."""
    name, strategy, degrees, first, cases_of_block = task
    sets, sd = sets_of(name, tuple(MOVES)), float(np.radians(degrees))
    frames, links, count, seed = sets.frames, sets.arm.n, settings.poses, settings.seed
    row: Row = {**task._asdict(), "links": links}
    if strategy == LIMIT:
        # One stream for all arms: the limits differ by what is asked, not by sampling error.
        rng, axes = np.random.default_rng([seed, 99]), len(sets.arm.axes)
        best = direction_limit(links, count, sd, axes, rng, samples=settings.samples)
        return row | {"share": plain([float(b) for b in best], digits=4)}
    numbers, part = range(first, first + cases_of_block), SCATTERS.index(degrees)
    cases = [Case.draw(sets, stream(seed, name, k, 0)) for k in numbers]
    chosen = [
        greedy_poses(sets, case, count, sd, [stream(seed, name, k, kind, part) for kind in (2, 3)])
        if strategy == GREEDY
        else sets.make(strategy, case.start, count, stream(seed, name, k, 1))
        for k, case in zip(numbers, cases, strict=True)
    ]
    width = bingham_width(sd, frames.dimension)
    images = np.array([frames.images(poses) for poses in chosen])
    # Pose by pose, so that the greedy choice sees the axes that it is judged by.
    seen = []
    for k, case, image in zip(numbers, cases, images, strict=True):
        noise = stream(seed, name, k, 2, part)
        seen.append([case.seen(image[t : t + 1], width, noise)[0] for t in range(count)])
    log = link_log_likelihoods(images, np.array(seen), width)
    # A fair draw among equals, or one link would be favoured before anything is known.
    ties = np.array([stream(seed, name, k, 4).random(links) for k in numbers])
    named = 1 + np.argmax(log + 1e-7 * ties[:, None], axis=2)
    right = (named == np.array([[case.link] for case in cases])).sum(axis=0)
    return row | {"right": right.tolist()}


STRATEGIES = (*PLANNED, GREEDY)
COLOURS = dict(zip(STRATEGIES, (6, 1, 3, 4, 5, 0, 2), strict=True))


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Run of the study."""

    arm: tuple[Annotated[str, one_of(tuple(ARMS))], ...] = tuple(ARMS)
    """Arms."""
    cases: Count = 400
    """Cases for each arm, scatter and strategy."""
    seed: int = 0
    """Root of all draws."""
    quick: bool = False
    """A rough look with few cases."""
    out: Path | None = None
    """Folder of rows and figure; docs/figures by default, of a quick run out."""
    stored: bool = False
    """Print and draw what is stored."""
    afresh: bool = False
    """Work out again what is stored."""


def tasks_of(arms: Sequence[str], cases: int) -> list[Task]:
    """All blocks, in an order in which a run cut short has a little of everything."""
    limits = [Task(arm, LIMIT, sd) for arm in arms for sd in SCATTERS]
    return limits + [
        Task(arm, strategy, sd, first, min(BLOCK, cases - first))
        for first in range(0, cases, BLOCK)
        for arm in arms
        for strategy in STRATEGIES
        for sd in SCATTERS
    ]


def rows_of(
    folder: Path, tasks: Sequence[Task], settings: Directions, backend: BackendSettings, **how: bool
) -> list[Row]:
    """Rows of all blocks, stored in a folder."""
    return run_cases(
        tasks,
        partial(directions_block, settings=settings),
        folder / ROWS,
        key=itemgetter(*Task._fields),
        code=code_of_study(settings),
        backend=backend,
        say=lambda row: f"{row['strategy']} on {row['arm']} at {row['sd']:g}°",
        **how,
    )


Whole = dict[tuple[str, float, str], Row]
"""Rows added up, by arm, scatter [deg] and strategy."""


def summed(rows: Sequence[Row]) -> Whole:
    """Add the blocks up."""
    found: Whole = {}
    for row in rows:
        key = (row["arm"], float(row["sd"]), row["strategy"])
        if row["strategy"] == LIMIT:
            found[key] = row
            continue
        whole = found.setdefault(key, {"links": row["links"], "cases": 0, "right": 0})
        whole["cases"] += row["cases"]
        whole["right"] = whole["right"] + np.array(row["right"])
    return found


# Showing


def tables(rows: Sequence[Row]) -> str:
    """Success after 2, 3 and 4 poses as Markdown, a table for each scatter."""
    whole = summed(rows)
    parts = []
    for sd in sorted({key[1] for key in whole}):
        own = {key: row for key, row in whole.items() if key[1] == sd}
        here = [a for a in ARMS if any(key[0] == a for key in own)]
        counts = {row["cases"] for key, row in own.items() if key[2] != LIMIT}
        least, most = min(counts), max(counts)
        cases = f"{most}" if least == most else f"{least} to {most} (a run cut short)"
        lines = [
            f"**Directions with a scatter of {sd:g}°**: the right link in %, after "
            f"2 / 3 / 4 poses, {cases} cases (95 %\ninterval at most ±{100 * _half(least):.1f}).",
            "",
            "| strategy | " + " | ".join(_title(a) for a in here) + " |",
            "| --- |" + " --- |" * len(here),
        ]
        for name in STRATEGIES:
            shares = [row["right"] / row["cases"] if (row := own.get((a, sd, name))) else None
                      for a in here]  # fmt: skip
            lines.append(f"| {name} | " + " | ".join(map(_cell, shares)) + " |")
        limits = [_cell(np.array(own[a, sd, LIMIT]["share"])) for a in here]
        lines.append("| *limit* | " + " | ".join(limits) + " |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _cell(share: Array | None) -> str:
    return "" if share is None else " / ".join(f"{100 * s:.0f}" for s in share[1:4])


def _half(cases: int) -> float:
    low, high = wilson(cases // 2, cases)
    return (high - low) / 2


def _title(arm: str) -> str:
    return f"{arm.removeprefix('planar')} links" if arm.startswith("planar") else "six-axis arm"


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw success by number of poses: a column an arm, a row a scatter."""
    whole = summed(rows)
    arms = [a for a in ARMS if any(key[0] == a for key in whole)]
    panels = [
        Panel(
            title=_title(arm),
            up=f"directions ± {sd:g}°",
            curves=_curves(whole, arm, sd),
            look={"ylim": (0, 103)},
        )
        for sd in sorted({key[1] for key in whole})
        for arm in arms
    ]
    size = {"columns": len(arms), "width": 1.2 + 2.15 * len(arms), "height": 2.1}
    save(chart(panels, across="poses; vertical: right link [%]", **size), path)  # type: ignore[arg-type]


def _curves(whole: Whole, arm: str, sd: float) -> list[Curve]:
    """Success of every strategy with its 95 % interval (Wilson), and what bounds it."""
    curves = []
    for name, k in COLOURS.items():
        if (row := whole.get((arm, sd, name))) is not None:
            right, cases = row["right"], row["cases"]
            ends = np.array([wilson(int(r), cases) for r in right]).T
            values = 100 * np.vstack([right / cases, ends])
            x = np.arange(1, len(right) + 1)
            curves.append(curve(x, values, name, color=PALETTE[k], linewidth=1.5))
    limit = whole[arm, sd, LIMIT]
    x = np.arange(1, len(limit["share"]) + 1)
    # One joint at a time, directions perfect: a move settles one link; one of the rest is guessed.
    share = 100 * np.minimum(1.0, x / limit["links"])
    return [
        *curves,
        curve(x, 100 * np.array(limit["share"]), "limit", color=INK, linestyle=DASHED),
        curve(x, share, "one joint, perfect directions", color=MUTED, linestyle=":"),
    ]


def evaluate(chosen: Options) -> None:
    """Run the study, print the tables, write the figure and the tables of the page."""
    settings, cases = Directions(seed=chosen.seed), chosen.cases
    if chosen.quick:
        settings, cases = replace(settings, poses=4, samples=4000), min(40, cases)
    folder = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    rows = rows_of(folder, tasks_of(chosen.arm, cases), settings, chosen, afresh=chosen.afresh,
                   show=chosen.stored)  # fmt: skip
    draw(rows, folder / "pose_sets.png")
    print(tables(rows))
    if folder == ROOT / "docs/figures":
        write_between(ROOT / "docs/pose_sets.md", tables(rows))
    print(f"\npicture: {folder / 'pose_sets.png'}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, with errors in one line."""
    interrupted = "the same command goes on"
    command("pose_sets", __doc__, Options, evaluate, arguments, interrupted=interrupted)


if __name__ == "__main__":
    main()
