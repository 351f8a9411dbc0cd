"""Checks of single channels: stuck, frozen, lost, missing, clipped, coarse; corrupt set aside."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.doctor.channels import Channel, Machine
from loose_env.doctor.findings import Finding
from loose_env.doctor.thresholds import (
    CLIPPED_LEAST,
    CLIPPED_PILE,
    CLIPPED_SHARE,
    COARSE_LEVELS,
    COARSE_STEP,
    FEWEST_LEVELS,
    FEWEST_PIECES,
    FROZEN_RATIO,
    FROZEN_S,
    FROZEN_SAMPLES,
    HELD_SHARE,
    LARGE_NAN,
    LIMITED_SHARE,
    LOST_RATIO,
    LOST_VALUE,
    NOTED_NAN,
    REPEATING_SHARE,
)
from loose_env.importing import median_step
from loose_env.recording import Run, without_corrupt
from loose_env.typing import Array

_NOISY = ("acceleration", "turning", "torque", "velocity")
"""Kinds whose readings never repeat for long on a machine that runs."""
_SITE = ("acceleration", "turning")
_ROUNDING = 1e-6
"""Motion of an axis over that of its sensor, below which it is rounding [1]."""
_AXES = ("", ".x", ".y", ".z")


def without_absurd(machine: Machine, run: Run) -> tuple[Run, list[Finding]]:
    """Set corrupt samples aside, and columns that are mostly such, with a finding for each."""
    clean, corrupt = without_corrupt(run, machine.model)
    found = [
        Finding(
            check="range",
            severity="error" if each.too_many else "warning",
            run=run.name,
            channel=each.column,
            found=f"{each.found}: {each.missing:.0%} would be missing without them"
            if each.too_many
            else each.found,
            value=each.largest,
            consequence="no reading in SI units is so large, and results overflow"
            if each.too_many
            else "they are set aside as missing",
            remedy="check unit and scale at the import, and look for lost samples",
        )
        for each in corrupt
    ]
    lost = {each.column for each in corrupt if each.too_many}

    def kept(prefix: str, columns: Mapping[str, Array]) -> dict[str, Array]:
        named = {name: {f"{prefix}.{name}{axis}" for axis in _AXES} for name in columns}
        return {name: v for name, v in columns.items() if not named[name] & lost}

    if lost:
        clean = replace(
            clean,
            controls=kept("ctrl", clean.controls),
            sensors=kept("sensor", clean.sensors),
            torques=kept("torque", clean.torques),
        )
    return clean, found


def check_quality(machine: Machine, run: Run, channels: Sequence[Channel]) -> Iterator[Finding]:
    """Check every channel of one run by itself."""
    moves = {c.name: bool(c.there.size) and bool(np.ptp(c.there) > 0) for c in channels}
    alive = {c.of: any(moves[d.name] for d in channels if d.of == c.of) for c in channels}
    moving = _moving(machine, channels, moves)
    reached = _reached(machine, run, channels)
    for channel in channels:
        yield from _missing(run, channel)
        values, there = channel.there, np.isfinite(channel.values)
        if not values.size:
            continue
        if not moves[channel.name]:
            yield from _stuck(run, channel, alive, moving, reached)
            continue
        starts, lengths = _repeats(values)
        yield from _held(run, channel, lengths)
        if channel.kind in _NOISY:
            yield from _frozen(run, channel, run.time[there], starts, lengths)
            yield from _lost(run, channel, values, run.time[there])
            yield from _clipped(run, channel, values)
        if channel.kind == "command":
            yield from _limited(run, channel, values, machine)
        if channel.kind == "position" and channel.of in run.excited:
            yield from _coarse(run, channel, values, machine)


def _missing(run: Run, channel: Channel) -> Iterator[Finding]:
    share = float(np.mean(np.isnan(channel.values)))
    if share > NOTED_NAN:
        yield Finding(
            check="missing",
            severity="warning" if share > LARGE_NAN else "note",
            run=run.name,
            channel=channel.name,
            found=f"{share:.2%} of the samples are missing (NaN)",
            value=share,
            unit="1",
            consequence="missing samples are interpolated or cut out, and weaken the result",
            remedy="find out why the recorder loses samples; raise gap_s of the column at the "
            "import where pauses belong to it",
        )


def _moving(
    machine: Machine, channels: Sequence[Channel], moves: Mapping[str, bool]
) -> tuple[set[str], set[str]]:
    """Joints that are commanded to move, and those that do."""
    drives = [
        machine.drives[c.of] for c in channels
        if c.kind == "command" and c.of in machine.drives and moves[c.name]
    ]  # fmt: skip
    moved = {c.of for c in channels if c.kind == "position" and moves[c.name]}
    return {drive.joint for drive in drives if drive.follows}, moved


def _reached(machine: Machine, run: Run, channels: Sequence[Channel]) -> set[str]:
    """Axes of accelerometers along which the excited joints move them, in the run's pose.

    However little it is, a reading of it is not constant; a plane arm has axes without any.
    """
    model, data = machine.model, mujoco.MjData(machine.model)
    for joint, q in (run.pose or {}).items():
        data.qpos[int(model.jnt_qposadr[model.joint(joint).id])] = q
    for c in channels:
        if c.kind == "position" and c.there.size:
            data.qpos[int(model.jnt_qposadr[model.joint(c.of).id])] = float(np.mean(c.there))
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    dofs = [int(model.jnt_dofadr[model.joint(joint).id]) for joint in run.excited]
    found = set()
    for sensor in {c.of for c in channels if c.kind == "acceleration"} if dofs else ():
        site, turned = int(model.sensor_objid[model.sensor(sensor).id]), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, turned, None, site)
        moved = np.linalg.norm(data.site_xmat[site].reshape(3, 3).T @ turned[:, dofs], axis=1)
        seen = moved > _ROUNDING * np.linalg.norm(moved)
        found |= {f"sensor.{sensor}.{letter}" for letter, s in zip("xyz", seen, strict=True) if s}
    return found


def _stuck(
    run: Run,
    channel: Channel,
    alive: Mapping[str, bool],
    moving: tuple[set[str], set[str]],
    reached: set[str],
) -> Iterator[Finding]:
    """Judge a channel that holds one value through the run."""
    if channel.kind in ("command", "other"):
        return  # a command that holds a joint is constant
    value = float(channel.there[0])
    excited = channel.of in run.excited
    commanded, moved = moving
    if channel.kind in ("position", "velocity", "torque") and not excited:
        if not run.excited and (channel.of in commanded or (channel.kind == "position" and moved)):
            yield _at_rest(run, channel, value, commanded=channel.of in commanded)
        return  # a joint at rest behind a coarse encoder, or a brake
    if channel.kind in _SITE and not run.excited and not alive[channel.of]:
        return  # nothing is known to move
    dead = channel.kind in _SITE and (not alive[channel.of] or channel.name in reached)
    axis = channel.kind in _SITE and alive[channel.of]
    yield Finding(
        check="stuck",
        severity="error" if excited or dead else "warning",
        run=run.name,
        channel=channel.name,
        found=f"every sample is {value:.6g}"
        + (f", and joint {channel.of} is excited in this run" if excited else "")
        + (", and the other axes of the sensor move" if axis else ""),
        value=value,
        consequence="the channel carries no signal, and its silence is taken for a measurement",
        remedy="repair the axis and record the run again: a sensor is read with all its axes or "
        "none; for 'loose gap' its three columns may be left out of the run"
        if axis
        else "check cable and recorder; leave the column out where the sensor is dead",
    )


def _at_rest(run: Run, channel: Channel, value: float, *, commanded: bool) -> Finding:
    """Joint that rests while others move: a brake, or a dead sensor."""
    return Finding(
        check="stuck",
        severity="warning" if commanded else "note",
        run=run.name,
        channel=channel.name,
        found=f"every sample is {value:.6g}"
        + (", and the joint is commanded to move" if commanded else ", and other joints move"),
        value=value,
        consequence="a joint at rest, or a sensor whose silence is taken for a measurement",
        remedy="look whether the joint moved; leave the column out where its sensor is dead",
    )


def _repeats(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples and lengths of the pieces of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


def _held(run: Run, channel: Channel, lengths: NDArray[np.intp]) -> Iterator[Finding]:
    """Note a channel whose values change after every few rows alone."""
    if len(lengths) < FEWEST_PIECES or channel.kind == "command":
        return
    usual = int(np.median(lengths))
    if usual < 2 or np.mean(np.abs(lengths - usual) <= 0) < HELD_SHARE:
        return
    rate = 1 / (usual * median_step(run.time))
    yield Finding(
        check="held",
        severity="note",
        run=run.name,
        channel=channel.name,
        found=f"changes every {usual} rows: its own rate is {rate:.4g} Hz",
        value=rate,
        unit="Hz",
        consequence=f"it carries nothing above {rate / 2:.4g} Hz, and holding its values delays "
        f"them by {1e3 / (2 * rate):.3g} ms on average",
        remedy="import the slower file as a source of its own: it is interpolated band-limited",
    )


def _frozen(
    run: Run, channel: Channel, time: Array, starts: NDArray[np.intp], lengths: NDArray[np.intp]
) -> Iterator[Finding]:
    step = median_step(run.time)
    usual = float(np.percentile(lengths, 90))
    least = max(FROZEN_SAMPLES, FROZEN_S / step, FROZEN_RATIO * usual)
    if np.mean(lengths > 1) > REPEATING_SHARE:
        return  # coarse or slow: it repeats by itself
    long = np.flatnonzero(lengths >= least)
    if not long.size:
        return
    worst = int(long[np.argmax(lengths[long])])
    seconds = float(lengths[worst] * step)
    yield Finding(
        check="dropout",
        severity="warning",
        run=run.name,
        channel=channel.name,
        found=f"stands still {long.size} time{'s' * (long.size > 1)}, longest {seconds:.3g} s from "
        f"{time[starts[worst]]:.4g} s on",
        value=seconds,
        unit="s",
        consequence="a repeated reading is taken for a measured one",
        remedy="write missing samples as NaN, or cut the run",
    )


def _lost(run: Run, channel: Channel, values: Array, time: Array) -> Iterator[Finding]:
    middle = float(np.median(values))
    scatter = 1.4826 * float(np.median(np.abs(values - middle)))
    if abs(middle) < LOST_RATIO * scatter or middle == 0.0:
        return  # zero is an ordinary value
    starts, lengths = _repeats((values == 0.0).astype(float))
    lost = [
        (int(s), int(n))
        for s, n in zip(starts, lengths, strict=True)
        if values[s] == 0.0 and n >= LOST_VALUE
    ]
    if lost:
        count = sum(n for _, n in lost)
        yield Finding(
            check="dropout",
            severity="warning",
            run=run.name,
            channel=channel.name,
            found=f"{count} samples are exactly 0 while the channel reads {middle:.4g}, first at "
            f"{time[lost[0][0]]:.4g} s",
            value=float(count),
            unit="samples",
            consequence="a lost reading is taken for a measured one",
            remedy="write missing samples as NaN, or cut the run",
        )


def _clipped(run: Run, channel: Channel, values: Array) -> Iterator[Finding]:
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < FEWEST_LEVELS:
        return  # too coarse to tell
    for extreme, beside in ((0, slice(1, 6)), (-1, slice(-6, -1))):
        count = int(counts[extreme])
        if count < max(CLIPPED_LEAST, CLIPPED_SHARE * len(values)):
            continue
        if count < CLIPPED_PILE * counts[beside].max():
            continue
        at_zero = channel.kind in ("torque", "velocity") and levels[extreme] == 0.0
        if at_zero or values[0] == levels[extreme] or values[-1] == levels[extreme]:
            continue  # rest before or after the motion
        yield Finding(
            check="saturation",
            severity="warning",
            run=run.name,
            channel=channel.name,
            found=f"{count} samples ({count / len(values):.2%}) are at the limit of "
            f"{levels[extreme]:.6g}",
            value=count / len(values),
            unit="1",
            consequence="a clipped signal has frequencies that the motion has not",
            remedy="lower the excitation, or choose a larger range of the sensor",
        )


def _limited(run: Run, channel: Channel, values: Array, machine: Machine) -> Iterator[Finding]:
    drive = machine.drives.get(channel.of)
    if drive is None or drive.limits is None:
        return
    low, high = drive.limits
    slack = 1e-6 * (high - low)
    share = float(np.mean((values <= low + slack) | (values >= high - slack)))
    # A joint that rests at the end of its range is commanded to stay there.
    starts, _ = _repeats(((values <= low + slack) | (values >= high - slack)).astype(float))
    if share > LIMITED_SHARE and len(starts) > FEWEST_PIECES and not drive.follows:
        yield Finding(
            check="saturation",
            severity="warning",
            run=run.name,
            channel=channel.name,
            found=f"{share:.1%} of the commands are at a limit of the actuator ({low:g} to "
            f"{high:g})",
            value=share,
            unit="1",
            consequence="a clipped command excites frequencies outside its band",
            remedy="lower the excitation",
        )


def _coarse(run: Run, channel: Channel, values: Array, machine: Machine) -> Iterator[Finding]:
    levels = np.unique(values)
    if len(levels) > COARSE_LEVELS:
        return
    step = float(np.min(np.diff(levels)))
    motion = float(np.std(values))
    if step <= COARSE_STEP * motion:
        return
    unit = machine.unit(channel.of)
    yield Finding(
        check="quantisation",
        severity="warning",
        run=run.name,
        channel=channel.name,
        found=f"resolves {step:.3g} {unit}, and the excited joint moves by {motion:.3g} {unit} rms",
        value=step,
        unit=unit,
        consequence="rounding hides the motion of the joint, and the transmission to the tool is "
        "then known from the command alone",
        remedy="excite the joint more, at lower frequencies too, or record a finer encoder",
    )
