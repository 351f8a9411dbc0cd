"""Study how many accelerometers a diagnosis needs, and where (thesis 8.3.3, 8.3.4).

Faults slide in a link's seat along a random direction, with little friction; every joint is
excited in turn in one random pose, on the same arm healthy and then with gaps from 0.003 to
0.4 mm. All sets of sensors are read from the same records: the tool's accelerometer alone, with
accelerometers on one link after the other, and with a single axis on each link along the tangent
of its own joint's motion. Each set says how surely a fault is there, which link has it and along
what it slides, against the same arm's healthy records and against the nominal arm.

The smallest detectable gap is where half (or 90 %) of the faults pass a threshold that 5 % of the
healthy arms pass. A healthy arm has the same seat with the same stops and the same friction, and
no gap: nothing but the gap can then be found. The nominal arm knows no such seat and takes the
give of its stops for a fault; so its threshold is also taken from arms whose seats are rigid.
Then it is the give that is found, whatever the gap.

Detection depends on friction and on the weight on a seat more than on the gap: friction is small
here, and the level is the arm's top one. Of several levels the one that finds most counts for
each gap. Gaps below a micrometre are there to show where detection ends: real surfaces are
rougher.

Usage: python scripts/studies/sensors.py [--quick] [--arms vera planar4] [--levels 1 2]
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun
from scipy.optimize import isotonic_regression
from scipy.special import logsumexp

from loose_env.arms import Arm, LinearArm
from loose_env.diagnosis import (
    SensedArm,
    SensorRows,
    SensorVerdict,
    StackedRecord,
    rows_of,
    splitting_order,
    stack,
    weigh_links,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy, StructuralLooseness
from loose_env.io import Count
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import axial_angle_between
from loose_env.typing import Array
from scripts.study_parts.arms import arm_named
from scripts.study_parts.sensor_tables import REFERENCES, draw, show

Records = Sequence[StackedRecord] | None
Score = tuple[float, bool, float, bool, float]
"""Log odds of a fault, whether the link is right, error of the direction [deg], whether that is
within two standard deviations, probability stated for the link named."""

ARMS = ("vera", "planar4", "planar4v", "six_axis", "scara")
GAPS = tuple(np.geomspace(0.0001e-3, 0.4e-3, 9).tolist())
"""Gaps that are tried [m]."""
KNOWN_FROM = 0.02e-3
"""Smallest gap of which directions and links are scored [m]: the least that arms are said to have.
"""
FALSE_ALARMS = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What a study depends on."""

    arms: tuple[str, ...] = option(ARMS, "arms under test", choices=ARMS, metavar="ARM")
    cases: Count = 24
    """True arms, each with a fault of its own, 2 or more; links take turns."""
    levels: tuple[int, ...] = (3,)
    """Levels of the arm, from 1, each simulated."""
    friction: tuple[float, float] = (0.02, 0.1)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
    duration: float = 0.6
    """Length of a record [s]; there is one for each joint."""
    gaps: tuple[float, ...] = GAPS
    """Gaps that are tried [m]."""
    seed: int = 0
    """Seed of arms, faults, poses and excitations."""

    def __post_init__(self) -> None:
        """Check cases and levels."""
        if self.cases < 2:
            raise InvalidSetting(f"cases must be 2 or more, got {self.cases}")
        for name in self.arms:
            most = len(arm_named(name).levels)
            if any(not 1 <= level <= most for level in self.levels):
                raise InvalidSetting(f"levels of {name} are 1 to {most}, got {self.levels}")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SensorSet:
    """One way to instrument an arm."""

    name: str
    family: str
    """"growing": the tool and some links; "tangential" and "links only" as they say."""
    rows: SensorRows
    sensors: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One true arm in one pose."""

    number: int
    link: int
    fault: StructuralLooseness
    pose: Array
    truth: Array
    """Sliding direction in the world of the nominal arm (3,)."""

    def with_gap(self, gap: float) -> StructuralLooseness:
        """Return the case's fault with another gap [m]; the arm is healthy with none."""
        return dataclasses.replace(self.fault, gap=gap)


def sensor_sets(arm: Arm) -> list[SensorSet]:
    """List the sets of sensors of an arm, few channels first within each family."""
    order = splitting_order(arm.n)
    every, tangents = LinkAccelerometers(), LinkAccelerometers(tangential=True)
    sets = [SensorSet(name="tool", family="growing", rows=rows_of(arm, None), sensors=1)]
    for count in range(1, arm.n + 1):
        links = tuple(sorted(order[:count]))
        sets.append(
            SensorSet(
                name=f"tool + link{'s' if count > 1 else ''} {', '.join(map(str, links))}",
                family="growing",
                rows=rows_of(arm, dataclasses.replace(every, links=links)),
                sensors=1 + count,
            )
        )
    for name, family, tool in (
        ("tool + all links, tangential", "tangential", True),
        ("all links, tangential, no tool", "links only", False),
    ):
        rows = rows_of(arm, tangents, tool=tool)
        sets.append(SensorSet(name=name, family=family, rows=rows, sensors=arm.n + tool))
    return sets


