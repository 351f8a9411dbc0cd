"""Check of recorded torques and motor commands against the torque that the model needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy import signal

from loose_env.doctor.channels import Channel, Machine, filled
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.by_run import judged_runs
from loose_env.doctor.model_checks.motion import Blocks, block_means
from loose_env.doctor.model_checks.units import FORCE, Ratio, named_unit, ratio_of
from loose_env.doctor.thresholds import (
    FEWEST_POSES,
    LEAST_BLOCKS,
    LEAST_TORQUE_SHARE,
    SCALE_NOTED,
    SCALE_WRONG,
    SURE_CORRELATION,
    TORQUE_SIGN,
)
from loose_env.recording import Run
from loose_env.typing import Array

_DRIVEN = "the arm of the model is driven by another torque than the machine was"
_Part = tuple[str, Array, Array]
"""Column of a run's torque, its block means, and those of the torque that the model needs."""
_Pairs = Sequence[tuple[Array, Array]]
"""Torques and commands of runs."""


def recorded_forces(
    machine: Machine, run: Run, channels: Sequence[Channel]
) -> dict[str, tuple[str, Array]]:
    """Column and torque of each joint whose torque is recorded, or follows from a motor command.

    Torques [N·m or N] have the rows of the run, shape (T,); the command of a position or
    velocity servo is none.
    """
    found: dict[str, tuple[str, Array]] = {}
    drives = list(machine.drives.values())
    for channel in channels:
        drive = machine.drives.get(channel.of) if channel.kind == "command" else None
        if drive is None or drive.gain == 0.0 or not drive.motor:
            continue
        if sum(each.joint == drive.joint for each in drives) > 1:
            continue
        values = filled(run.time, channel.values) * drive.gain * drive.gear
        found[drive.joint] = (channel.name, values)
    for channel in channels:
        if channel.kind == "torque":
            found[channel.of] = (channel.name, filled(run.time, channel.values))
    return found


def check_forces(machine: Machine, blocks: Blocks) -> Iterator[Finding]:
    """Compare slow torques with gravity and inertia, and torque columns with motor commands."""
    yield from _against_commands(machine, blocks)
    yield from _between_runs(blocks)
    gathered: dict[str, dict[str, _Part]] = {}
    for run, channels, motion, rows in blocks:
        if not set(machine.joints) <= motion.known:
            continue  # a joint that is not known may carry the rest
        for joint, (column, values) in recorded_forces(machine, run, channels).items():
            dof = int(machine.model.jnt_dofadr[machine.model.joint(joint).id])
            mean = block_means(values, rows)
            gathered.setdefault(joint, {})[run.name] = column, mean, motion.torques[:, dof]
    for joint, parts in gathered.items():
        usual = _rms(np.concatenate([needed for _, _, needed in parts.values()]))
        for name, some in judged_runs(parts, partial(_alone, usual)):
            yield from _judged(machine, joint, some, name, usual)


def _ratio(parts: Sequence[_Part], usual: float) -> Ratio | None:
    """Ratio of measured to needed torque; None where friction may be the reason for it."""
    measured = np.concatenate([each for _, each, _ in parts])
    needed = np.concatenate([each for _, _, each in parts])
    found = ratio_of(measured, needed)
    if len(measured) < LEAST_BLOCKS or found is None:
        return None
    if _varied(parts, needed):
        return found
    # In one held pose friction may hide a torque or turn it round, but not multiply it.
    carries = _rms(needed) >= LEAST_TORQUE_SHARE * usual
    return found if carries and found.ratio > 1 / SCALE_WRONG else None


def _alone(usual: float, _: str, part: _Part) -> str | None:
    """Judge one run: its wrong unit or sign, "" for none; None where it tells nothing."""
    found = _ratio([part], usual)
    if found is None or abs(found.correlation) < SURE_CORRELATION:
        return None
    wrong = _wrong(found)
    if wrong is not None:
        return wrong[0]
    return "" if 1 / SCALE_WRONG < found.ratio < SCALE_WRONG else None


def _judged(
    machine: Machine, joint: str, parts: Sequence[_Part], run: str, usual: float
) -> Iterator[Finding]:
    found = _ratio(parts, usual)
    if found is None:
        return
    needed = np.concatenate([each for _, _, each in parts])
    unit = "N·m" if machine.hinge(joint) else "N"
    wrong = _wrong(found)
    odd = not 1 / SCALE_WRONG < found.ratio < SCALE_WRONG
    if wrong is None and odd and found.correlation > SURE_CORRELATION and _varied(parts, needed):
        wrong = "another unit, gain or gear", "units"
    if wrong is not None:
        words, check = wrong
        yield Finding(
            check=check,
            severity="error" if _wrong(found) else "warning",
            run=run,
            channel=parts[0][0],
            found=f"{found.ratio:.3g} times the torque that gravity and inertia need (correlation "
            f"{found.correlation:.2f}, {_rms(needed):.3g} {unit} rms): {words}",
            value=found.ratio,
            unit="1",
            consequence=_DRIVEN,
            remedy="import the column with sign = -1 or with its unit, or correct the gear of "
            "the actuator in the model",
        )


