"""Find out how a seat opens with level, gap and gravity along it.

A vertical arm is turned about its base, so that gravity along one seat takes given values and
nothing else changes; for each gap the level is raised from where the seat is shut to where it
strikes its stops. The study keeps the share of transmission that is lost along the seat.

Usage: python scripts/studies/opening.py [--quick] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import loose_env
from loose_env.arms import Arm, LinearArm, planar
from loose_env.diagnosis import statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.io import Count
from loose_env.report import (
    INK,
    MUTED,
    pyplot,
    rounded,
    save_figure,
    stored_rows,
    study_head,
    write_study,
)
from loose_env.rig import Job, SimulatedRig
from loose_env.statistics import transmission_change
from loose_env.typing import Array

ROOT = Path(__file__).resolve().parents[2]
OPENING_LINK, OPENING_SEAT, OPENING_BEND = 2, (0.6, 0.8, 0.0), (0.7, -0.6)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is studied."""

    gravities: tuple[float, ...] = (0.0, 0.1, 0.3, 1.0)
    """Gravity along the seat [g]."""
    gaps: tuple[float, ...] = (0.03e-3, 0.1e-3, 0.4e-3)
    """Gaps [m]."""
    levels: tuple[float, ...] = tuple(float(x) for x in np.geomspace(0.05, 12.0, 15).round(3))
    """Rms acceleration at the nominal tool [m/s²]."""
    repeats: Count = 8
    """Draws of the excitation for each point."""
    friction: float = 0.2
    """Guide friction [N]."""
    duration: float = 1.2
    """Length of a record [s]."""
    seed: int = 0
    """Seed of stops and excitations."""


def quick(settings: Settings) -> Settings:
    """Return a rough look at the same."""
    return dataclasses.replace(
        settings, gravities=(0.0, 0.3), gaps=(0.1e-3,), levels=(0.1, 0.4, 1.6, 6.4), repeats=3
    )


def seat_direction(arm: Arm, pose: Array, fault: StructuralLooseness) -> Array:
    """Direction of a slide in the tool frame of the nominal arm, unit vector (d,)."""
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(model, data)
    link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    along = (tool.T @ link @ np.array(fault.direction))[list(arm.axes)]
    return np.asarray(along / np.linalg.norm(along))


