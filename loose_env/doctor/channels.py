"""Checks of one run by itself: its time steps, and every channel without a model's motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.doctor.findings import Defect, Finding
from loose_env.doctor.machine import PAUSE_STEPS, Channel, Machine, channels_of, told_to_move
from loose_env.importing import median_step
from loose_env.recording import Run, without_corrupt
from loose_env.typing import Array

# Sampling
UNEVEN_STEP = 0.1
"""Rms deviation of the time steps from their median, above which the sampling is called uneven
[median steps]: below, spectra change by less than 1 %."""
VERY_UNEVEN_STEP = 0.5
"""The same, above which it is a warning [median steps]: samples that are taken as even are then off
by a step."""
PAUSE_S = 0.02
"""Shortest pause [s]: a slower recorder may skip a row without harm."""
LEAST_RATE_HZ = 20.0
"""Sampling rate below which the motion of an arm is not resolved [Hz]: its servos reach 5 to 10
Hz."""
SLOWEST_RATE_HZ = 4.5
"""Sampling rate below which times are not in seconds [Hz]: the slowest recorders of arms have 5
Hz, and the 1 to 4 kHz of usual drives read so where their times are in milliseconds."""
HIGHEST_RATE_HZ = 1e6
"""Sampling rate above which times are not in seconds [Hz]: recorders of arms reach 100 kHz."""

# Channels
LARGE_NAN = 0.05
"""Share of missing samples, above which it is a warning: interpolation bridges fewer; 20 % is
refused when a run is read."""
FROZEN_SAMPLES = 20
"""Fewest equal samples in a row that count as frozen: noise on several levels does not repeat one
so often by chance."""
FROZEN_RATIO = 10.0
"""Length of such a piece over the channel's usual repetition (90 % of them): coarse channels repeat
by themselves."""
FEWEST_PIECES = 10
"""Changes of a channel, from which its own rate, or a limit that it keeps reaching, is told: fewer
are a channel that rests."""
CLIPPED_LEAST = 8
"""Fewest samples at the channel's extreme value, from which it counts as clipped."""
CLIPPED_PILE = 4.0
"""Samples at the extreme over those in each of the next levels: an honest tail thins out."""
LIMITED_SHARE = 0.01
"""Share of the commands at a limit of the actuator, above which they count as clipped: noise cut at
2.6 standard deviations loses 1 % of its samples."""
LOST_VALUE = 3
"""Fewest samples of exactly zero in a row that count as a lost reading: a signal that crosses zero
stays there for one."""
LOST_RATIO = 8.0
"""Distance of zero from the channel's median [robust standard deviations] for that: no reading of
the channel is so far away."""

_NOISY = ("acceleration", "turning", "torque", "velocity")
"""Kinds whose readings never repeat for long on a machine that runs."""
_NOT_SECONDS = Defect(
    "rate", "error", "the times are not in seconds, and every frequency is wrong",
    "import the times with their unit",
)  # fmt: skip
_SLOW = Defect(
    "rate", "warning", "faster motion is not resolved, and servos reach 5 to 10 Hz",
    f"record at {LEAST_RATE_HZ:g} Hz or more; where the times are not in seconds, import them with "
    "their unit",
)  # fmt: skip
_PAUSES = Defect(
    "pauses", "warning", "a diagnosis uses the longest piece without a pause alone",
    "record the run again without pauses, or cut it to a piece without one",
)  # fmt: skip
_UNEVEN = Defect(
    "uneven", "note", "spectra above about a quarter of the rate are less exact",
    "record with a hardware clock; where it is the stamps that jitter and not the samples, import "
    "with rate_hz",
)  # fmt: skip
_CORRUPT = Defect(
    "range", "warning", "they are set aside as missing",
    "check unit and scale at the import, and look for lost samples",
)  # fmt: skip
_ABSURD = replace(
    _CORRUPT, severity="error",
    consequence="no reading in SI units is so large, and results overflow",
)  # fmt: skip
_MISSING = Defect(
    "missing", "note", "missing samples are interpolated or cut out, and weaken the result",
    "find out why the recorder loses samples; raise gap_s of the column at the import where pauses "
    "belong to it",
)  # fmt: skip
_AT_REST = Defect(
    "stuck", "note", "a joint at rest, or a sensor whose silence is taken for a measurement",
    "look whether the joint moved; leave the column out where its sensor is dead",
)  # fmt: skip
_DROPOUT = Defect(
    "dropout", "warning", "a repeated or lost reading is taken for a measured one",
    "write missing samples as NaN, or cut the run",
)  # fmt: skip
_CLIPPED = Defect(
    "saturation", "warning", "a clipped signal has frequencies that the motion has not",
    "lower the excitation, or choose a larger range of the sensor",
)  # fmt: skip


