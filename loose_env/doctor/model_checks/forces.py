"""Recorded torques and motor commands against the torque that the model needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from loose_env.doctor.channels import Channel, Machine, filled
from loose_env.doctor.findings import Finding
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

__all__ = ["check_forces", "recorded_forces"]


def recorded_forces(
    machine: Machine, run: Run, channels: Sequence[Channel]
) -> dict[str, tuple[str, Array]]:
    """Column and torque of each joint whose torque is recorded, or follows from a motor command.

    Torques [N·m or N] have the rows of the run, shape (T,); a position servo's command is none.
    """
    found: dict[str, tuple[str, Array]] = {}
    drives = list(machine.drives.values())
    for channel in channels:
        drive = machine.drives.get(channel.of) if channel.kind == "command" else None
        if drive is None or drive.gain == 0.0 or drive.follows:
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
    gathered: dict[str, list[tuple[str, Array, Array]]] = {}
    for run, channels, motion, rows in blocks:
        if not set(machine.joints) <= motion.known:
            continue  # a joint that is not known may carry the rest
        for joint, (column, values) in recorded_forces(machine, run, channels).items():
            dof = int(machine.model.jnt_dofadr[machine.model.joint(joint).id])
            mean = block_means(values, rows)
            gathered.setdefault(joint, []).append((column, mean, motion.torques[:, dof]))
    for joint, parts in gathered.items():
        yield from _judged(machine, joint, parts)


def _judged(
    machine: Machine, joint: str, parts: Sequence[tuple[str, Array, Array]]
) -> Iterator[Finding]:
    measured = np.concatenate([each for _, each, _ in parts])
    needed = np.concatenate([each for _, _, each in parts])
    found = ratio_of(measured, needed)
    if len(measured) < LEAST_BLOCKS or found is None:
        return
    if not _varied(parts, needed):
        return
    unit = "N·m" if machine.hinge(joint) else "N"
    wrong = _wrong(found)
    odd = not 1 / SCALE_WRONG < found.ratio < SCALE_WRONG
    if wrong is None and odd and found.correlation > SURE_CORRELATION:
        wrong = "another unit, gain or gear", "units"
    if wrong is not None:
        words, check = wrong
        yield Finding(
            check=check,
            severity="error" if _wrong(found) else "warning",
            channel=parts[0][0],
            found=f"{found.ratio:.3g} times the torque that gravity and inertia need (correlation "
            f"{found.correlation:.2f}, {_rms(needed):.3g} {unit} rms): {words}",
            value=found.ratio,
            unit="1",
            consequence="the arm of the model is driven by another torque than the machine was",
            remedy="import the column with sign = -1 or with its unit, or correct the gear of "
            "the actuator in the model",
        )


def _varied(parts: Sequence[tuple[str, Array, Array]], needed: Array) -> bool:
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
    pairs: dict[str, list[tuple[Array, Array]]] = {}
    for run, channels, _, _ in blocks:
        commanded = recorded_forces(machine, run, [c for c in channels if c.kind == "command"])
        for channel in channels:
            if channel.kind == "torque" and channel.of in commanded:
                step = max(1, run.samples // 500)
                torque = filled(run.time, channel.values)
                command = commanded[channel.of][1]
                pairs.setdefault(channel.of, []).append((torque[::step], command[::step]))
    for joint, parts in pairs.items():
        torque, command = (np.concatenate(each) for each in zip(*parts, strict=True))
        found = ratio_of(torque, command)
        if found is None or abs(found.correlation) < SURE_CORRELATION:
            continue
        off = abs(found.ratio - 1)
        if off <= SCALE_NOTED:
            continue
        wrong = _wrong(found)
        yield Finding(
            check="units" if wrong is None else wrong[1],
            severity="warning" if wrong is None else "error",
            channel=f"torque.{joint}",
            found=f"{found.ratio:.3g} times the torque that the command means by the model's gain "
            f"and gear{'' if wrong is None else f': {wrong[0]}'}",
            value=found.ratio,
            unit="1",
            consequence="torque and command contradict each other, and one of them is used",
            remedy="check the unit of both (the command's is the actuator's own), and gain and "
            "gear of the actuator in the model",
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
