"""Share of loose links found by pose: thesis equation (4.31) against predicted directions.

Part (a) gives every method directions with a known scatter, without simulation. Part (b) takes
them from simulated records of open seats: structural looseness with little friction, the default
sensors and mismatch, the nominal model as reference, all joints excited at the top level. Cases
whose seat does not open in the first poses are counted and left out. The bound is the accuracy of
guessing among links that no move can tell apart.

Usage: python scripts/studies/link_finding.py [--cases 300] [--arm six_axis ...] [--file arm.xml]
       [--quick]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import OmitArgPrefixes

from loose_env.arms import Arm, LinearArm, Mismatch, arm_from_file
from loose_env.cli.command import command, one_of
from loose_env.diagnosis import (
    ChangeModel,
    ChangeSighting,
    DirectionSighting,
    LinkFindingSettings,
    SensorFloor,
    ToolFrames,
    TurnSearch,
    candidate_poses,
    choose_move,
    choose_open_move,
    confusable_faults,
    fault_locations,
    link_posterior,
    predict,
    sight_change,
    statistics_of,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidData
from loose_env.excitation import at_levels
from loose_env.faults import StructuralLooseness
from loose_env.io import Count, NonNegativeCount
from loose_env.rig import Job, SimulatedRig
from loose_env.typing import Array
from scripts.study import ROOT, Row, arm_named, study_rows

ARMS = ("six_axis", "scara", "planar4", "planar6")
METHODS = ("4.31 outward", "4.31 bisection", "images one", "images all")
MOVES = np.radians(np.arange(-90.0, 91.0, 15.0))
SEEN = 1.8
"""Change over what errors leave from which a record counts as one of an open seat."""


SCATTERS = (2.0, 5.0, 10.0, 20.0)
"""Scatter of the directions of part (a) [deg]."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arm: tuple[Annotated[str, one_of(ARMS)], ...] = ARMS
    """Arms."""
    file: tuple[str, ...] = ()
    """More arms, MJCF or URDF files."""
    cases: NonNegativeCount = 300
    """Cases a scatter in part (a); 0: none."""
    records: NonNegativeCount = 96
    """Arms in part (b); 0: none."""
    poses: Count = 6
    """Poses, the first included."""
    tries: Count = 6
    """First poses until the seat opens."""
    seed: int = 0
    """Root of all draws."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run of the study; no row depends on it."""

    settings: OmitArgPrefixes[Settings] = field(default_factory=Settings)
    quick: bool = False
    """A rough look with few cases."""
    out: Path = ROOT / "out" / "link_finding.json"
    """File of the rows."""
    afresh: bool = False
    """Work out again what is stored."""


