"""Measure how far seats open: the table that the posterior over faults ships with.

Faults are drawn, random joints are excited at random levels in random poses, and each record's
fit at the true place is kept. Expectation-maximisation finds the distribution of opening and
loose motion for each ratio of driving force to friction that explains these fits best.

Usage: python scripts/measure_opening.py [--arms vera planar3 planar4] [--records 1200]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import loose_env
from loose_env.arms import Arm, planar, vera
from loose_env.arms.linear import LinearArm
from loose_env.diagnosis.likelihood import LOOSE, OPENINGS, SHUT, fit_record
from loose_env.diagnosis.opening import RATIOS
from loose_env.diagnosis.posterior import variants
from loose_env.diagnosis.prediction import SensorFloor
from loose_env.diagnosis.record import statistics_of
from loose_env.envs.difficulty import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, StructuralLooseness, hypotheses
from loose_env.rig import Job, SimulatedRig

TABLE = Path(loose_env.__file__).parent / "diagnosis" / "opening.json"
SLOTS = 32


def arm_named(name: str) -> Arm:
    """Make an arm: vera, or planar with its number of links."""
    return vera() if name == "vera" else planar(int(name.removeprefix("planar")))


def fits_of(name: str, records: int, seed: int) -> list[tuple[bool, float, np.ndarray]]:
    """Simulate records; for each: whether play, force over friction, fit at the true place."""
    arm = arm_named(name)
    linear, difficulty = LinearArm(arm), Difficulty()
    sampler = FaultSampler(linear, difficulty)
    rig = SimulatedRig(arm, slots=SLOTS)
    floor = SensorFloor.of(rig.sensors, arm.band)
    arms, weights = variants(linear, difficulty.mismatch.stiffness)
    found: list[tuple[bool, float, np.ndarray]] = []
    rng = np.random.default_rng([seed, sum(name.encode())])
    faulty = hypotheses(arm)[1:]
    while len(found) < records:
        jobs = []
        for slot in range(SLOTS):
            fault = sampler.draw(rng, hypothesis=faulty[rng.integers(len(faulty))])
            rig.mount(slot, fault, difficulty.mismatch.draw(arm, rng))
            levels = np.zeros(arm.n)
            levels[rng.integers(arm.n)] = arm.levels[min(int(rng.integers(0, 5)), 2)]
            pose = arm.random_pose(rng)
            length = float(rng.choice([0.4, 1.2, 1.2]))
            excitation, _ = at_levels(linear.at(pose), levels, duration=length)
            jobs.append(Job(slot=slot, pose=pose, excitation=excitation, rng=rng.spawn(1)[0]))
        for job, measurement in zip(jobs, rig.measure_many(jobs), strict=True):
            fault = rig.plants[job.slot].fault
            assert isinstance(fault, (StructuralLooseness, Backlash))
            if measurement.failure is not None:
                continue
            play = isinstance(fault, Backlash)
            direction = np.array([[1.0, 0.0]] if play else [fault.direction[:2]])
            place = arm.n + fault.joint - 1 if isinstance(fault, Backlash) else fault.link - 1
            record = statistics_of(measurement)
            each = [fit_record(a, record, direction, floor, difficulty.mismatch) for a in arms]
            log = np.array([f.log[place] for f in each]) + weights[:, None, None]
            total = np.logaddexp.reduce(log, axis=0)
            force = float(each[len(each) // 2].force[place])
            found.append((play, force / fault.friction, total - total.max()))
        print(f"\r{name}: {len(found)} of {records}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return found


def table_of(found: Sequence[tuple[bool, float, np.ndarray]], rounds: int = 15) -> np.ndarray:
    """Fit the table (ratios, openings, loose motion) by expectation-maximisation."""
    likelihood = np.exp(np.array([f[2] for f in found])).reshape(len(found), -1)
    ratio = np.log([f[1] for f in found]).clip(np.log(RATIOS[0]), np.log(RATIOS[-1]))
    width = np.log(RATIOS[1] / RATIOS[0])
    near = np.exp(-0.5 * ((ratio[:, None] - np.log(RATIOS)) / width) ** 2)
    near /= near.sum(1, keepdims=True)
    size = likelihood.shape[1]
    table = np.full((len(RATIOS), size), 1 / size)
    kernel = np.array([0.2, 0.6, 0.2])
    for _ in range(rounds):
        share = likelihood * (near @ table)
        share /= share.sum(1, keepdims=True)
        counts = (near.T @ share).reshape(len(RATIOS), len(OPENINGS), len(LOOSE))
        for axis in (1, 2):
            counts = np.apply_along_axis(np.convolve, axis, counts, kernel, "same")
        counts = counts.reshape(table.shape)
        # A little of the average keeps rare cells possible.
        counts += 0.02 * counts.sum(1, keepdims=True) / size + counts.sum(0) / counts.sum()
        table = counts / counts.sum(1, keepdims=True)
    table = table.reshape(len(RATIOS), len(OPENINGS), len(LOOSE))
    # Friction of four times the rms force or more holds a seat: Gaussian peaks do not reach it.
    held = RATIOS <= 0.25
    table[held] = 0.0
    table[held, SHUT, 0] = 1.0
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write the table with the configuration it depends on."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", nargs="*", default=["vera", "planar3", "planar4", "planar6"])
    parser.add_argument("--records", type=int, default=1200, help="records for each arm")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--out", type=Path, default=TABLE)
    options = parser.parse_args(arguments)
    found = [f for name in options.arms for f in fits_of(name, options.records, options.seed)]
    stored = {
        "made_by": "scripts/measure_opening.py",
        "arms": options.arms,
        "records": options.records,
        "seed": options.seed,
        "version": loose_env.__version__,
    }
    for name, play in (("slide", False), ("hinge", True)):
        table = table_of([f for f in found if f[0] is play])
        stored[name] = [[[float(f"{v:.3g}") for v in row] for row in page] for page in table]
    beside = options.out.with_suffix(".part")
    beside.write_text(json.dumps(stored) + "\n")
    beside.replace(options.out)
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
