"""Directions of looseness in space: errors and coverage over hidden faults, as tables.

Every case is an arm with one loose link (slide), its own mismatch and a random pose. Each joint is
excited in turn at the level that `propose_excitation` proposes, once on the loose arm and once on
the same arm with its seat shut. From these records come the direction of the change of
transmission, against the healthy records and against the nominal model, with its 95 % region, and
the direction of lowest coherence.

Usage: python scripts/studies/directions.py [--arm six_axis] [--cases 1000] [--out out/directions]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import loose_env
from loose_env.arms import Arm, LinearArm, Mismatch, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    Ending,
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
from loose_env.report import study_head, write_study
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
from loose_env.thesis import cylindrical

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
    arm: Arm, sampler: FaultSampler, seed: int, case: int, kind: str = "structural_looseness"
) -> tuple[Fault, Any, Any, Proposal]:
    """Fault, mismatch, pose and proposal of one case, from its own stream."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 0)))
    fault = sampler.draw(rng, hypothesis=f"{kind}@link{1 + case % arm.n}")
    mismatch = Mismatch().draw(arm, rng)
    pose = arm.random_pose(rng)
    return fault, mismatch, pose, propose_excitation(arm, pose)


Case = tuple[int, Fault, Any, list[Measurement], list[Measurement]]


def measured_cases(arm: Arm, cases: int, seed: int, kind: str) -> Iterator[Case]:
    """Measure each joint in turn on every loose arm and on the same arm when sound."""
    kinds = (*DEFAULT_KINDS, kind) if kind not in DEFAULT_KINDS else DEFAULT_KINDS
    sampler = FaultSampler(LinearArm(arm), Difficulty(gap=GAPS), kinds)
    rig = SimulatedRig(arm, slots=2 * SLOTS)
    begin = time.perf_counter()
    for start in range(0, cases, SLOTS):
        chosen = [
            (case, *draw_case(arm, sampler, seed, case, kind))
            for case in range(start, min(start + SLOTS, cases))
        ]
        for i, (_, fault, mismatch, _, _) in enumerate(chosen):
            rig.mount(2 * i, fault, mismatch)
            rig.mount(2 * i + 1, Healthy(), mismatch)
        taken: dict[int, list[Measurement]] = {slot: [] for slot in range(2 * len(chosen))}
        for j in range(arm.n):
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
            sound = [(a, b) for a, b in pairs if not (a.failure or b.failure)]
            if sound:
                yield case, fault, pose, [a for a, _ in sound], [b for _, b in sound]
        spent = time.perf_counter() - begin
        done = min(start + SLOTS, cases)
        print(
            f"\r{kind}: {done}/{cases} cases, {spent:.0f} s, "
            f"{spent * (cases / done - 1):.0f} s to go  ",
            end="",
            file=sys.stderr,
            flush=True,
        )
    print(file=sys.stderr)


def study(arm: Arm, cases: int, seed: int) -> list[Row]:
    """Measure and evaluate all cases of a link that slides."""
    linear = LinearArm(arm)
    rows = []
    for case, fault, pose, loose, healthy in measured_cases(
        arm, cases, seed, "structural_looseness"
    ):
        assert isinstance(fault, StructuralLooseness)
        row = evaluate(linear, case, fault, pose, loose, healthy, seed)
        if row is not None:
            rows.append(row)
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
    """Work out one case; None if nothing moved."""
    truth, gravity = truth_in_tool_frame(linear.arm, pose, fault)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 2)))
    one = int(rng.integers(len(loose)))
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


def print_ranks(rows: Sequence[Row], healthy: Sequence[int], several: Sequence[Any]) -> None:
    """Print how many directions the change is found to have."""
    print(
        "\nDirections found in the change, share of cases\n\n"
        f"{'arm':44}{'change of':12}{'cases':>7}{'none':>8}{'one':>8}{'more':>8}"
    )

    def line(name: str, against: str, ranks: Sequence[int]) -> None:
        found = np.array(ranks)
        shares = [np.mean(found == 0), np.mean(found == 1), np.mean(found > 1)]
        text = "".join(f"{s:>8.0%}" for s in shares) if len(found) else ""
        print(f"{name:44}{against:12}{len(found):>7}{text}")

    line("healthy", "nominal", healthy)
    chosen: Sequence[Any]
    for name, low, high in (
        ("one slide, |dB|/|B| under 0.03", 0.0, 0.03),
        ("one slide, |dB|/|B| 0.03 to 0.3", 0.03, OPEN),
        ("one slide, |dB|/|B| over 0.3", OPEN, np.inf),
    ):
        chosen = [r for r in rows if low <= r.ratio < high]
        line(name, "healthy", [r.healthy.rank for r in chosen])
        line(name, "nominal", [r.nominal.rank for r in chosen])
    for against, rank in (("healthy", 1), ("nominal", 2)):
        line(
            "two slides, both change |dB|/|B| by 0.03", against, [s[rank] for s in several if s[0]]
        )