@dataclass
class Case:
    """One arm with one loose link, on its way through the poses."""

    frames: ToolFrames
    pose: Array
    rng: np.random.Generator
    scales: tuple[float, ...]
    sd: float
    sightings: list[DirectionSighting]
    search: TurnSearch
    joint: int | None = None
    linear: LinearArm | None = None
    """Says what gravity holds shut; None where directions come without simulation."""

    @classmethod
    def begun(
        cls, frames: ToolFrames, first: DirectionSighting, sd: float, rng: np.random.Generator,
        scales: tuple[float, ...], linear: LinearArm | None = None,
    ) -> Case:  # fmt: skip
        """A case after its first sighting."""
        search = TurnSearch.over(frames.arm.n)
        return cls(frames, first.pose, rng, scales, sd, [first], search, linear=linear)

    @property
    def prior(self) -> Array:
        """A slide at any link, no play."""
        n = self.frames.arm.n
        return np.concatenate([np.ones(n), np.zeros(n)])

    def next_pose(self, method: str) -> Array:
        """Where a method goes next; the same pose where it is done."""
        arm = self.frames.arm
        if method.startswith("images"):
            found = link_posterior(
                self.frames, self.sightings, prior=self.prior, scales=self.scales
            )
            where = candidate_poses(
                arm,
                self.pose,
                MOVES,
                joints="one" if method.endswith("one") else "all",
                sliding=self.frames.slides,
                most=192,
                rng=self.rng,
            )
            if self.linear is None:
                return np.asarray(where[choose_move(self.frames, found, where, sd=self.sd)[0][0]])
            return choose_open_move(
                self.frames, self.linear, found, where, sd=self.sd, level=arm.levels[-1]
            )
        rules = self.rules(method)
        reach = self._reach(self.pose)
        latest = self.sightings[-1]
        self.joint = self.search.joint(
            self.frames, latest, moves=MOVES, rules=rules, can_move=reach.max(axis=1) > 1e-6
        )
        pose = self.pose.copy()
        if self.joint is not None:
            choices = np.argsort(-reach[self.joint - 1], kind="stable")
            pose[self.joint - 1] += MOVES[choices[self.search.tries % len(MOVES)]]
        return pose

    def take(self, method: str, seen: DirectionSighting, visible: bool) -> None:
        """Take in what was seen in the new pose."""
        if not method.startswith("images"):
            before = self.sightings[-1]
            if self.joint is not None and bool(
                np.abs(np.delete(seen.pose - before.pose, self.joint - 1)).max(initial=0.0) <= 1e-6
            ):
                self.search = self.search.after(
                    self.frames,
                    before,
                    seen,
                    joint=self.joint,
                    rules=self.rules(method),
                    visible=visible,
                )
        if visible or method.startswith("images"):
            self.sightings.append(seen)
        self.pose = seen.pose

    def guess(self, method: str) -> int:
        """Link to name now."""
        if not method.startswith("images"):
            return self.search.link(self.rules(method))
        found = link_posterior(self.frames, self.sightings, prior=self.prior, scales=self.scales)
        # A fair draw among equals, or link 1 would be favoured before anything is known.
        best = np.flatnonzero(found.probabilities > found.probabilities.max() - 1e-9)
        return 1 + int(self.rng.choice(best))

    @staticmethod
    def rules(method: str) -> LinkFindingSettings:
        """Untuned thresholds of 4.31 in the method's order."""
        return LinkFindingSettings(order="bisection" if "bisection" in method else "outward")

    def _reach(self, pose: Array) -> Array:
        """How far each move of each joint would turn it, 0 where it leaves the range."""
        reach = np.abs(np.sin(np.tile(MOVES, (self.frames.arm.n, 1))))
        for j, limits in enumerate(self.frames.arm.joint_ranges):
            if limits is not None:
                there = pose[j] + MOVES
                reach[j] *= (there >= limits[0]) & (there <= limits[1])
        return np.where(self.frames.slides[:, None], 0.0, reach)


def scattered(true: Array, sd: float, rng: np.random.Generator) -> Array:
    """Turn an axis by normal angles across it."""
    across = np.linalg.svd(true[None])[2][1:]
    angles = sd * rng.standard_normal(len(across))
    size = float(np.linalg.norm(angles))
    if size == 0:
        return true
    return np.asarray(np.cos(size) * true + np.sin(size) * (angles / size) @ across)


def by_scatter(frames: ToolFrames, sd: float, cases: int, poses: int, seed: int) -> Array:
    """Share of right links (methods, poses) for directions of known scatter."""
    right = np.zeros((len(METHODS), poses))
    for k in range(cases):
        for m, method in enumerate(METHODS):
            # The same link, direction and first pose for every method.
            rng = np.random.default_rng(np.random.SeedSequence([seed, k]))
            link = 1 + int(rng.integers(frames.arm.n))
            z = rng.standard_normal(frames.dimension)
            z /= np.linalg.norm(z)

            def seen(
                pose: Array,
                link: int = link,
                z: Array = z,
                rng: np.random.Generator = rng,
            ) -> DirectionSighting:
                true = frames.images(pose)[0, link - 1] @ z
                return DirectionSighting.of(pose, scattered(true, sd, rng), sd)

            case = Case.begun(frames, seen(frames.arm.random_pose(rng)), sd, rng, (1.0,))
            for t in range(poses):
                if t > 0:
                    case.take(method, seen(case.next_pose(method)), True)
                right[m, t] += case.guess(method) == link
    return right / cases


