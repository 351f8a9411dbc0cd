"""Timing of commands by the motion that follows them: held or along lines, and a shift.

A controller interpolates its references and a logger samples them, or it holds each command until
the next. Held commands act half an interval after the lines between their samples. The delay behind
the lines follows from the torque that the model needs for the measured motion: what its drive does
not give of it is, by least squares, a delay of the command, viscous and dry friction, and a
constant. Delays of drives only add: where it is below a quarter of the interval, no command can be
held, and where it is negative the commands act before their stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.importing.evidence import dry_friction
from loose_env.importing.resampling import filled, median_step, smoothed
from loose_env.importing.targets import SMOOTHED, Drive, drives_of, joint_targets, needed_torques
from loose_env.recording import CommandTiming, Run, last_known
from loose_env.typing import Array

_LINEAR = 0.25
"""Delay over the interval of the commands, below which they are linear: half way to held ones."""
_KNOWN = 0.125
"""Standard deviation of the same, up to which it decides."""
_MOST_SHIFT = 1.5
"""Lead over the interval that may be one of sampling; a longer one is a matter of clocks."""
_RUNS, _ROWS = 6, 4000
"""Runs, and rows of each about its middle, that are looked at."""
_PIECES = 8
"""Pieces that are left out in turn for the standard deviation: residuals are correlated."""

_STEPS = 4
"""Steps of Gauss and Newton: a delay is linear for a part of the motion's period only."""

_Part = tuple[Array, Array, Array, Array, Array]
"""Needed torque and position of a joint at the times of a grid; times and held command of a run."""


class CommandDelay(NamedTuple):
    """Delay at which a drive acts on its command behind straight lines between its samples."""

    seconds: float
    """Negative where it acts before the samples' stamps [s]."""
    sd: float
    """Standard deviation [s]."""
    interval: float
    """Median time between changes of the command [s]."""


def command_delays(model: mujoco.MjModel, runs: Sequence[Run]) -> dict[str, CommandDelay]:
    """Delay of each drive whose force is affine, alone at its joint.

    Empty where the positions of some joints are not known, or loops are closed.
    """
    targets = {each.name: each.position[7:] for each in joint_targets(model) if each.position}
    runs = [run for run in runs if run.controls and run.sensors.keys() >= {*targets.values()}]
    if not runs:
        return {}
    step = median_step(runs[0].time)
    pieces = [_middle(run, step) for run in runs[:_RUNS]]
    positions = {
        joint: [np.interp(grid, run.time, filled(run.time, run.sensors[sensor]))
                for run, grid in pieces] for joint, sensor in targets.items()
    }  # fmt: skip
    needed = needed_torques(model, positions, step)
    drives = {f"ctrl.{drive.name}": drive for drive in drives_of(model)}
    found = {}
    for each in joint_targets(model):
        own = drives.get(each.command)
        if (
            each.name in {*positions} & {*needed}
            and own
            and own.gain
            and not own.filter_s
            and not own.tendon
        ):
            parts = [
                (needed[each.name][k], positions[each.name][k], grid, run.time, held)
                for k, (run, grid) in enumerate(pieces) if own.name in run.controls
                and np.ptp(held := last_known(run.controls[own.name])) > 0
            ]  # fmt: skip
            if parts and np.isfinite([*(delay := _delay(own, step, parts))]).all():
                found[own.name] = delay
    return found