def several_directions(arm: Arm, cases: int, seed: int) -> list[tuple[bool, int, int]]:
    """Ranks found where a link slides in two directions.

    Whether both directions carry a change of 0.03 of the transmission, and the rank against
    healthy records and against the nominal model.
    """
    linear = LinearArm(arm)
    found = []
    for _, fault, _, loose, healthy in measured_cases(arm, cases, seed, "compound_looseness"):
        assert isinstance(fault, CompoundLooseness)
        if not all(isinstance(part, StructuralLooseness) for part in parts_of(fault)):
            continue  # a slide and a rocking seat
        against_healthy = change_of_transmission(linear, loose, healthy=healthy)
        second = np.linalg.svd(against_healthy.estimate.b, compute_uv=False)[1]
        moves = bool(second > 0.03 * np.linalg.norm(against_healthy.reference))
        ranks = [
            change_rank(change.estimate).rank
            for change in (against_healthy, change_of_transmission(linear, loose))
        ]
        found.append((moves, ranks[0], ranks[1]))
    return found


def false_ranks(arm: Arm, cases: int, seed: int) -> list[int]:
    """Ranks found on sound arms against the nominal model."""
    linear = LinearArm(arm)
    return [
        change_rank(change_of_transmission(linear, healthy).estimate).rank
        for _, _, _, _, healthy in measured_cases(arm, cases, seed, "structural_looseness")
    ]


def print_stopping(arm: Arm, cases: int, seed: int) -> None:
    """Print what the stopping rule spends, for several wanted angles."""
    linear = LinearArm(arm)
    sampler = FaultSampler(linear, Difficulty(gap=GAPS))
    rig = SimulatedRig(arm)
    drawn = [draw_case(arm, sampler, seed + 1, case) for case in range(cases)]
    print(
        "\nMeasuring as long as the angle needs (each joint, up to 4.8 s, against the nominal "
        "model)\n\n"
        f"{'half angle wanted':>18}{'reached':>9}{'floor':>7}{'spent':>7}"
        f"{'s where reached':>17}{'error there':>13}{'inside':>8}"
    )
    for wanted in (20.0, 10.0, 5.0):
        found = []
        for case, (fault, mismatch, pose, proposal) in enumerate(drawn):
            assert isinstance(fault, StructuralLooseness)
            rig.mount(0, fault, mismatch)
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case, 3)))

            def measure(shake: Any, pose: Any = pose, rng: Any = rng) -> Measurement:
                return rig.measure(pose, shake, rng=rng)

            played = [shake for shake in proposal.excitations if shake is not None]
            rule = StoppingRule(half_angle=float(np.radians(wanted)))
            result = measure_direction(measure, linear, played, rule=rule)
            truth, _ = truth_in_tool_frame(arm, pose, fault)
            error = float(np.degrees(axial_angle_between(result.direction.direction, truth)))
            found.append((result.ending, result.seconds, error, result.direction.contains(truth)))
        done = [f for f in found if f[0] is Ending.REACHED]
        shares = [np.mean([f[0] is e for f in found]) for e in Ending]
        print(
            f"{wanted:>17.0f}°{shares[0]:>9.0%}{shares[1]:>7.0%}{shares[2]:>7.0%}"
            f"{np.median([f[1] for f in done]) if done else np.nan:>16.1f}s"
            f"{np.median([f[2] for f in done]) if done else np.nan:>12.1f}°"
            f"{np.mean([f[3] for f in done]) if done else np.nan:>8.0%}",
            flush=True,
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arm", default="six_axis", choices=sorted(ARMS), help="arm under test")
    parser.add_argument("--cases", type=int, default=1000, help="hidden faults")
    parser.add_argument(
        "--further", type=int, default=150, help="sound arms, and arms with two slides"
    )
    parser.add_argument("--timed", type=int, default=40, help="arms for the stopping rule")
    parser.add_argument("--seed", type=int, default=2024, help="root of all draws")
    parser.add_argument("--out", type=Path, default=Path("out/directions"), help="folder for rows")
    options = parser.parse_args(arguments)
    arm = ARMS[options.arm]()
    rows = study(arm, options.cases, options.seed)
    sound = false_ranks(arm, options.further, options.seed + 2)
    several = several_directions(arm, options.further, options.seed + 3)
    options.out.mkdir(parents=True, exist_ok=True)
    chosen = {key: value for key, value in vars(options).items() if key != "out"}
    head = study_head(
        "scripts/studies/directions.py", chosen, version=loose_env.__version__, gaps_m=GAPS
    )
    write_study(options.out / f"{options.arm}.json", head, [asdict(r) for r in rows])
    print(
        f"{options.arm}: {len(rows)} cases, gaps {1e3 * GAPS[0]:g} to {1e3 * GAPS[1]:g} mm, "
        f"seed {options.seed}\n"
    )
    print_errors(rows)
    print_coverage(rows)
    print_ranks(rows, sound, several)
    if options.timed:
        print_stopping(arm, options.timed, options.seed)


if __name__ == "__main__":
    main()
