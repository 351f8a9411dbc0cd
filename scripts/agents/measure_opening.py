"""Measure how far seats open: the table that the posterior over faults ships with.

Faults are drawn, random joints are excited at random levels in random poses, and each record's
fit at the true place is kept. Expectation-maximisation finds the distribution of opening and
loose motion for each ratio of driving force to friction, and for each press of gravity, that
explains these fits best. Seats without gravity are measured on arms of their own.

Usage: python scripts/agents/measure_opening.py [--arms vera planar3] [--pressed six_axis]
[--records 1200]
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from loose_agents.jobs import ProgressLine

import loose_env
from loose_env.arms import LinearArm
from loose_env.cli.command import command
from loose_env.diagnosis import (
    LOOSE,
    OPENINGS,
    PRESSES,
    RATIOS,
    SHUT,
    SensorFloor,
    fit_records,
    statistics_of,
    variants,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, StructuralLooseness, hypotheses
from loose_env.io import Count, plain, write_text
from loose_env.rig import SimulatedRig
from scripts.study import arm_named

TABLE = Path(loose_env.__file__).parent / "diagnosis" / "opening.json"
SLOTS = 32


@dataclass(frozen=True, kw_only=True)
class Found:
    """One record of one seat."""

    play: bool
    """True if the seat is the play of a joint."""
    ratio: float
    """Driving force over friction [1]."""
    press: float
    """Gravity over the sum of gravity and driving force [1]."""
    fit: np.ndarray
    """Log-likelihood over openings and loose motion at the true place."""


def fits_of(name: str, records: int, seed: int) -> list[Found]:
    """Simulate records and fit each at the true place."""
    arm = arm_named(name)
    linear, difficulty = LinearArm(arm), Difficulty()
    sampler = FaultSampler(linear, difficulty)
    rig = SimulatedRig(arm, slots=SLOTS)
    floor = SensorFloor.of(rig.sensors, arm.band)
    arms, weights = variants(linear, difficulty.mismatch.stiffness)
    found: list[Found] = []
    rng = np.random.default_rng([seed, sum(name.encode())])
    faulty = hypotheses(arm)[1:]
    with ProgressLine(records, unit="records") as line:
        while len(found) < records:
            trials = []
            for slot in range(SLOTS):
                fault = sampler.draw(rng, hypothesis=faulty[rng.integers(len(faulty))])
                rig.mount(slot, fault, difficulty.mismatch.draw(arm, rng))
                levels = np.zeros(arm.n)
                levels[rng.integers(arm.n)] = arm.levels[min(int(rng.integers(0, 5)), 2)]
                pose = arm.random_pose(rng)
                length = float(rng.choice([0.4, 1.2, 1.2]))
                excitation, _ = at_levels(linear.at(pose), levels, duration=length)
                if not any(excitation.excited):  # gravity takes all that the drive has
                    continue
                trials.append((slot, pose, excitation, rng.spawn(1)[0]))
            slots, *others = zip(*trials, strict=True)
            for slot, measurement in zip(slots, rig.measure_all(slots, *others), strict=True):
                fault = rig.plants[slot].fault
                assert isinstance(fault, (StructuralLooseness, Backlash))
                if measurement.failure is not None:
                    continue
                play = isinstance(fault, Backlash)
                axes = linear.slide_dofs.shape[1]
                direction = np.eye(axes)[:1] if play else np.array([fault.direction[:axes]])  # type: ignore[union-attr]
                place = arm.n + fault.joint - 1 if isinstance(fault, Backlash) else fault.link - 1
                record = statistics_of(measurement).several
                each = [
                    fit_records(
                        a.at_all(record.pose), record, direction, floor, difficulty.mismatch
                    )
                    for a in arms
                ]
                log = np.array([f.log[0, ..., place] for f in each]) + weights[:, None, None]
                total = np.logaddexp.reduce(log, axis=0)
                middle = each[len(each) // 2]
                force, load = float(middle.force[0, place]), float(middle.load[0, place])
                if force <= 0:  # driven by nothing, such as a slide across the arm's only motion
                    continue
                found.append(
                    Found(
                        play=play,
                        ratio=force / fault.friction,
                        press=load / (load + force),
                        fit=total - total.max(),
                    )
                )
            line.advance(min(len(found), records) - line.n, name)
    return found


def table_of(found: Sequence[Found], rounds: int = 15) -> np.ndarray:
    """Fit the page of seats without gravity (ratios, openings, loose motion)."""
    near = _near_ratio(found)
    table = _maximised(found, near, np.zeros((len(RATIOS), 0)), rounds)
    return _held(table.reshape(len(RATIOS), len(OPENINGS), len(LOOSE)))


def pressed_table_of(found: Sequence[Found], free: np.ndarray, rounds: int = 15) -> np.ndarray:
    """Fit all pages (presses, ratios, openings, loose motion); the first is ``free``."""
    position = np.interp([f.press for f in found], PRESSES, np.arange(len(PRESSES)))
    press = np.maximum(0, 1 - np.abs(position[:, None] - np.arange(len(PRESSES))))
    near = (press[:, :, None] * _near_ratio(found)[:, None]).reshape(len(found), -1)
    table = _maximised(found, near, free.reshape(len(RATIOS), -1), rounds)
    pages = table.reshape(len(PRESSES), len(RATIOS), len(OPENINGS), len(LOOSE))
    return np.stack([free, *(_held(page) for page in pages[1:])])


def _near_ratio(found: Sequence[Found]) -> np.ndarray:
    """Weight of each node of the ratio for each record (records, ratios)."""
    ratio = np.log([f.ratio for f in found]).clip(np.log(RATIOS[0]), np.log(RATIOS[-1]))
    width = np.log(RATIOS[1] / RATIOS[0])
    near = np.exp(-0.5 * ((ratio[:, None] - np.log(RATIOS)) / width) ** 2)
    return np.asarray(near / near.sum(1, keepdims=True))


def _maximised(
    found: Sequence[Found], near: np.ndarray, known: np.ndarray, rounds: int
) -> np.ndarray:
    """Maximise the expectation over the cells of every node; the first ones may be known."""
    likelihood = np.exp(np.array([f.fit for f in found])).reshape(len(found), -1)
    nodes, size = near.shape[1], likelihood.shape[1]
    table = np.full((nodes, size), 1 / size)
    kernel = np.array([0.2, 0.6, 0.2])
    for _ in range(rounds):
        if known.size:
            table[: len(known)] = known
        share = likelihood * (near @ table)
        share /= share.sum(1, keepdims=True)
        counts = (near.T @ share).reshape(nodes, len(OPENINGS), len(LOOSE))
        for axis in (1, 2):
            counts = np.apply_along_axis(np.convolve, axis, counts, kernel, "same")
        pages = counts.reshape(-1, len(RATIOS), size)
        # A little of the average keeps rare cells possible.
        average = pages.sum(1, keepdims=True) / np.maximum(pages.sum((1, 2), keepdims=True), 1e-9)
        pages = pages + 0.02 * pages.sum(2, keepdims=True) / size + average
        table = (pages / pages.sum(2, keepdims=True)).reshape(nodes, size)
    return table


def _held(page: np.ndarray) -> np.ndarray:
    """Shut the seats that friction holds: at four times the rms force, above Gaussian peaks."""
    held = RATIOS <= 0.25
    page[held] = 0.0
    page[held, SHUT, 0] = 1.0
    return page


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the measurement."""

    arms: tuple[str, ...] = ("vera", "planar3", "planar4", "planar6")
    """Arms without gravity."""
    pressed: tuple[str, ...] = ("six_axis", "planar3v", "planar5v", "scara")
    """Arms under gravity."""
    records: Count = 1200
    """Records for each arm, thrice with gravity."""
    seed: int = 2
    """Root of all draws."""
    out: Path = TABLE
    """File of the table; default: the shipped one."""


def measure(options: Options) -> None:
    """Measure and write the table with the configuration it depends on."""
    made = {"seed": options.seed, "version": loose_env.__version__}
    free = {"arms": [*options.arms], "records": options.records, **made}
    # There are five times as many pages of the table to fill.
    pressed = {"arms": [*options.pressed], "records": 3 * options.records, **made}
    without = [f for n in options.arms for f in fits_of(n, options.records, options.seed)]
    found = [f for n in options.pressed for f in fits_of(n, 3 * options.records, options.seed)]
    stored = {"made_by": "scripts/agents/measure_opening.py", "free": free, "pressed": pressed}
    for name, play in (("slide", False), ("hinge", True)):
        page = table_of([f for f in without if f.play is play])
        pages = pressed_table_of([f for f in found if f.play is play], page)
        stored[name] = plain(pages.tolist(), digits=3)
    write_text(options.out, json.dumps(stored) + "\n")
    print(f"wrote {options.out}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, with errors in one line."""
    command("measure_opening", __doc__, Options, measure, arguments)


if __name__ == "__main__":
    main()