def check_sampling(machine: Machine, run: Run) -> Iterator[Finding]:
    """Check the time of one run: rate, pauses, even steps, band of the excitation."""
    step = median_step(run.time)
    rate, told = 1 / step, f"sampled at {1 / step:.4g} Hz over {run.time[-1] - run.time[0]:.4g} s"
    if not SLOWEST_RATE_HZ <= rate <= HIGHEST_RATE_HZ:
        yield _NOT_SECONDS.at("time", told, rate, unit="Hz", run=run.name)
        return
    if round(rate, 1) < LEAST_RATE_HZ:  # no joint is shaken so slowly
        severity = "error" if run.excited else "warning"
        yield _SLOW.at("time", told, rate, unit="Hz", run=run.name, severity=severity)
    steps = np.diff(run.time) / step
    pauses = np.flatnonzero((steps > PAUSE_STEPS) & (steps * step > PAUSE_S))
    if pauses.size:
        longest = int(pauses[np.argmax(steps[pauses])])
        seconds = float(steps[longest] * step)
        found = f"{pauses.size} pause{'s' * (pauses.size > 1)} of the recorder, the longest "
        found += f"{seconds:.3g} s from {run.time[longest]:.4g} s on"
        yield _PAUSES.at("time", found, seconds, unit="s", run=run.name)
    even = np.delete(steps, pauses)
    off = even - np.maximum(np.round(even), 1.0)  # whole missing rows are no jitter
    jitter = float(np.sqrt(np.mean(off**2))) if even.size else 0.0
    if jitter > UNEVEN_STEP:
        severity = "warning" if jitter > VERY_UNEVEN_STEP else "note"
        found = f"time steps scatter by {1e3 * jitter * step:.3g} ms rms about their median of "
        found += f"{1e3 * step:.3g} ms"
        yield _UNEVEN.at("time", found, jitter * step, unit="s", run=run.name, severity=severity)


def without_absurd(machine: Machine, run: Run) -> tuple[Run, list[Finding]]:
    """Set corrupt samples aside, and columns that are mostly such, with a finding for each."""
    clean, corrupt = without_corrupt(run, machine.model)
    found = []
    for each in corrupt:
        more = f": {each.missing:.0%} would be missing without them" if each.too_many else ""
        defect = _ABSURD if each.too_many else _CORRUPT
        found.append(defect.at(each.column, each.found + more, each.largest, run=run.name))
    return _without(clean, {each.column for each in corrupt if each.too_many}), found


def _without(run: Run, lost: set[str]) -> Run:
    """Run without columns; a sensor goes with all its axes."""
    if not lost:
        return run

    def kept(prefix: str, columns: Mapping[str, Array]) -> dict[str, Array]:
        axes = ("", ".x", ".y", ".z")
        named = {name: {f"{prefix}.{name}{axis}" for axis in axes} for name in columns}
        return {name: v for name, v in columns.items() if not named[name] & lost}

    controls, sensors = kept("ctrl", run.controls), kept("sensor", run.sensors)
    return replace(run, controls=controls, sensors=sensors, torques=kept("torque", run.torques))


def without_dead(machine: Machine, runs: Sequence[Run]) -> list[Run]:
    """Runs without encoders that hold one value while their joint is told to move.

    One that holds a value in every run is dead in all of them.
    """
    still: list[set[str]] = []
    dead: list[set[str]] = []
    for run in runs:
        readings = [c for c in channels_of(machine, run) if c.kind == "position"]
        rest = [c for c in readings if c.there.size and np.ptp(c.there) == 0]
        still.append({c.name for c in rest})
        told = told_to_move(machine, run) if rest else set[str]()
        dead.append({c.name for c in rest if c.of in told})
    always = set.intersection(*still) & set[str]().union(*dead)
    return [_without(run, own | always) for run, own in zip(runs, dead, strict=True)]


