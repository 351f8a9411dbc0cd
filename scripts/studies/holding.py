"""Find out when estimators of the direction fail as the holding modes come down.

The way in which an arm holds its joints is softened from far above the band of the
excitation to far below it, by position servos and by elastic gears. Hidden structural looseness
at random links, in random directions and poses, default sensors and mismatch: every joint is
excited in turn, once with the seat loose and once with it shut, and each estimator says along
which direction the link slides. The study keeps the angle to the truth. The estimators of the
last two columns ("lines") also name the link: what they say is kept as they find it and for the
true link, with how often they name it.

Rows are written as they are found; a study that was interrupted goes on where it stopped.

Usage: python scripts/studies/holding.py [--quick] [--arms planar3] [--out FOLDER]
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
from loose_env.arms import Arm, LinearArm, LinearPose, planar, servoed, six_axis, with_compliance
from loose_env.diagnosis import (
    DynamicDirection,
    RecordStatistics,
    SensorFloor,
    ToolFrames,
    direction_by_dynamics,
    predict,
    statistics_of,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.report import (
    rounded,
    stored_rows,
    study_head,
    write_study,
)
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.statistics import (
    Covariances,
    lowest_coherence_direction_from,
    transmission_change,
)
from loose_env.typing import Array
from scripts.study_parts.holding_tables import (
    ESTIMATORS,
    LINES,
    STIFF,
    draw_holding,
    print_holding,
)

ROOT = Path(__file__).resolve().parents[2]
ARMS: dict[str, Callable[[], Arm]] = {
    "planar3": lambda: planar(3),
    "planar3v": lambda: planar(3, vertical=True),
    "six_axis": six_axis,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is studied."""

    arms: tuple[str, ...] = tuple(ARMS)
    """Arms of the holding study."""
    modes: tuple[float, ...] = (300.0, 150.0, 100.0, 70.0, 30.0, 15.0)
    """Mode of each joint on its servo or its gear, all others held [Hz]."""
    stiffest_gear: float = 300.0
    """Modes above this one are left to servos: gears would need a shorter step [Hz]."""
    planar_cases: int = 18
    """Faults and poses for each way of holding a planar arm."""
    space_cases: int = 12
    """The same for the six-axis arm."""
    level: float = 3.0
    """Rms acceleration at the nominal tool, where the drive allows it [m/s²]."""
    gap: tuple[float, float] = (0.03e-3, 0.4e-3)
    """Range of the gaps, log-uniform [m]."""
    friction_ratio: tuple[float, float] = (0.02, 0.1)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
    tried: int = 32
    """Random poses of which each case takes the one with the least gravity along its seat."""
    duration: float = 1.2
    """Length of a record [s]."""
    seed: int = 0
    """Seed of faults, poses, arms and excitations."""


def quick(settings: Settings) -> Settings:
    """Return a rough look at the same."""
    return dataclasses.replace(
        settings,
        modes=(300.0, 100.0, 28.0),
        planar_cases=8,
        space_cases=4,
    )


# --- holding


def arm_held(name: str, hold: str, mode: float) -> Arm:
    """Make an arm with its joints on brakes, servos or gears of a mode [Hz]."""
    arm = ARMS[name]()
    if hold == STIFF:
        return arm
    return servoed(arm, mode_hz=mode) if hold == "servo" else with_compliance(arm, mode_hz=mode)


def seat_direction(arm: Arm, pose: Array, fault: StructuralLooseness) -> Array:
    """Direction of a slide in the tool frame of the nominal arm, unit vector (d,)."""
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(model, data)
    link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    along = (tool.T @ link @ np.array(fault.direction))[list(arm.axes)]
    return np.asarray(along / np.linalg.norm(along))


def angle_between(u: Array, v: Array) -> float:
    """Angle between two axes [deg], 0 to 90."""
    return float(np.degrees(np.arccos(np.clip(abs(float(u @ v)), 0.0, 1.0))))


def together(records: Sequence[RecordStatistics]) -> Covariances:
    """Covariances of records of one joint each, as of one record in which they take turns."""
    power = np.array([r.joint_rms[j] ** 2 for j, r in enumerate(records)])
    return Covariances(
        xx=np.diag(power),
        xa=np.array(
            [p * r.transmission[:, j] for j, (p, r) in enumerate(zip(power, records, strict=True))]
        ),
        aa=np.sum([r.tool_covariance for r in records], axis=0),
        count=0,
    )


