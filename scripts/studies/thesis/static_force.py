"""The static-force method in space: link naming against jig stiffness and joint friction (8.1.2).

The tool of an arm under gravity stands in a jig that yields. The drives carry the nominal weight
and push slowly against it in a few random poses. The seat's motion is what is left of the joints'
motion at the tool after regression on the jig's force, or, without a force sensor, on the torques
of the drives. Every third arm is healthy; the others have a slide or play at a random place, with
gaps, friction and model errors as in the environments.

Usage: python scripts/studies/thesis/static_force.py [--arm six_axis] [--cases 36] [--poses 4]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from loose_agents.jobs import ProgressLine

from loose_env.arms import Arm, LinearArm, planar, scara, six_axis
from loose_env.cli.command import command
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import UnknownName
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Fault, Healthy, StructuralLooseness, hypotheses
from loose_env.io import Count, Positive
from loose_env.thesis import DockedVerdict, JigSettings, docked_verdict, measure_docked

ARMS = {"six_axis": six_axis, "scara": scara, "planar3": lambda: planar(3, vertical=True)}
STIFFNESS = (1e7, 1e6, 1e5)
"""Stiffness of the jig [N/m]."""
FRICTION = (0.0, 0.02, 0.05, 0.1)
"""Coulomb friction of the joints over their torque limits [1]."""
BAND = (1.0, 6.0)
"""Band of the push [Hz]: below the modes of arm and jig."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arm: str = "six_axis"
    """One of {list(ARMS)}."""
    cases: Count = 36
    """Arms at every stiffness and friction; every third is healthy."""
    poses: Count = 4
    """Poses to dock in."""
    push: Positive = 0.1
    """Rms torque over the torque limit of each drive."""
    seconds: Positive = 2.0
    """Length of a record [s]."""
    seed: int = 0
    """Root of all draws."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One arm, judged by the jig's force and by the drives' torques."""

    fault: Fault
    by_force: DockedVerdict
    by_torque: DockedVerdict


def case_of(arm: Arm, sampler: FaultSampler, number: int, jig: JigSettings, s: Settings) -> Case:
    """Dock one arm; a number gives the same arm, poses and pushes in every jig."""
    rng = np.random.default_rng([s.seed, number])
    names = [name for name in hypotheses(arm) if name != "healthy"]
    name = names[int(rng.integers(len(names)))]
    fault = sampler.draw(rng, hypothesis="healthy@0" if number % 3 == 2 else name)
    mismatch = sampler.difficulty.mismatch.draw(arm, rng)
    rms = tuple(s.push * limit for limit in arm.torque_limits)
    shake = Excitation(torque_rms=rms, duration=s.seconds, band=BAND)
    records = []
    for _ in range(s.poses):
        pose = arm.random_pose(rng)
        push = torque_signals(shake, timestep=arm.timestep, before=0, after=0, rng=rng)
        records.append(measure_docked(arm, pose, fault, push, rng, settings=jig, mismatch=mismatch))
    return Case(
        fault=fault,
        by_force=docked_verdict(records),
        by_torque=docked_verdict(records, by_force=False),
    )


def columns_of(cases: Sequence[Case], *, by_force: bool) -> str:
    """Right verdicts, right places, false alarms and the median error of right directions."""
    right, place, alarms, errors = [], [], [], []
    for case in cases:
        found = case.by_force if by_force else case.by_torque
        if isinstance(case.fault, Healthy):
            alarms.append(found.hypothesis != "healthy")
            continue
        right.append(found.hypothesis == case.fault.hypothesis)
        place.append(found.hypothesis[-1] == case.fault.hypothesis[-1])
        if right[-1] and isinstance(case.fault, StructuralLooseness):
            true = np.array(case.fault.direction) / np.linalg.norm(case.fault.direction)
            errors.append(np.degrees(np.arccos(min(abs(float(found.direction @ true)), 1.0))))
    middle = f"{np.median(errors):6.1f}" if errors else f"{'-':>6s}"
    shares = (100 * np.mean(right), 100 * np.mean(place), 100 * np.mean(alarms))
    return "".join(f"{share:7.0f}" for share in shares) + f"  {middle}"


def study(settings: Settings) -> None:
    """Print the table."""
    if settings.arm not in ARMS:
        raise UnknownName(f"unknown arm {settings.arm!r}; choose from {list(ARMS)}")
    arm = ARMS[settings.arm]()
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    print(f"{arm.name}: {settings.cases} arms a row, {settings.poses} poses each")
    print(f"{'':24s}{'jig force measured':^30s}  {'drive torques alone':^30s}")
    head = f"{'right':>7s}{'place':>7s}{'false':>7s}{'error':>8s}"
    print(f"{'jig N/m':>10s}  {'friction':>10s}  {head}   {head}")
    print(f"{'':24s}" + f"{'%':>7s}{'%':>7s}{'al. %':>7s}{'deg':>8s} " * 2)
    grid = [(k, f) for k in STIFFNESS for f in FRICTION]
    with ProgressLine(len(grid) * settings.cases, unit="arms") as line:
        for stiffness, friction in grid:
            jig = JigSettings(stiffness=stiffness, joint_friction=friction)
            cases = []
            for number in range(settings.cases):
                cases.append(case_of(arm, sampler, number, jig, settings))
                line.advance(1)
            columns = [columns_of(cases, by_force=way) for way in (True, False)]
            print(f"{stiffness:10.0e}  {100 * friction:8.0f} %  {columns[0]}   {columns[1]}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, with errors in one line."""
    command("static_force", __doc__, Settings, study, arguments)


if __name__ == "__main__":
    main()
