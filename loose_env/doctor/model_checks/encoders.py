"""Check of encoders that wrap round, and of positions recorded in encoder ticks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loose_env.doctor.channels import Machine, Runs, filled, positions
from loose_env.doctor.corrections import Correction
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.by_run import judged_runs
from loose_env.doctor.thresholds import (
    FOLLOWS_COMMAND,
    LARGEST_STEP_RAD,
    LEAST_TICKS,
    TICKS_MATCH,
    TURN_MATCH,
)
from loose_env.typing import Array


def check_encoders(machine: Machine, runs: Runs) -> Iterator[Finding]:
    """Look for turns that encoders lose, and for positions that are counts."""
    for joint in machine.joints:
        measured = ((run, positions(channels)) for run, channels in runs)
        own = [(run, found[joint]) for run, found in measured if joint in found]
        if not own or not machine.hinge(joint):
            continue
        column = own[0][1].name
        turns = [(run, n) for run, c in own if (n := _wraps(c.there))]
        if turns:
            count = sum(n for _, n in turns)
            fix = Correction(kind="unwrap", columns=(column,))
            yield Finding(
                check="range",
                severity="error",
                run=turns[0][0].name,
                channel=column,
                found=f"jumps by a turn of 2π rad {count} time{'s' * (count > 1)}: its encoder "
                "wraps round",
                value=float(count),
                unit="jumps",
                consequence="each jump passes for a motion of a whole turn within a sample",
                remedy=f"--fix DIR writes the recording with {fix.words}",
                fix=fix,
            )
        parts = {run.name: c.there for run, c in own}
        for name, some in judged_runs(parts, _counts):
            values = np.concatenate(some)
            if _counts("", values):
                of = [each for each in runs if name in ("", each[0].name)]
                yield _ticks(machine, joint, column, values, of, name)


def _wraps(values: Array) -> int:
    """Jumps by a turn; none where other steps are large too."""
    steps = np.abs(np.diff(values))
    turn = np.abs(steps / (2 * np.pi) - 1) <= TURN_MATCH
    if not turn.any() or steps[~turn].max(initial=0.0) > LARGEST_STEP_RAD:
        return 0
    return int(turn.sum())


def _counts(_: str, values: Array) -> bool | None:
    """Return whether positions are encoder ticks; None for values that tell nothing."""
    if not values.size or np.all(values == values[0]):
        return None
    return bool(np.ptp(values) > LEAST_TICKS and np.all(values == np.round(values)))


def _ticks(
    machine: Machine, joint: str, column: str, values: Array, runs: Runs, name: str
) -> Finding:
    """Finding on counts, with ticks per turn where a servo's command tells them."""
    per_turn = _per_turn(machine, joint, runs)
    fix, told = None, "ticks per turn unknown"
    if per_turn is not None:
        fix = Correction(kind="scale", columns=(column,), factor=2 * np.pi / per_turn).of(name)
        told = f"{abs(per_turn):.0f} ticks per turn by the commands"
    return Finding(
        check="units",
        severity="error",
        run=name,
        channel=column,
        found=f"holds whole numbers from {values.min():.0f} to {values.max():.0f}: encoder ticks "
        f"({told})",
        value=float(values.max()),
        consequence="every pose and every prediction of the model is wrong by that factor",
        remedy="import the column with scale = 2π over the ticks per turn, and with its zero"
        if fix is None
        else f"check the zero of the encoder; --fix DIR writes the recording with {fix.words}",
        fix=fix,
    )


def _per_turn(machine: Machine, joint: str, runs: Runs) -> float | None:
    """Ticks per turn, a power of two with the sign of the encoder, by the commands of a servo."""
    found = []
    for run, channels in runs:
        position = positions(channels).get(joint)
        for c in channels:
            drive = machine.drives.get(c.of) if c.kind == "command" else None
            if position is None or drive is None or not drive.follows or drive.joint != joint:
                continue
            command = filled(run.time, c.values) * (drive.gear or 1.0)
            read = filled(run.time, position.values)
            if np.std(command) == 0 or np.std(read) == 0:
                continue
            correlation = float(np.corrcoef(command, read)[0, 1])
            if abs(correlation) > FOLLOWS_COMMAND:
                found.append(float(np.copysign(np.std(read) / np.std(command), correlation)))
    if not found:
        return None
    ticks = 2 * np.pi * float(np.median(found))
    power = 2.0 ** round(np.log2(abs(ticks)))
    if abs(abs(ticks) / power - 1) > TICKS_MATCH:
        return None
    return float(np.copysign(power, ticks))