def directions_of(
    at: LinearPose,
    loose: Sequence[RecordStatistics],
    healthy: Sequence[RecordStatistics],
    shakes: Sequence[Excitation],
    commands: Sequence[Sequence[Array]],
    floor: SensorFloor,
) -> tuple[dict[str, Array], float]:
    """What every estimator says from records of every joint in turn, and how open the seat is."""
    n = range(len(loose))
    models = [predict(at, shake, floor) for shake in shakes]
    by_encoder, by_command = (
        tuple(
            np.stack([getattr(r, name)[:, j] for j, r in enumerate(records)], axis=1)
            for records in (loose, healthy)
        )
        for name in ("transmission", "transmission_by_instrument")
    )
    predicted = np.concatenate([m.transmission for m in models], axis=1)
    instrument = np.concatenate([m.transmission_by_instrument for m in models], axis=1)
    played, played_healthy = (
        np.stack([played_transmission(at, j, command[j]) for j in n], axis=1)
        for command in commands
    )
    against = {
        "reference_encoder": by_encoder,
        "reference_command": by_command,
        # What the two records' different commands make of the resonances is taken off.
        "reference_played": (by_command[0] - played + played_healthy, by_command[1]),
        "kinematic_encoder": (by_encoder[0], at.kinematic),
        "kinematic_command": (by_command[0], at.kinematic),
        "dynamic_encoder": (by_encoder[0], predicted),
        "dynamic_command": (by_command[0], instrument),
        "dynamic_played": (by_command[0], played),
    }
    found = {name: transmission_change(b, other).direction for name, (b, other) in against.items()}
    found["lowest"] = lowest_coherence_direction_from(together(loose)).direction
    return found, transmission_change(*by_command).ratio


def played_transmission(at: LinearPose, joint: int, command: Array) -> Array:
    """What the nominal arm would transmit of the very command that was played [m] (d,).

    The record is one period of it, so its Fourier lines are all there is; `predict` takes their
    power as flat instead.
    """
    answer = at.response(np.arange(at.linear.arm.n) == joint)
    lines = np.abs(np.fft.rfft(command)) ** 2
    frequency = np.fft.rfftfreq(len(command), 1 / SensorSuite().rate)
    power = np.interp(answer.frequency, frequency, lines)
    x, a = answer.joint[:, joint, 0], answer.tool[:, :, 0]
    # The command as instrument, line by line.
    return np.asarray((power @ a).real / (power @ x).real)


def best_pose(linear: LinearArm, fault: StructuralLooseness, tried: int, rng: Any) -> Array:
    """Of random poses, the one with the least gravity along the seat [rad] (n,)."""
    slide = np.array(fault.direction)[: linear.slide_dofs.shape[1]]
    poses = [linear.arm.random_pose(rng) for _ in range(tried)]
    loads = [abs(float(slide @ linear.at(pose).seat_load[fault.link - 1])) for pose in poses]
    return poses[int(np.argmin(loads))]


def holding_row(
    settings: Settings, name: str, hold: str, mode: float, threads: int
) -> dict[str, Any]:
    """Measure all cases of one way of holding one arm."""
    arm = arm_held(name, hold, mode)
    # As many frequencies as a record has lines in the band.
    points = round(settings.duration * (arm.band[1] - arm.band[0])) + 1
    linear = LinearArm(arm, points=points)
    difficulty = Difficulty(gap=settings.gap, friction=settings.friction_ratio)
    sampler = FaultSampler(linear, difficulty)
    cases = settings.planar_cases if len(arm.axes) == 2 else settings.space_cases
    rig = SimulatedRig(arm, slots=2 * cases, threads=threads)
    floor = SensorFloor.of(rig.sensors, arm.band)
    poses, faults, share = [], [], []
    seeds = np.random.SeedSequence([settings.seed, len(arm.axes)]).spawn(cases)
    generators = [np.random.default_rng(s) for s in seeds]
    for k, rng in enumerate(generators):
        # The same draws for every way of holding.
        fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{1 + k % arm.n}")
        assert isinstance(fault, StructuralLooseness)
        draw = difficulty.mismatch.draw(arm.rigid or arm, rng)
        if arm.rigid is not None:
            draw = _with_gears(draw, arm, difficulty.mismatch.draw(arm, rng))
        faults.append(fault)
        poses.append(best_pose(linear, fault, settings.tried, rng))
        rig.mount(2 * k, fault, draw)
        rig.mount(2 * k + 1, Healthy(), draw)
    records: list[list[list[RecordStatistics | None]]] = [[[], []] for _ in range(cases)]
    shakes: list[list[Excitation]] = [[] for _ in range(cases)]
    measured: list[tuple[list[Measurement], list[Measurement]]] = [([], []) for _ in range(cases)]
    for j in range(arm.n):
        jobs = []
        for k, pose in enumerate(poses):
            levels = np.where(np.arange(arm.n) == j, settings.level, 0.0)
            shake, reached = at_levels(linear.at(pose), levels, duration=settings.duration)
            shakes[k].append(shake)
            share.append(float(reached[j]))
            for state in (0, 1):
                rng = np.random.default_rng([settings.seed, k, j, state])
                jobs.append(Job(slot=2 * k + state, pose=pose, excitation=shake, rng=rng))
        for job, measurement in zip(jobs, rig.measure_many(jobs), strict=True):
            usable = measurement.failure is None and job.excitation.excited[j]
            k, state = divmod(job.slot, 2)
            measured[k][state].append(measurement)
            records[k][state].append(statistics_of(measurement) if usable else None)
    errors: dict[str, list[float]] = {e: [] for e in ESTIMATORS}
    change: list[float] = []
    link_right: dict[str, list[bool]] = {e: [] for e in LINES}
    link_known: dict[str, list[float]] = {e: [] for e in LINES}
    evidence: dict[str, list[float]] = {e: [] for e in LINES}
    lost = 0
    for k in range(cases):
        loose, healthy = ([r for r in rows if r is not None] for rows in records[k])
        if len(loose) < arm.n or len(healthy) < arm.n:
            lost += 1
            continue
        truth = seat_direction(arm, poses[k], faults[k])
        at = linear.at(poses[k])
        commands = [[m.command[j] for j, m in enumerate(taken)] for taken in measured[k]]
        found, ratio = directions_of(at, loose, healthy, shakes[k], commands, floor)
        change.append(ratio)
        for e, compared in LINES.items():
            by_lines = direction_by_dynamics(
                linear, measured[k][0], healthy=measured[k][1] if compared else None
            )
            found[e] = by_lines.direction_in_tool
            right = f"structural_looseness@link{faults[k].link}"
            link_right[e].append(by_lines.location == right)
            link_known[e].append(angle_between(at_link(linear, poses[k], by_lines, right), truth))
            evidence[e].append(by_lines.evidence)
        for e in ESTIMATORS:
            errors[e].append(angle_between(found[e], truth))
    return {
        "arm": name,
        "hold": hold,
        "mode_hz": mode,
        "timestep": arm.timestep,
        "level_reached": float(np.median(share)),
        "lost": lost,
        "change": change,
        "errors": errors,
        "link_right": link_right,
        "errors_link_known": link_known,
        "evidence": evidence,
    }