def _varied(parts: Sequence[_Part], needed: Array) -> bool:
    """Return whether friction cannot be the reason: the torque changes, or poses do."""
    spread = float(np.std(needed))
    return spread > LEAST_TORQUE_SHARE * _rms(needed) or (
        len(parts) >= FEWEST_POSES and spread > 0.5 * LEAST_TORQUE_SHARE * _rms(needed)
    )


def _wrong(found: Ratio) -> tuple[str, str] | None:
    if abs(found.correlation) < SURE_CORRELATION:
        return None
    words = named_unit(found.ratio, FORCE)
    sign = ", and the opposite sign" if found.ratio < 0 else ""
    if words is not None:
        return f"{words}{sign}", "units"
    if found.ratio < 0 and TORQUE_SIGN[0] <= -found.ratio <= TORQUE_SIGN[1]:
        return "the opposite sign", "sign"
    return None


def _against_commands(machine: Machine, blocks: Blocks) -> Iterator[Finding]:
    """Compare torque columns with the commands of motors on the same joints."""
    pairs: dict[str, dict[str, tuple[Array, Array]]] = {}
    for run, channels, _, _ in blocks:
        commanded = recorded_forces(machine, run, [c for c in channels if c.kind == "command"])
        for channel in channels:
            if channel.kind == "torque" and channel.of in commanded:
                step = max(1, run.samples // 500)
                torque = filled(run.time, channel.values)
                command = commanded[channel.of][1]
                pairs.setdefault(channel.of, {})[run.name] = torque[::step], command[::step]
    for joint, parts in pairs.items():
        for name, some in judged_runs(parts, _of_commands):
            yield from _judged_commands(joint, some, name)


def _commanded_ratio(parts: _Pairs) -> Ratio | None:
    torque, command = (np.concatenate(each) for each in zip(*parts, strict=True))
    found = ratio_of(torque, command)
    return None if found is None or abs(found.correlation) < SURE_CORRELATION else found


def _of_commands(_: str, part: tuple[Array, Array]) -> str | None:
    """Judge torques by commands: a wrong unit or sign, "" for none; None if they tell nothing."""
    found = _commanded_ratio([part])
    if found is None:
        return None
    wrong = _wrong(found)
    if wrong is not None:
        return wrong[0]
    return "" if abs(found.ratio - 1) <= SCALE_NOTED else None


def _judged_commands(joint: str, parts: _Pairs, run: str) -> Iterator[Finding]:
    found = _commanded_ratio(parts)
    if found is not None and abs(found.ratio - 1) > SCALE_NOTED:
        wrong = _wrong(found)
        yield Finding(
            check="units" if wrong is None else wrong[1],
            severity="warning" if wrong is None else "error",
            run=run,
            channel=f"torque.{joint}",
            found=f"{found.ratio:.3g} times the torque that the command means by the model's gain "
            f"and gear{'' if wrong is None else f': {wrong[0]}'}",
            value=found.ratio,
            unit="1",
            consequence="torque and command contradict each other, and one of them is used",
            remedy="check the unit of both (the command's is the actuator's own), and gain and "
            "gear of the actuator in the model",
        )


def _between_runs(blocks: Blocks) -> Iterator[Finding]:
    """Compare the torque of an excited joint, over the motion that it makes, between the runs.

    A torque that holds no weight, such as the noise added to a controller's, is not comparable
    with gravity; its ratio to the acceleration changes little from pose to pose.
    """
    sizes: dict[str, dict[str, float]] = {}
    for run, channels, *_ in blocks:
        motion = [c for c in channels if c.kind == "acceleration"]
        for channel in channels:
            if channel.kind != "torque" or channel.of not in run.excited:
                continue
            moved = motion or [c for c in channels if c.kind == "position" and c.of == channel.of]
            answer = float(np.sqrt(sum(_wobble(run, c) ** 2 for c in moved)))
            torque = _wobble(run, channel)
            if torque > 0.0 and answer > 0.0:
                sizes.setdefault(channel.of, {})[run.name] = torque / answer
    for joint, parts in sizes.items():
        # Of two runs that differ, the larger is named: N·mm are usual, kN·m are not.
        usual = sorted(parts.values())[(len(parts) - 1) // 2]
        for name, size in parts.items():
            for words, factor in FORCE.items():
                far = max(factor, 1 / factor) > SCALE_WRONG**3
                if far and 1 / SCALE_WRONG < size / (usual * factor) < SCALE_WRONG:
                    yield Finding(
                        check="units",
                        severity="error",
                        run=name,
                        channel=f"torque.{joint}",
                        found=f"{size / usual:.3g} times as large over the motion that it makes "
                        f"as in other runs: {words}",
                        value=size / usual,
                        unit="1",
                        consequence=_DRIVEN,
                        remedy="import the column of this run with its unit",
                    )


def _wobble(run: Run, channel: Channel) -> float:
    return float(np.std(signal.detrend(filled(run.time, channel.values))))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