class Bench:
    """Simulated arms of one kind, each with one loose link, measured side by side."""

    def __init__(self, arm: Arm, cases: int, seed: int) -> None:
        self.arm, self.seed = arm, seed
        self.rig = SimulatedRig(arm, slots=cases, threads=1)
        self.frames = ToolFrames(arm)
        self.floor = SensorFloor.of(self.rig.sensors, arm.band)
        self.model = ChangeModel.of(Mismatch(), joints=arm.n)
        sampler = FaultSampler(self.rig.nominal, Difficulty(friction=(0.02, 0.1)))
        self.links: list[int] = []
        self.directions: list[Array] = []
        for k in range(cases):
            rng = np.random.default_rng(np.random.SeedSequence([seed, k]))
            fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{1 + k % arm.n}")
            assert isinstance(fault, StructuralLooseness)
            self.links.append(fault.link)
            self.directions.append(np.array(fault.direction)[: self.frames.dimension])
            self.rig.mount(k, fault, Mismatch().draw(arm, rng))

    def look(self, poses: dict[int, Array], round_number: int) -> dict[int, ChangeSighting]:
        """Measure several arms, all joints at the top level; a failed record is left out."""
        jobs, nominal = [], {}
        for k, pose in poses.items():
            at = self.rig.nominal.at(pose)
            levels = np.full(self.arm.n, self.arm.levels[-1])
            excitation, _ = at_levels(at, levels, duration=1.2)
            key = np.random.SeedSequence([self.seed, k, 1 + round_number])
            rng = np.random.default_rng(key)
            jobs.append(Job(slot=k, pose=pose, excitation=excitation, rng=rng))
            nominal[k] = predict(at, excitation, self.floor)
        found = {}
        for job, measurement in zip(jobs, self.rig.measure_many(jobs), strict=True):
            if measurement.failure is not None:
                continue
            try:
                record = statistics_of(measurement)
            except InvalidData:
                continue
            sighting = sight_change(
                record,
                nominal[job.slot],
                band=self.arm.band,
                floor=self.floor,
                model=self.model,
            )
            # Encoder zeros differ from case to case, the commanded pose does not.
            found[job.slot] = replace(sighting, pose=job.pose)
        return found

    def first_looks(self, tries: int) -> dict[int, ChangeSighting]:
        """Random poses until the seat opens: the first record of every case in which it does."""
        found: dict[int, ChangeSighting] = {}
        for t in range(tries):
            missing = [k for k in range(self.rig.slots) if k not in found]
            poses = {}
            for k in missing:
                key = np.random.SeedSequence([self.seed, k, 1000 + t])
                poses[k] = self.arm.random_pose(np.random.default_rng(key))
            seen = self.look(poses, 100 + t) if poses else {}
            found |= {k: s for k, s in seen.items() if visible(s)}
        return found


def visible(seen: ChangeSighting) -> bool:
    """Whether a record shows an open seat."""
    return seen.excess >= SEEN and bool(np.trace(seen.precision) > 0)


def by_simulation(
    arm: Arm, cases: int, poses: int, tries: int, seed: int
) -> tuple[Array, float, float]:
    """Share of right links (methods, poses), share of seats that opened, median error [deg]."""
    bench = Bench(arm, cases, seed)
    frames, first = bench.frames, bench.first_looks(tries)
    right = np.zeros((len(METHODS), poses))
    errors = []
    for m, method in enumerate(METHODS):
        active: dict[int, Case] = {}
        for k, seen in first.items():
            rng = np.random.default_rng(np.random.SeedSequence([seed, k, 2000]))
            sd = float(np.sqrt((frames.dimension - 1) / np.trace(seen.precision)))
            scales = (1.0, 2.0, 4.0)
            active[k] = Case.begun(frames, seen, sd, rng, scales, bench.rig.nominal)
        for t in range(poses):
            if t > 0:
                seen_now = bench.look({k: c.next_pose(method) for k, c in active.items()}, t)
                for k, seen in seen_now.items():
                    active[k].take(method, seen, visible(seen))
                    true = frames.images(seen.pose)[0, bench.links[k] - 1] @ bench.directions[k]
                    if visible(seen):
                        errors.append(np.arccos(min(1.0, abs(float(true @ seen.direction)))))
            right[m, t] = np.mean([c.guess(method) == bench.links[k] for k, c in active.items()])
    return right, len(first) / cases, float(np.degrees(np.median(errors)))