def at_link(linear: LinearArm, pose: Array, found: DynamicDirection, place: str) -> Array:
    """Tool-frame direction that was found for one link, whichever fits best (d,)."""
    along = found.directions[found.locations.index(place)]
    link = int(place.rpartition("link")[2])
    return np.asarray(ToolFrames(linear.arm).images(pose)[0, link - 1] @ along)


def _with_gears(draw: Any, arm: Arm, geared: Any) -> Any:
    """Give a draw made for the rigid arm the entries of the gears from one made with them."""
    stiffness, damping = geared.stiffness.copy(), geared.damping.copy()
    rigid = arm.rigid
    assert rigid is not None
    for j in range(rigid.model.njnt):
        at = arm.model.joint(rigid.model.joint(j).name).id
        stiffness[at], damping[at] = draw.stiffness[j], draw.damping[j]
    return dataclasses.replace(draw, stiffness=stiffness, damping=damping)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print its tables, write its figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS), metavar="ARM")
    parser.add_argument("--cases", type=int, help="faults and poses for each way of holding")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0, help="simulation threads; 0: all")
    parser.add_argument("--quick", action="store_true", help="a rough look in a few minutes")
    parser.add_argument("--afresh", action="store_true", help="forget what an earlier run found")
    parser.add_argument("--out", type=Path, help="folder; default docs/figures, quick: out/")
    chosen = parser.parse_args(arguments)
    settings = Settings(arms=tuple(chosen.arms), seed=chosen.seed)
    settings = quick(settings) if chosen.quick else settings
    if chosen.cases is not None:
        if chosen.cases < 1:
            parser.error(f"cases must be 1 or more, got {chosen.cases}")
        settings = dataclasses.replace(
            settings, planar_cases=chosen.cases, space_cases=chosen.cases
        )
    folder: Path = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    folder.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - started:4.0f} s] {line}", file=sys.stderr, flush=True)

    document = study_head("scripts/studies/holding.py", settings, version=loose_env.__version__)
    path = folder / "holding_modes.json"
    rows = [] if chosen.afresh else stored_rows(path, document)
    done = {(r["arm"], r["hold"], r["mode_hz"]) for r in rows}
    plan = [(a, STIFF, 800.0) for a in settings.arms]
    plan += [(a, h, m) for a in settings.arms for h in ("servo", "gears") for m in settings.modes]
    plan = [p for p in plan if p[1] != "gears" or p[2] <= settings.stiffest_gear]
    for k, key in enumerate(plan):
        if key in done:
            continue
        report(f"{k + 1} of {len(plan)}: {key[0]}, {key[1]}, {key[2]:g} Hz")
        rows.append(rounded(holding_row(settings, *key, chosen.threads)))
        write_study(path, document, rows)
    draw_holding(rows, settings.arms, path.with_suffix(".png"))
    print_holding(rows)
    print(f"\npicture: {path.with_suffix('.png')}")
    report("done")


if __name__ == "__main__":
    main()