def check_channels(machine: Machine, run: Run) -> Iterator[Finding]:
    """Check every channel of one run by itself."""
    channels = channels_of(machine, run)
    moves = {c.name for c in channels if c.there.size and np.ptp(c.there) > 0}
    for channel in channels:
        share = float(np.mean(np.isnan(channel.values)))
        if share > 0:
            severity, found = "warning" if share > LARGE_NAN else "note", f"{share:.2%} of the "
            found += "samples are missing (NaN)"
            yield _MISSING.at(channel.name, found, share, unit="1", run=run.name, severity=severity)
        if channel.there.size and channel.name not in moves:
            yield from _stuck(machine, run, channel, channels, moves)
        elif channel.there.size:
            if channel.kind in _NOISY:
                yield from _pieces(run, channel)
            yield from _clipped(machine, run, channel)


def _stuck(
    machine: Machine, run: Run, channel: Channel, channels: Sequence[Channel], moves: set[str]
) -> Iterator[Finding]:
    """Judge an encoder that holds one value while its joint, or another one, moves."""
    beside = any(c.kind == "position" and c.name in moves for c in channels)
    driven = channel.of in told_to_move(machine, run)
    shaken = channel.of in run.excited
    if channel.kind == "position" and (driven or shaken or beside):
        told = "commanded to move" if driven else "excited" if shaken else "at rest beside others"
        found = f"every sample is {channel.there[0]:.6g}, and joint {channel.of} is {told}"
        yield _AT_REST.at(
            channel.name, found,
            float(channel.there[0]), run=run.name,
            severity="error" if shaken else "warning" if driven else "note",
        )  # fmt: skip


def _repeats(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples and lengths of the pieces of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


def _pieces(run: Run, channel: Channel) -> Iterator[Finding]:
    """Judge pieces of equal values: frozen readings, lost ones."""
    values, time = channel.there, run.time[np.isfinite(channel.values)]
    starts, lengths = _repeats(values)
    if lengths.max() < LOST_VALUE:
        return
    least = max(FROZEN_SAMPLES, FROZEN_RATIO * np.percentile(lengths, 90))
    if count := int(np.sum(lengths >= least)):
        worst = int(np.argmax(lengths))
        seconds = float(lengths[worst] * median_step(run.time))
        found = f"stands still {count} time{'s' * (count > 1)}, longest {seconds:.3g} s "
        found += f"from {time[starts[worst]]:.4g} s on"
        yield _DROPOUT.at(channel.name, found, seconds, unit="s", run=run.name)
    middle = float(np.median(values))
    scatter = 1.4826 * float(np.median(np.abs(values - middle)))
    if middle != 0.0 and abs(middle) >= LOST_RATIO * scatter:
        lost = (lengths >= LOST_VALUE) & (values[starts] == 0.0)
        if lost.any():
            count, first = int(lengths[lost].sum()), time[starts[lost][0]]
            found = f"{count} samples are exactly 0 while the channel reads {middle:.4g}, first at "
            found += f"{first:.4g} s"
            yield _DROPOUT.at(channel.name, found, float(count), unit="samples", run=run.name)


def _clipped(machine: Machine, run: Run, channel: Channel) -> Iterator[Finding]:
    """Judge samples at an extreme value: a sensor's range, or an actuator's limit."""
    values = channel.there
    drive = machine.drives.get(channel.of) if channel.kind == "command" else None
    if drive is not None and drive.limits is not None and not drive.follows:
        low, high = drive.limits
        slack = 1e-6 * (high - low)
        at_end = (values <= low + slack) | (values >= high - slack)
        share = float(np.mean(at_end))
        # A command that rests at the end of its range is there for long.
        if share > LIMITED_SHARE and len(_repeats(at_end.astype(float))[0]) > FEWEST_PIECES:
            found = f"{share:.1%} of the commands are at a limit of the actuator ({low:g} to "
            yield _CLIPPED.at(channel.name, f"{found}{high:g})", share, unit="1", run=run.name)
    ends = values.min(), values.max()
    if (
        channel.kind not in _NOISY
        or max(np.count_nonzero(values == v) for v in ends) < CLIPPED_LEAST
    ):
        return
    levels, counts = np.unique(values, return_counts=True)
    for extreme, beside in ((0, slice(1, 6)), (-1, slice(-6, -1))):
        count, level = int(counts[extreme]), levels[extreme]
        most = max(CLIPPED_LEAST, CLIPPED_PILE * counts[beside].max())
        at_zero = channel.kind in ("torque", "velocity") and level == 0.0
        if count < most or at_zero or level in (values[0], values[-1]):
            continue  # few, or rest before or after the motion
        share = count / len(values)
        found = f"{count} samples ({share:.2%}) are at the limit of {level:.6g}"
        yield _CLIPPED.at(channel.name, found, share, unit="1", run=run.name)
