"""Spectral lines of a run and of the healthy run that repeats it, the latter at equal drive.

What a model gets wrong it gets wrong in both alike. The difference between the two is noise, what
varies from one session to the next, and the fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from loose_env.instrument.data.held_pose import RunSetup
from loose_env.instrument.data.spectral_lines import Lines, lines_of
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.settings.thresholds import (
    FEWEST_SAMPLES,
    SAME_POSE,
    SAME_SIGNAL,
)
from loose_env.recording import Run
from loose_env.typing import Array, ComplexArray

_STEPS_ALIKE = 1e-3
"""Relative difference of the sampling steps up to which two runs have the same [1]."""
_LARGEST_RATIO = 4.0
"""Ratio of the drives' lines, either way, beyond which a line is not compared [1]: one of them is
too weak there."""
_NOT_COMPARED = 1e6
"""Factor on the noise of such a line [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldRun:
    """Run with its pose, excited joints and spectral lines."""

    run: Run
    setup: RunSetup
    lines: Lines


def paired_lines(
    arm: InstrumentedArm, suspect: HeldRun, references: Sequence[HeldRun]
) -> tuple[Lines, Lines] | None:
    """Lines of a run and of the reference that repeats it, over the time that both have."""
    best: tuple[float, int, HeldRun] | None = None
    for reference in references:
        found = _alike(arm, suspect, reference)
        if found is not None and (best is None or found[0] > best[0]):
            best = (*found, reference)
    if best is None:
        return None
    _, lag, reference = best
    first, second = _overlap(suspect.run, reference.run, lag)
    if first.samples < FEWEST_SAMPLES:
        return None
    own = lines_of(
        arm, first, suspect.setup.pose, suspect.setup.excited, number=suspect.lines.number
    )
    other = lines_of(
        arm, second, reference.setup.pose, reference.setup.excited,
        number=reference.lines.number, whole=True,
    )  # fmt: skip
    return _at_the_same_lines(own, other)


def as_driven(arm: InstrumentedArm, reference: Lines, by: Lines) -> Lines:
    """Reference as it would have been with the drive of another run, line by line.

    A controller that closes a loop does not repeat its torque exactly; the arm is linear enough to
    scale what it answered.
    """
    ratio = _drive(arm, by) / np.where(
        np.abs(_drive(arm, reference)) > 0, _drive(arm, reference), np.inf
    )
    size = np.abs(ratio)
    weak = (size > _LARGEST_RATIO) | (size < 1 / _LARGEST_RATIO)
    ratio = np.where(weak, 1.0, ratio)
    noise = np.where(weak, _NOT_COMPARED, np.abs(ratio) ** 2)
    return replace(
        reference,
        command=reference.command * ratio[:, None],
        force=reference.force * ratio[:, None],
        readings=reference.readings * ratio[:, None],
        leaked=reference.leaked * ratio[:, None],
        noise=reference.noise * noise[:, None],
    )


def _drive(arm: InstrumentedArm, lines: Lines) -> ComplexArray:
    """Drive of the excited joint (K,); of several joints that of the first."""
    joint = int(lines.excited[0])
    return np.asarray(lines.command @ arm.actuators.force[joint] + lines.force[:, joint])


def _alike(arm: InstrumentedArm, suspect: HeldRun, reference: HeldRun) -> tuple[float, int] | None:
    """Correlation and lag of the signals of two runs; None where they are other runs."""
    if not np.array_equal(suspect.setup.excited, reference.setup.excited):
        return None
    if np.abs(suspect.setup.pose - reference.setup.pose).max() > SAME_POSE:
        return None
    steps = [float(np.median(np.diff(each.run.time))) for each in (suspect, reference)]
    if abs(steps[0] / steps[1] - 1) > _STEPS_ALIKE:
        return None
    first, second = (_signal(arm, each) for each in (suspect, reference))
    if first is None or second is None:
        return None
    both = signal.correlate(first, second, method="fft")
    lags = signal.correlation_lags(len(first), len(second))
    lag = int(lags[int(np.argmax(np.abs(both)))])
    a, b = _cut(first, second, lag)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    correlation = float(a @ b) / size if size > 0 else 0.0
    return (correlation, lag) if correlation > SAME_SIGNAL else None


def _signal(arm: InstrumentedArm, held: HeldRun) -> Array | None:
    """Command or torque of the first excited joint, by sample."""
    joint = arm.joints[int(held.setup.excited[0])]
    for name in arm.actuators.names:
        if name in held.run.controls and arm.joints[arm.actuators.driven_joint(name)] == joint:
            values = held.run.controls[name]
            break
    else:
        if joint not in held.run.torques:
            return None
        values = held.run.torques[joint]
    values = np.where(np.isfinite(values), values, 0.0)
    return np.asarray(signal.detrend(values), dtype=float)


def _cut(first: Array, second: Array, lag: int) -> tuple[Array, Array]:
    first, second = first[max(lag, 0) :], second[max(-lag, 0) :]
    count = min(len(first), len(second))
    return first[:count], second[:count]


def _overlap(first: Run, second: Run, lag: int) -> tuple[Run, Run]:
    """Parts of two runs in which both play the same, the first ``lag`` samples later."""
    begin, other = max(lag, 0), max(-lag, 0)
    count = min(first.samples - begin, second.samples - other)
    return first.part(slice(begin, begin + count)), second.part(slice(other, other + count))


def _at_the_same_lines(own: Lines, other: Lines) -> tuple[Lines, Lines] | None:
    """Both at the lines and channels that both have."""
    first, second = (np.round(one.frequency / one.next).astype(int) for one in (own, other))
    _, at, there = np.intersect1d(first, second, return_indices=True)
    names = [(r.sensor, axis) for r, axis in other.row]
    kept = [k for k, (r, axis) in enumerate(own.row) if (r.sensor, axis) in names]
    same = [names.index((own.row[k][0].sensor, own.row[k][1])) for k in kept]
    if len(at) < len(first) or not any(own.row[k][0].kind == "acceleration" for k in kept):
        return None
    return own.at_channels(kept), other.at_channels(same).at_lines(there)