class Bench:
    """Simulates one arm and weighs its records with every set of sensors."""

    def __init__(self, name: str, settings: Settings, say: Callable[[str], None]) -> None:
        self.name, self.settings, self.say = name, settings, say
        self.arm = arm = arm_named(name)
        self.linear = LinearArm(arm)
        self.difficulty = Difficulty(friction=settings.friction)
        every = LinkAccelerometers()
        self.sensed = SensedArm(arm, links=every.on(arm), mismatch=self.difficulty.mismatch)
        self.full = rows_of(arm, every)
        self.sets = sensor_sets(arm)
        self.parts = [self.full.projection(s.rows) for s in self.sets]
        self.rig = SimulatedRig(
            arm, slots=settings.cases, sensors=SensorSuite(link_accelerometers=every)
        )
        self.index = ARMS.index(name)
        self.cases = self._draw()

    def _rng(self, *where: int) -> np.random.Generator:
        return np.random.default_rng(
            np.random.SeedSequence([self.settings.seed, self.index, *where])
        )

    def _draw(self) -> list[Case]:
        sampler = FaultSampler(self.linear, self.difficulty)
        cases = []
        for k in range(self.settings.cases):
            rng = self._rng(k)
            link = 1 + k % self.arm.n
            fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{link}")
            assert isinstance(fault, StructuralLooseness)
            pose = self.arm.random_pose(rng)
            turn = self.sensed.at(pose, [True] + [False] * (self.arm.n - 1)).orientation[link - 1]
            cases.append(
                Case(
                    number=k,
                    link=link,
                    fault=fault,
                    pose=pose,
                    truth=turn @ np.array(fault.direction),
                )
            )
        return cases

    def measure(self, level: int, kind: int, faults: Sequence[Fault]) -> list[Records]:
        """Records of all cases with these faults: a list of one for each joint, or None."""
        found: list[list[StackedRecord] | None] = [[] for _ in self.cases]
        for case, fault in zip(self.cases, faults, strict=True):
            self.rig.mount(
                case.number,
                fault,
                self.difficulty.mismatch.draw(self.arm, self._rng(case.number, 1)),
            )
        for joint in range(self.arm.n):
            jobs = []
            for case in self.cases:
                levels = np.zeros(self.arm.n)
                levels[joint] = self.arm.levels[level - 1]
                shake, _ = at_levels(
                    self.linear.at(case.pose), levels, duration=self.settings.duration
                )
                if shake.torque_rms[joint] > 0:  # else the joint's weight takes all its torque
                    rng = self._rng(case.number, 2, level, kind, joint)
                    jobs.append(Job(slot=case.number, pose=case.pose, excitation=shake, rng=rng))
            for k, measurement in self.rig.measure_each(jobs):
                slot = jobs[k].slot
                so_far = found[slot]
                if measurement.failure is not None:
                    found[slot] = None
                elif so_far is not None:
                    so_far.append(stack(measurement, self.full))
        return list(found)

    def weigh(self, records: Records, reference: Records) -> list[list[SensorVerdict]]:
        """Verdicts of every set of sensors with either reference; empty if a record failed."""
        if not records or not reference:
            return []
        verdicts = []
        for sensors, part in zip(self.sets, self.parts, strict=True):
            now = [r.projected(part) for r in records]
            before = [r.projected(part) for r in reference]
            verdicts.append(
                [
                    weigh_links(
                        self.sensed, sensors.rows, now, against, mismatch=self.difficulty.mismatch
                    )
                    for against in (before, None)
                ]
            )
        return verdicts

    def run(self) -> list[Row]:
        """Simulate and weigh; give a row for each set of sensors and reference."""
        shape = (len(self.settings.levels), len(self.sets), len(REFERENCES))
        healthy: dict[tuple[int, ...], list[float]] = {i: [] for i in np.ndindex(shape)}
        faulty: dict[tuple[int, ...], list[list[Score]]] = {
            i: [[] for _ in self.settings.gaps] for i in np.ndindex(shape)
        }
        for a, level in enumerate(self.settings.levels):
            shut = [case.with_gap(0.0) for case in self.cases]
            reference = self.measure(level, 0, shut)
            for kind in (1, 2):  # two sets of healthy records, for a steadier threshold
                for before, now in zip(reference, self.measure(level, kind, shut), strict=True):
                    for s, pair in enumerate(self.weigh(now, before)):
                        for r, verdict in enumerate(pair):
                            healthy[a, s, r].append(verdict.odds)
            # Arms whose seats are rigid, for the nominal arm alone.
            for now in self.measure(level, 9, [Healthy()] * len(self.cases)):
                for s, pair in enumerate(self.weigh(now, now)):
                    healthy[a, s, 2].append(pair[1].odds)
            self.say(f"{self.name}: level {level}, healthy")
            for g, gap in enumerate(self.settings.gaps):
                faults = [case.with_gap(gap) for case in self.cases]
                measured = self.measure(level, 10 + g, faults)
                for case, before, now in zip(self.cases, reference, measured, strict=True):
                    for s, pair in enumerate(self.weigh(now, before)):
                        for r, verdict in enumerate([*pair, pair[1]]):
                            faulty[a, s, r][g].append(score(verdict, case))
                self.say(f"{self.name}: level {level}, gap {g + 1} of {len(self.settings.gaps)}")
        rows = []
        for s, sensors in enumerate(self.sets):
            for r, reference_name in enumerate(REFERENCES):
                levels = range(len(self.settings.levels))
                rows.append(
                    {
                        "arm": self.name,
                        "sensors": sensors.name,
                        "family": sensors.family,
                        "count": sensors.sensors,
                        "channels": len(sensors.rows),
                        "reference": reference_name,
                    }
                    | accuracy_of(
                        [healthy[a, s, r] for a in levels],
                        [faulty[a, s, r] for a in levels],
                        self.settings.gaps,
                    )
                )
        return rows