def opening_rows(
    settings: Settings, threads: int, report: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Share of transmission lost along a seat, by gravity along it, gap and level."""
    arm = planar(3, vertical=True)
    linear = LinearArm(arm)
    fault = FaultSampler(linear, Difficulty()).draw(
        np.random.default_rng(settings.seed), hypothesis=f"structural_looseness@link{OPENING_LINK}"
    )
    assert isinstance(fault, StructuralLooseness)
    fault = dataclasses.replace(fault, direction=OPENING_SEAT, friction=settings.friction)
    rig = SimulatedRig(arm, slots=2 * len(settings.levels), threads=threads)
    rows = []
    for gravity in settings.gravities:
        # Joint 1 turns the whole arm against gravity and changes nothing else.
        seat = np.arctan2(OPENING_SEAT[1], OPENING_SEAT[0]) + OPENING_BEND[0]
        pose = np.array([np.arcsin(-gravity) - seat, *OPENING_BEND])
        pose[0] = (pose[0] + np.pi) % (2 * np.pi) - np.pi
        at = linear.at(pose)
        for gap in settings.gaps:
            loose = dataclasses.replace(fault, gap=gap)
            along = seat_direction(arm, pose, loose)
            kept: list[list[float]] = [[] for _ in settings.levels]
            change: list[list[float]] = [[] for _ in settings.levels]
            for k in range(len(settings.levels)):
                rig.mount(2 * k, loose)
                rig.mount(2 * k + 1, Healthy())
            report(f"{gravity:g} g along the seat, gap {1e3 * gap:g} mm")
            for draw in range(settings.repeats):
                jobs = []
                for k, level in enumerate(settings.levels):
                    shake, _ = at_levels(
                        at, np.array([level, 0.0, 0.0]), duration=settings.duration
                    )
                    for state in (0, 1):
                        rng = np.random.default_rng([settings.seed, k, draw])
                        jobs.append(Job(slot=2 * k + state, pose=pose, excitation=shake, rng=rng))
                measured = rig.measure_many(jobs)
                for k in range(len(settings.levels)):
                    pair = measured[2 * k : 2 * k + 2]
                    if any(m.failure is not None for m in pair):
                        continue
                    b, healthy = (statistics_of(m).transmission_by_instrument[:, :1] for m in pair)
                    kept[k].append(float((along @ b).item() / (along @ healthy).item()))
                    change[k].append(transmission_change(b, healthy).ratio)
            rows += [
                {
                    "gravity": gravity,
                    "gap": gap,
                    "level": level,
                    "lost_share": [1 - x for x in kept[k]],
                    "change": change[k],
                }
                for k, level in enumerate(settings.levels)
            ]
    return rows


def draw_opening(rows: Sequence[dict[str, Any]], settings: Settings, path: Path) -> None:
    """Draw the share of transmission lost along the seat against the level."""
    plt = pyplot()
    colours = ("#0072b2", "#4a8f5c", "#f0a30a", "#d0451b")
    count = len(settings.gaps)
    figure, axes = plt.subplots(
        1, count, figsize=(1.0 + 3.5 * count, 4.2), sharey=True, squeeze=False
    )
    for panel, gap in zip(axes[0], settings.gaps, strict=True):
        panel.axhline(0, color=INK, lw=0.9)
        for colour, gravity in zip(colours, settings.gravities, strict=False):
            own = [r for r in rows if r["gap"] == gap and r["gravity"] == gravity]
            x = [r["level"] for r in own]
            low, middle, high = np.array(
                [np.quantile(r["lost_share"], (0.1, 0.5, 0.9)) for r in own]
            ).T
            panel.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
            panel.plot(x, middle, color=colour, lw=1.8, label=f"{gravity:g} g along the seat")
        panel.set_xscale("log")
        panel.set_ylim(-0.6, 1.0)
        panel.minorticks_off()
        panel.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
        panel.set_title(f"gap {1e3 * gap:g} mm", fontsize=9.5, color=INK, loc="left")
        panel.set_xlabel("rms acceleration at the nominal tool [m/s²]")
    axes[0, 0].set_ylabel("share of transmission lost\nalong the seat, κ")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", ncols=4, frameon=False, fontsize=8.5)
    figure.text(
        0.008,
        0.015,
        "Planar arm of 3 links, vertical; slide in link 2, joint 1 shaken. Lines: median, bands: "
        "80 % of the records. 0: shut, looks healthy; 1: nothing arrives\nalong the seat; below 0: "
        "more arrives than in the healthy arm, thrown by the stops.",
        fontsize=8,
        color=MUTED,
    )
    figure.tight_layout(rect=(0, 0.075, 1, 0.94))
    save_figure(plt, figure, path)


def print_opening(rows: Sequence[dict[str, Any]]) -> None:
    """Print the median share of transmission lost, by gravity, gap and level."""
    levels = sorted({r["level"] for r in rows})
    print(f"\n{'gravity':>8} {'gap':>8} " + " ".join(f"{x:6.2g}" for x in levels) + "  m/s²")
    for gravity, gap in sorted({(r["gravity"], r["gap"]) for r in rows}):
        own = sorted(
            (r for r in rows if (r["gravity"], r["gap"]) == (gravity, gap)),
            key=lambda r: r["level"],
        )
        shares = " ".join(f"{np.median(r['lost_share']):6.2f}" for r in own)
        print(f"{gravity:6g} g {1e3 * gap:5g} mm {shares}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print its table, write its figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0, help="simulation threads; 0: all")
    parser.add_argument("--quick", action="store_true", help="a rough look in seconds")
    parser.add_argument("--afresh", action="store_true", help="measure what is known already")
    parser.add_argument("--out", type=Path, help="folder; default docs/figures, quick: out/")
    chosen = parser.parse_args(arguments)
    settings = Settings(seed=chosen.seed)
    settings = quick(settings) if chosen.quick else settings
    folder: Path = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    folder.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - started:4.0f} s] {line}", file=sys.stderr, flush=True)

    path = folder / "holding_opening.json"
    document = study_head("scripts/studies/opening.py", settings, version=loose_env.__version__)
    found = [] if chosen.afresh else stored_rows(path, document)
    if not found:
        found = rounded(opening_rows(settings, chosen.threads, report))
        write_study(path, document, found)
    draw_opening(found, settings, path.with_suffix(".png"))
    print_opening(found)
    print(f"\npicture: {path.with_suffix('.png')}")
    report("done")


if __name__ == "__main__":
    main()
