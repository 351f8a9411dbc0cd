"""Directions of looseness in space: errors and coverage over hidden faults, as tables.

Every case is an arm with one loose link (slide), its own mismatch and a random pose. Each joint is
excited in turn at the level that `propose_excitation` proposes, once on the loose arm and once on
the same arm with its seat shut. From these records come the direction of the change of
transmission, against the healthy records and against the nominal model, with its 95 % region, and
the direction of lowest coherence.

Usage: python scripts/study_directions.py [--arm six_axis] [--cases 1000] [--out out/directions]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.arms import Arm, cylindrical, planar, scara, six_axis, vera
from loose_env.arms.linear import LinearArm
from loose_env.arms.mismatch import Mismatch
from loose_env.diagnosis.proposal import Proposal, propose_excitation
from loose_env.diagnosis.transmission_change import change_of_transmission
from loose_env.envs.difficulty import Difficulty, FaultSampler
from loose_env.errors import LooseEnvError
from loose_env.faults import Healthy, StructuralLooseness
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

ARMS = {
    "six_axis": six_axis,
    "scara": scara,
    "planar": planar,
    "planar-vertical": lambda: planar(4, vertical=True),
    "vera": vera,
    "cylindrical": cylindrical,
}
GAPS = (0.03e-3, 0.4e-3)
OPEN = 0.3
SLOTS = 48


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One direction with its region."""

    error: float
    """Angle to the truth [deg]."""
    half_angle: float
    """Half angle of the 95 % region [deg]."""
    inside: bool
    """Whether the region holds the truth."""
    ratio: float
    """Size of the measured change over the transmission [1]."""
    rank: int
    """Number of directions found in the change."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One case."""

    case: int
    link: int
    gap: float
    friction: float
    gravity: float
    """Gravity along the seat [g]."""
    ratio: float
    """Change of transmission against healthy records, over transmission (Frobenius) [1]."""
    best_ratio: float
    """The same for the joint that shows most [1]."""
    healthy: Estimate
    """All joints in turn, against healthy records."""
    nominal: Estimate
    """All joints in turn, against the nominal model."""
    single_healthy: Estimate
    """One joint, a random one, against a healthy record."""
    single_nominal: Estimate
    """One joint, a random one, against the nominal model."""
    lowest: float
    """Angle from the direction of lowest coherence to the truth [deg]."""


