"""Directions of looseness in space: errors and coverage over hidden faults, as tables.

Every case is an arm with one loose link (slide), its own mismatch and a random pose. Each joint is
excited in turn at the level that `propose_excitation` proposes, once on the loose arm and once on
the same arm with its seat shut. From these records come the direction of the change of
transmission, against the healthy records and against the nominal model, with its 95 % region, and
the direction of lowest coherence.

Usage: python scripts/studies/directions.py [--arm six_axis] [--cases 1000] [--out out/directions]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis import (
    Proposal,
    StoppingRule,
    change_of_transmission,
    measure_direction,
    propose_excitation,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import LooseEnvError
from loose_env.faults import (
    DEFAULT_KINDS,
    CompoundLooseness,
    Fault,
    Healthy,
    StructuralLooseness,
    parts_of,
)
from loose_env.io import Count, NonNegativeCount
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.statistics import (
    acceleration_from_angle,
    axial_angle_between,
    bandpass,
    change_direction,
    change_rank,
    covariances,
    lowest_coherence_of_records,
)
from loose_env.typing import Array
from scripts.study_parts.arms import arm_named, seat_in_tool
from scripts.study_parts.direction_tables import GAPS, WANTED, show

ARMS = ("cylindrical", "planar", "planar-vertical", "scara", "six_axis", "vera")
SLOTS = 48


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arm: str = option("six_axis", "arm under test", choices=ARMS)
    cases: Count = option(1000, "hidden faults")
    further: Count = option(150, "healthy arms, and arms with two slides")
    timed: NonNegativeCount = option(40, "arms for the stopping rule; 0: none")
    seed: int = option(2024, "root of all draws")


def estimate(linear: LinearArm, records: Any, healthy: Any, truth: Array) -> dict[str, Any]:
    """Direction from some records.

    Its angle to the truth and the half angle of its 95 % region [deg], whether the region holds the
    truth, the measured change over the transmission [1], and the number of directions in it.
    """
    change = change_of_transmission(linear, records, healthy=healthy)
    found = change_direction(change.estimate)
    return {
        "error": float(np.degrees(axial_angle_between(found.direction, truth))),
        "half_angle": float(np.degrees(found.half_angle)),
        "inside": bool(found.contains(truth)),
        "ratio": change.ratio,
        "rank": int(change_rank(change.estimate).rank),
    }


def lowest_error(records: Sequence[Measurement], truth: Array) -> float:
    """Angle from the direction of lowest coherence over all records to the truth [deg]."""
    covs = []
    for record in records:
        on = np.flatnonzero(record.excited)
        band = record.excitation.band
        joint = acceleration_from_angle(record.encoder[on], record.rate, band)
        covs.append(covariances(joint, bandpass(record.tool, record.rate, band)))
    lowest = lowest_coherence_of_records(covs).direction
    return float(np.degrees(axial_angle_between(lowest, truth)))


@cache
def bench(name: str) -> tuple[LinearArm, SimulatedRig]:
    """An arm, and a rig for loose and healthy arms side by side."""
    arm = arm_named(name)
    return LinearArm(arm), SimulatedRig(arm, slots=2 * SLOTS)


def draw_case(
    linear: LinearArm, seed: int, case: int, kind: str
) -> tuple[Fault, Any, Array, Proposal]:
    """Fault, mismatch, pose and proposal of one case, from its own stream."""
    arm = linear.arm
    kinds = (*DEFAULT_KINDS, kind) if kind not in DEFAULT_KINDS else DEFAULT_KINDS
    sampler = FaultSampler(linear, Difficulty(gap=GAPS), kinds)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 0)))
    fault = sampler.draw(rng, hypothesis=f"{kind}@link{1 + case % arm.n}")
    mismatch = Mismatch().draw(arm, rng)
    pose = arm.random_pose(rng)
    return fault, mismatch, pose, propose_excitation(arm, pose)


Case = tuple[int, Fault, Array, list[Measurement], list[Measurement]]


def measured_cases(name: str, start: int, stop: int, seed: int, kind: str) -> Iterator[Case]:
    """Measure each joint in turn on every loose arm and on the same arm when healthy."""
    linear, rig = bench(name)
    chosen = [(case, *draw_case(linear, seed, case, kind)) for case in range(start, stop)]
    for i, (_, fault, mismatch, _, _) in enumerate(chosen):
        rig.mount(2 * i, fault, mismatch)
        rig.mount(2 * i + 1, Healthy(), mismatch)
    taken: dict[int, list[Measurement]] = {slot: [] for slot in range(2 * len(chosen))}
    for j in range(linear.arm.n):
        jobs = []
        for i, (case, _, _, pose, proposal) in enumerate(chosen):
            shake = proposal.excitations[j]
            for k in range(2) if shake is not None else ():
                stream = np.random.SeedSequence(seed, spawn_key=(case, 1, j, k))
                rng = np.random.default_rng(stream)
                jobs.append(Job(slot=2 * i + k, pose=pose, excitation=shake, rng=rng))  # type: ignore[arg-type]
        for job, measured in zip(jobs, rig.measure_many(jobs), strict=True):
            taken[job.slot].append(measured)
    for i, (case, fault, _, pose, _) in enumerate(chosen):
        # A simulation that diverged takes its healthy counterpart with it.
        pairs = zip(taken[2 * i], taken[2 * i + 1], strict=True)
        whole = [(a, b) for a, b in pairs if not (a.failure or b.failure)]
        if whole:
            yield case, fault, pose, [a for a, _ in whole], [b for _, b in whole]


def slide_row(linear: LinearArm, seed: int, measured: Case) -> Row | None:
    """Evaluate one case of a slide; None if nothing moved.

    ``gravity`` acts along the seat [g]; ``ratio`` is the change of transmission against healthy
    records over the transmission (Frobenius) [1], ``best_ratio`` that of the joint that shows most;
    estimates are from all joints in turn or from a ``single`` random one, against healthy records
    or against the nominal model; ``lowest`` is the angle from the direction of lowest coherence to
    the truth [deg].
    """
    case, fault, pose, loose, healthy = measured
    assert isinstance(fault, StructuralLooseness)
    truth, gravity = seat_in_tool(linear.arm, pose, fault)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 2)))
    one = int(rng.integers(len(loose)))
    try:
        change = change_of_transmission(linear, loose, healthy=healthy)
        return {
            "case": case,
            "link": fault.link,
            "gap": fault.gap,
            "friction": fault.friction,
            "gravity": gravity,
            "ratio": change.ratio,
            "best_ratio": float(change.column_ratios.max()),
            "healthy": estimate(linear, loose, healthy, truth),
            "nominal": estimate(linear, loose, None, truth),
            "single_healthy": estimate(linear, [loose[one]], [healthy[one]], truth),
            "single_nominal": estimate(linear, [loose[one]], None, truth),
            "lowest": lowest_error(loose, truth),
        }
    except LooseEnvError as error:
        print(f"\ncase {case}: {error}", file=sys.stderr)
        return None


def two_slides_row(linear: LinearArm, measured: Case) -> Row | None:
    """Ranks found where a link slides in two directions; None for a slide and a rocking seat.

    ``moves``: whether both directions carry a change of 0.03 of the transmission.
    """
    _, fault, _, loose, healthy = measured
    assert isinstance(fault, CompoundLooseness)
    if not all(isinstance(part, StructuralLooseness) for part in parts_of(fault)):
        return None
    against_healthy = change_of_transmission(linear, loose, healthy=healthy)
    second = np.linalg.svd(against_healthy.estimate.b, compute_uv=False)[1]
    nominal = change_of_transmission(linear, loose)
    return {
        "moves": bool(second > 0.03 * np.linalg.norm(against_healthy.reference)),
        "rank_healthy": int(change_rank(against_healthy.estimate).rank),
        "rank_nominal": int(change_rank(nominal.estimate).rank),
    }


def stopping_row(linear: LinearArm, seed: int, case: int, wanted: float) -> Row:
    """Measure one arm until the half angle of the direction is small enough [deg]."""
    fault, mismatch, pose, proposal = draw_case(linear, seed + 1, case, "structural_looseness")
    assert isinstance(fault, StructuralLooseness)
    rig = bench_of_one(linear)
    rig.mount(0, fault, mismatch)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 3)))
    result = measure_direction(
        lambda shake: rig.measure(pose, shake, rng=rng),
        linear,
        [shake for shake in proposal.excitations if shake is not None],
        rule=StoppingRule(half_angle=float(np.radians(wanted))),
    )
    truth, _ = seat_in_tool(linear.arm, pose, fault)
    return {
        "wanted": wanted,
        "ending": result.ending.name,
        "seconds": result.seconds,
        "error": float(np.degrees(axial_angle_between(result.direction.direction, truth))),
        "inside": bool(result.direction.contains(truth)),
    }


@cache
def bench_of_one(linear: LinearArm) -> SimulatedRig:
    """A rig for one arm."""
    return SimulatedRig(linear.arm)


Part = tuple[str, float]
"""Part of the study, and its first case or the half angle that is wanted [deg]."""


def parts(settings: Settings, run: StudyRun) -> list[Part]:
    """All parts, in batches of arms."""
    counts = {
        "slide": settings.cases,
        "healthy": settings.further,
        "two slides": settings.further,
    }
    found: list[Part] = [(p, k) for p, count in counts.items() for k in range(0, count, SLOTS)]
    return found + [("stopping", wanted) for wanted in WANTED if settings.timed]


def work(case: Part, *, settings: Settings, run: StudyRun, say: Callable[[str], None]) -> list[Row]:
    """Rows of one batch of arms, or of one wanted half angle."""
    part, at = case
    linear, seed = bench(settings.arm)[0], settings.seed
    rows: list[Row | None]
    if part == "stopping":
        rows = [stopping_row(linear, seed, k, at) for k in range(settings.timed)]
    else:
        start, most = int(at), settings.cases if part == "slide" else settings.further
        seed += {"slide": 0, "healthy": 2, "two slides": 3}[part]
        kind = "compound_looseness" if part == "two slides" else "structural_looseness"
        measured = measured_cases(settings.arm, start, min(start + SLOTS, most), seed, kind)
        if part == "slide":
            rows = [slide_row(linear, seed, one) for one in measured]
        elif part == "two slides":
            rows = [two_slides_row(linear, one) for one in measured]
        else:
            changes = (change_of_transmission(linear, healthy) for *_, healthy in measured)
            rows = [{"rank": int(change_rank(change.estimate).rank)} for change in changes]
    return [{"part": part, "at": at} | row for row in rows if row is not None]


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    run=StudyRun,
    quick={"cases": 8, "further": 4, "timed": 2},
    file=lambda settings: f"{settings.arm}.json",
    folder="out/directions",
    unit="batches",
    cases=parts,
    work=work,
    case_of=lambda row: (row["part"], row["at"]),
    head=lambda settings: {"settings": settings, "gaps_m": GAPS},
    show=show,
    digits=8,
)
main = STUDY.main

if __name__ == "__main__":
    main()