def score(verdict: SensorVerdict, case: Case) -> Score:
    """Compare a verdict with the truth; see `Score`."""
    k = verdict.link - 1
    angle = axial_angle_between(verdict.world[k], case.truth)
    said = float(np.exp(verdict.evidence[k] - logsumexp(verdict.evidence)))
    right, inside = verdict.link == case.link, angle <= 2 * float(verdict.spread[k])
    return verdict.odds, right, float(np.degrees(angle)), inside, said


def accuracy_of(
    healthy: Sequence[Sequence[float]],
    faulty: Sequence[Sequence[Sequence[Score]]],
    gaps: Sequence[float],
) -> dict[str, Any]:
    """Accuracy and detection from the odds of healthy arms and the scores of faulty ones.

    Both are given for each level, faulty arms for each gap too. The best level of a gap is that
    which detects most.
    """
    detected, threshold = np.zeros((len(healthy), len(gaps))), []
    for a, (sound, found) in enumerate(zip(healthy, faulty, strict=True)):
        threshold.append(float(np.quantile(sound, 1 - FALSE_ALARMS, method="higher")))
        for g, scores in enumerate(found):
            detected[a, g] = np.mean([s[0] > threshold[a] for s in scores])
    best = np.argmax(detected, axis=0)
    share = detected.max(axis=0)
    scored = [(a, s) for g, a in enumerate(best) if gaps[g] >= KNOWN_FROM for s in faulty[a][g]]
    named = [s for _, s in scored]
    caught = [s for a, s in scored if s[0] > threshold[a]]

    def of_caught(what: Callable[..., Any], column: int) -> float | None:
        return float(what([s[column] for s in caught])) if caught else None

    return {
        "healthy_cases": len(healthy[0]),
        "threshold": threshold,
        "detected": share.tolist(),
        "best_level": best.tolist(),
        "gap_half_mm": smallest_gap(share, 0.5, gaps),
        "gap_most_mm": smallest_gap(share, 0.9, gaps),
        "cases": len(named),
        "found": len(caught) / len(named),
        "link_right": float(np.mean([s[1] for s in named])),
        "link_right_found": of_caught(np.mean, 1),
        "direction_error": float(np.median([s[2] for s in named])),
        "direction_error_found": of_caught(np.median, 2),
        "link_said_found": of_caught(np.mean, 4),
        "within_two_sd": of_caught(np.mean, 3),
    }


def smallest_gap(share: Array, wanted: float, gaps: Sequence[float] = GAPS) -> float | None:
    """Gap at which a rising share of detections reaches what is wanted [mm].

    Shares are made to rise with the gap (isotonic regression) and joined by lines in its
    logarithm. The smallest gap tried stands for anything below it; None: not reached.
    """
    rising = isotonic_regression(share).x
    reached = np.flatnonzero(rising >= wanted)
    if len(reached) == 0:
        return None
    k = int(reached[0])
    if k == 0:
        return float(1e3 * gaps[0])
    part = (wanted - rising[k - 1]) / (rising[k] - rising[k - 1])
    return float(1e3 * np.exp((1 - part) * np.log(gaps[k - 1]) + part * np.log(gaps[k])))


def head(settings: Settings) -> Mapping[str, Any]:
    """What the rows rest on."""
    kept = dataclasses.asdict(settings)
    return {
        "settings": kept,
        "gaps_mm": (1e3 * np.array(kept.pop("gaps"))).tolist(),
        "scored_from_mm": 1e3 * KNOWN_FROM,
        "false_alarms": FALSE_ALARMS,
    }


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    run=StudyRun,
    quick={"cases": 4},
    file="sensors_number.json",
    unit="arms",
    cases=lambda settings, run: settings.arms,
    work=lambda arm, *, settings, run, say: Bench(arm, settings, say).run(),
    case_of=lambda row: row["arm"],
    head=head,
    show=show,
    draw=draw,
)
main = STUDY.main

if __name__ == "__main__":
    main()