def truth_in_tool_frame(arm: Arm, pose: Any, fault: StructuralLooseness) -> tuple[Any, float]:
    """Direction of a seat in the tool's measured axes, and gravity along it [g]."""
    model = arm.model
    data = mujoco.MjData(model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(model, data)
    link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    u = np.array(fault.direction) / np.linalg.norm(fault.direction)
    world = link @ u
    along = abs(float(world @ model.opt.gravity)) / 9.81
    return (tool.T @ world)[list(arm.axes)], along


def estimate(linear: LinearArm, records: Any, healthy: Any, truth: Any) -> Estimate:
    """Direction, region and rank from some records."""
    change = change_of_transmission(linear, records, healthy=healthy)
    found = change_direction(change.estimate)
    return Estimate(
        error=float(np.degrees(axial_angle_between(found.direction, truth))),
        half_angle=float(np.degrees(found.half_angle)),
        inside=found.contains(truth),
        ratio=change.ratio,
        rank=change_rank(change.estimate).rank,
    )


def lowest_error(records: Sequence[Measurement], truth: Any) -> float:
    """Angle from the direction of lowest coherence over all records to the truth [deg]."""
    covs = []
    for record in records:
        on = np.flatnonzero(record.excited)
        band = record.excitation.band
        joint = acceleration_from_angle(record.encoder[on], record.rate, band)
        covs.append(covariances(joint, bandpass(record.tool, record.rate, band)))
    lowest = lowest_coherence_of_records(covs).direction
    return float(np.degrees(axial_angle_between(lowest, truth)))


def draw_case(
    arm: Arm, sampler: FaultSampler, seed: int, case: int
) -> tuple[StructuralLooseness, Any, Any, Proposal]:
    """Fault, mismatch, pose and proposal of one case, from its own stream."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 0)))
    link = 1 + case % arm.n
    fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{link}")
    assert isinstance(fault, StructuralLooseness)
    mismatch = Mismatch().draw(arm, rng)
    pose = arm.random_pose(rng)
    return fault, mismatch, pose, propose_excitation(arm, pose)


def study(arm: Arm, cases: int, seed: int) -> list[Row]:
    """Measure and evaluate all cases."""
    linear = LinearArm(arm)
    sampler = FaultSampler(linear, Difficulty(gap=GAPS))
    rig = SimulatedRig(arm, slots=2 * SLOTS)
    rows: list[Row] = []
    begin = time.perf_counter()
    for start in range(0, cases, SLOTS):
        chosen = [
            (case, *draw_case(arm, sampler, seed, case))
            for case in range(start, min(start + SLOTS, cases))
        ]
        for i, (_, fault, mismatch, _, _) in enumerate(chosen):
            rig.mount(2 * i, fault, mismatch)
            rig.mount(2 * i + 1, Healthy(), mismatch)
        taken: dict[int, list[Measurement]] = {}
        for j in range(arm.n):
            jobs = []
            for i, (case, _, _, pose, proposal) in enumerate(chosen):
                shake = proposal.excitations[j]
                for k in range(2) if shake is not None else ():
                    stream = np.random.SeedSequence(seed, spawn_key=(case, 1, j, k))
                    rng = np.random.default_rng(stream)
                    jobs.append(Job(slot=2 * i + k, pose=pose, excitation=shake, rng=rng))
            for job, measured in zip(jobs, rig.measure_many(jobs), strict=True):
                taken.setdefault(job.slot, []).append(measured)
        for i, (case, fault, _, pose, _) in enumerate(chosen):
            row = evaluate(linear, case, fault, pose, taken[2 * i], taken[2 * i + 1], seed)
            if row is not None:
                rows.append(row)
        spent = time.perf_counter() - begin
        done = min(start + SLOTS, cases)
        print(
            f"\r{done}/{cases} cases, {spent:.0f} s, {spent * (cases / done - 1):.0f} s to go ",
            end="",
            file=sys.stderr,
            flush=True,
        )
    print(file=sys.stderr)
    return rows


def evaluate(
    linear: LinearArm,
    case: int,
    fault: StructuralLooseness,
    pose: Any,
    loose: list[Measurement],
    healthy: list[Measurement],
    seed: int,
) -> Row | None:
    """Work out one case; None if a simulation diverged or nothing moved."""
    pairs = [(a, b) for a, b in zip(loose, healthy, strict=True) if not (a.failure or b.failure)]
    if not pairs:
        return None
    loose, healthy = [p[0] for p in pairs], [p[1] for p in pairs]
    truth, gravity = truth_in_tool_frame(linear.arm, pose, fault)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 2)))
    one = int(rng.integers(len(pairs)))
    try:
        change = change_of_transmission(linear, loose, healthy=healthy)
        return Row(
            case=case,
            link=fault.link,
            gap=fault.gap,
            friction=fault.friction,
            gravity=gravity,
            ratio=change.ratio,
            best_ratio=float(change.column_ratios.max()),
            healthy=estimate(linear, loose, healthy, truth),
            nominal=estimate(linear, loose, None, truth),
            single_healthy=estimate(linear, [loose[one]], [healthy[one]], truth),
            single_nominal=estimate(linear, [loose[one]], None, truth),
            lowest=lowest_error(loose, truth),
        )
    except LooseEnvError as error:
        print(f"\ncase {case}: {error}", file=sys.stderr)
        return None


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):7.1f}" if len(values) else "      -"


def print_errors(rows: Sequence[Row]) -> None:
    """Print the table of median errors, binned by gravity along the seat and by |dB|/|B|."""
    print(
        "Median angle from the estimated direction to the true one [deg]\n\n"
        f"{'gravity along seat':20}{'|dB|/|B|':14}{'cases':>7}{'healthy ref.':>14}"
        f"{'nominal model':>15}{'lowest coherence':>18}"
    )
    gravities = ((0.0, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.01))
    ratios = ((0.0, 0.03), (0.03, 0.1), (0.1, 0.3), (0.3, np.inf))

    def line(name: str, ratio: str, chosen: list[Row]) -> None:
        print(
            f"{name:20}{ratio:14}{len(chosen):>7}"
            f"{_median([r.healthy.error for r in chosen]):>14}"
            f"{_median([r.nominal.error for r in chosen]):>15}"
            f"{_median([r.lowest for r in chosen]):>18}"
        )

    for g_low, g_high in gravities:
        for low, high in ratios:
            chosen = [r for r in rows if g_low <= r.gravity < g_high and low <= r.ratio < high]
            name = f"{g_low:g} to {min(g_high, 1):g} g"
            line(name, f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}", chosen)
    for low, high in ratios:
        chosen = [r for r in rows if low <= r.ratio < high]
        line("any", f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}", chosen)
    line("any", "one column 0.3", [r for r in rows if r.best_ratio >= OPEN])


def print_coverage(rows: Sequence[Row]) -> None:
    """Print how often the 95 % region holds the true direction."""
    print(
        "\nShare of 95 % regions that hold the true direction, and their median half angle\n\n"
        f"{'records':26}{'change of':12}{'cases':>7}{'coverage':>10}{'half angle':>12}"
        f"{'narrower than 30':>19}{'coverage':>10}{'half angle':>12}"
    )
    for name, field in (
        ("each joint in turn", "healthy"),
        ("each joint in turn", "nominal"),
        ("one joint", "single_healthy"),
        ("one joint", "single_nominal"),
    ):
        found = [getattr(r, field) for r in rows]
        sharp = [e for e in found if e.half_angle < 30.0]
        against = "healthy" if field.endswith("healthy") else "nominal"
        print(
            f"{name:26}{against:12}{len(found):>7}{np.mean([e.inside for e in found]):>10.1%}"
            f"{np.median([e.half_angle for e in found]):>11.1f}°{len(sharp):>19}"
            f"{np.mean([e.inside for e in sharp]) if sharp else np.nan:>10.1%}"
            f"{np.median([e.half_angle for e in sharp]) if sharp else np.nan:>11.1f}°"
        )


def print_ranks(rows: Sequence[Row]) -> None:
    """Print how many directions the change is found to have."""
    print("\nRank of the change: share of cases\n\n" + f"{'':26}{'none':>8}{'one':>8}{'more':>8}")
    for name, chosen in (
        ("|dB|/|B| under 0.03", [r for r in rows if r.ratio < 0.03]),
        ("|dB|/|B| 0.03 to 0.3", [r for r in rows if 0.03 <= r.ratio < OPEN]),
        ("|dB|/|B| over 0.3", [r for r in rows if r.ratio >= OPEN]),
    ):
        for against in ("healthy", "nominal"):
            ranks = np.array([getattr(r, against).rank for r in chosen])
            shares = [np.mean(ranks == 0), np.mean(ranks == 1), np.mean(ranks > 1)]
            if len(ranks):
                print(f"{name:20}{against:8}" + "".join(f"{s:>8.0%}" for s in shares))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arm", default="six_axis", choices=sorted(ARMS), help="arm under test")
    parser.add_argument("--cases", type=int, default=1000, help="hidden faults")
    parser.add_argument("--seed", type=int, default=2024, help="root of all draws")
    parser.add_argument("--out", type=Path, default=Path("out/directions"), help="folder for rows")
    options = parser.parse_args(arguments)
    rows = study(ARMS[options.arm](), options.cases, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    target = options.out / f"{options.arm}.json"
    content = {
        "configuration": {
            "arm": options.arm,
            "cases": options.cases,
            "seed": options.seed,
            "gaps_m": GAPS,
        },
        "rows": [asdict(r) for r in rows],
    }
    beside = target.with_suffix(".part")
    beside.write_text(json.dumps(content), encoding="utf-8")
    beside.replace(target)
    print(
        f"{options.arm}: {len(rows)} cases, gaps {1e3 * GAPS[0]:g} to {1e3 * GAPS[1]:g} mm, "
        f"seed {options.seed}\n"
    )
    print_errors(rows)
    print_coverage(rows)
    print_ranks(rows)


if __name__ == "__main__":
    main()