def _middle(run: Run, step: float) -> tuple[Run, Array]:
    """Piece of a run about its middle, and the times of it that are looked at."""
    first = max(len(run.time) - _ROWS, 0) // 2
    grid = np.arange(run.time[first], run.time[first:][:_ROWS][-1], step)[:_ROWS]
    spare = min(first, _ROWS // 8)  # for commands that act late or early
    return run.part(slice(first - spare, first + _ROWS + spare)), grid


def _delay(drive: Drive, step: float, parts: Sequence[_Part]) -> CommandDelay:
    interval = float(np.median([interval_of(time, held) for *_, time, held in parts]))
    lines = [(*part[:4], lines_of(*part[3:], interval)) for part in parts]
    late = 0.0
    for _ in range(_STEPS):
        y, terms = _terms(drive, step, lines, late)
        late += _fitted(y, terms)
    piece = np.arange(len(y)) * _PIECES // max(len(y), 1)
    without = [_fitted(y[piece != k], terms[piece != k]) for k in range(_PIECES)]
    return CommandDelay(late, float(np.sqrt(_PIECES - 1) * np.std(without)), interval)


def _fitted(y: Array, terms: Array) -> float:
    size = np.maximum(np.linalg.norm(terms, axis=0), 1e-300)
    return float(np.linalg.lstsq(terms / size, y, rcond=None)[0][0] / size[0])


def _terms(drive: Drive, step: float, parts: Sequence[_Part], late: float) -> tuple[Array, Array]:
    """Torque (T,) that a drive does not give, and its change by delay and friction (T, 4)."""
    gear, gain, (bias, stiff, damped) = drive.gear, drive.gain, drive.bias
    left, columns = [], []
    for needed, position, grid, time, lines in parts:
        asked = np.interp(grid - late, time, lines)
        command, q = (smoothed(x, SMOOTHED) for x in (asked, position))
        speed, inner = np.gradient(q, step), slice(SMOOTHED, -SMOOTHED)
        given = gear * (gain * command + bias + gear * (stiff * q + damped * speed))
        later = -gear * gain * np.gradient(command, step)
        left.append((needed - given)[inner])
        columns.append(
            np.stack([later, np.ones_like(q), speed, dry_friction(speed)], axis=1)[inner]
        )
    return np.concatenate(left), np.concatenate(columns)


def interval_of(time: Array, values: Array) -> float:
    """Median time between changes of a command [s]; infinite where it changes less than twice."""
    changes = np.flatnonzero(np.diff(values)) + 1
    return float(np.median(np.diff(time[changes]))) if len(changes) > 1 else np.inf


def lines_of(time: Array, values: Array, interval: float) -> Array:
    """Held command (T,) as straight lines between its changes, at most an interval long.

    Examples
    --------
    >>> lines_of(np.arange(8.0), np.array([0.0, 0, 2, 2, 2, 2, 2, 4]), 2.0).tolist()
    [0.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 4.0]
    """
    changes = np.flatnonzero(np.diff(values)) + 1
    since = np.diff(time[changes], prepend=-np.inf)
    rests = np.searchsorted(time, time[changes[since > 1.5 * interval]] - 1.001 * interval)
    knots = np.zeros(len(time), bool)
    knots[[0, -1]] = knots[rests] = knots[changes] = True
    return np.asarray(np.interp(time, time[knots], values[knots]))


def usual_delay(delays: Collection[CommandDelay]) -> CommandDelay | None:
    """Delay that the sampling of all commands makes, as far as it is known: the lower median.

    A single drive may be late by itself, or seem early by its friction.
    """
    known = sorted(
        (each for each in delays if each.sd <= _KNOWN * each.interval),
        key=lambda each: each.seconds / each.interval,
    )
    return known[(len(known) - 1) // 2] if known else None


def early_by(model: mujoco.MjModel, runs: Sequence[Run]) -> float:
    """Time by which drives act before the commands as the runs have them [s]; 0 if within doubt."""
    delays = command_delays(model, runs)
    usual = usual_delay(delays.values())
    if usual is None or usual.seconds < -_MOST_SHIFT * usual.interval:
        return 0.0
    name = next(name for name, delay in delays.items() if delay is usual)
    early = runs[0].timing(name).delay(usual.interval) - usual.seconds
    return early if early > _LINEAR * usual.interval else 0.0


def timed(
    model: mujoco.MjModel, runs: Sequence[Run], free: Collection[str], say: Callable[[str], None]
) -> list[Run]:
    """Runs in which the commands that no mapping fixed act as the motion says; else held."""
    usual = usual_delay([v for k, v in command_delays(model, runs).items() if k in free])
    if usual is None or (share := usual.seconds / usual.interval) >= _LINEAR:
        return list(runs)
    shift = usual.seconds if -_MOST_SHIFT <= share < -_LINEAR else 0.0
    timing = CommandTiming(mode="linear", shift_s=round(shift, 6))
    lead = f", {-1e3 * shift:.3g} ms before their stamps" if shift else ""
    say(
        f"commands act along straight lines between their samples{lead}: the drives follow the "
        f"lines {1e3 * usual.seconds:.3g} ms late (standard deviation {1e3 * usual.sd:.2g} ms), "
        f"and held commands would act {500 * usual.interval:.3g} ms late"
    )
    return [
        replace(
            run,
            controls={
                name: lines_of(run.time, last_known(own), usual.interval) if name in free else own
                for name, own in run.controls.items()
            },
            commands={**run.commands, **{name: timing for name in run.controls if name in free}},
        )
        for run in runs
    ]