def bound(frames: ToolFrames, draws: int, seed: int) -> float:
    """Share that is right at best: links which no move can tell apart are guessed among."""
    names = fault_locations(frames.arm)[: frames.arm.n]
    rng = np.random.default_rng(seed)
    shares = []
    for k in range(draws):
        z = rng.standard_normal(frames.dimension)
        alike = confusable_faults(frames, names[k % len(names)], z)
        shares.append(1 / len(set(alike) & set(names)))
    return float(np.mean(shares))


def work(case: tuple[str, str, float], *, settings: Settings) -> list[Row]:
    """Accuracy by method and pose of one part, or its bound."""
    name, part, scatter = case
    arm = arm_from_file(Path(name)) if name in settings.file else arm_named(name)
    frames, seed = ToolFrames(arm), settings.seed
    row: Row = {"name": arm.name}
    if part == "bound":
        row |= {"bound": bound(frames, 120, seed)}
    elif part == "scatter":
        right = by_scatter(frames, np.radians(scatter), settings.cases, settings.poses, seed)
        row |= {"right": right.tolist()}
    else:
        number = [*settings.arm, *settings.file].index(name)
        right, opened, error = by_simulation(
            arm, settings.records, settings.poses, settings.tries, seed + number
        )
        row |= {"right": right.tolist(), "opened": opened, "error": error}
    return [{"arm": name, "part": part, "scatter": scatter} | row]


def cases_of(settings: Settings) -> list[tuple[str, str, float]]:
    """For each arm its bound, part (a) by scatter, and part (b)."""
    parts = [("bound", 0.0)]
    parts += [("scatter", sd) for sd in SCATTERS if settings.cases]
    parts += [("simulated", 0.0)] if settings.records else []
    return [(name, *part) for name in (*settings.arm, *settings.file) for part in parts]


def show(rows: list[Row], settings: Settings) -> None:
    """Print a table for each arm and part."""
    for row in rows:
        if row["part"] == "bound":
            print(f"{row['name']}: at best {100 * row['bound']:.0f} % right by direction")
            continue
        title = f" (a) scatter {row['scatter']:g} degrees, {settings.cases} cases; right in %"
        if row["part"] == "simulated":
            title = (
                f" (b) simulated, {100 * row['opened']:.0f} % of {settings.records} seats opened, "
                f"median error {row['error']:.1f} degrees; right in %"
            )
        print(title)
        print("  poses              " + "".join(f"{t + 1:>6}" for t in range(settings.poses)))
        for method, shares in zip(METHODS, row["right"], strict=True):
            print(f"  {method:<18} " + "".join(f"{100 * share:6.0f}" for share in shares))


def find(options: Options) -> None:
    """Work out what is missing, and print the tables."""
    settings = options.settings
    if options.quick:
        settings = replace(settings, cases=4, records=4, poses=3, tries=2)
    rows = study_rows(
        options.out,
        cases_of(settings),
        work,
        lambda row: (row["arm"], row["part"], row["scatter"]),
        script="scripts/studies/link_finding.py",
        settings=settings,
        unit="parts",
        digits=8,
        afresh=options.afresh,
    )
    show(rows, settings)


def main(arguments: Sequence[str] | None = None) -> None:
    """Find links, with errors in one line."""
    going_on = "the same command goes on"
    command("link_finding", __doc__, Options, find, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
