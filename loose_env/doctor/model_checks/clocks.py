"""Check of clock offsets and signs by the phase delay between two channels of one motion.

Of the coherent lines, each with the weight coherence / (1 - coherence), the inverse variance of its
phase up to a factor; see `loose_env.statistics.phase_delay`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import signal

from loose_env.doctor.channels import Channel, Factors, Machine, Runs, filled, positions
from loose_env.doctor.corrections import Correction
from loose_env.doctor.entries import positions_in
from loose_env.doctor.findings import Finding, Severity
from loose_env.doctor.model_checks.forces import recorded_forces
from loose_env.doctor.model_checks.motion import Motion, carried, sampled_motion
from loose_env.doctor.model_checks.units import ACCELERATION, ANGLE, LENGTH, inverse, named_unit
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import (
    BAND_SHARE,
    COHERENT,
    DELAY_SCATTER,
    DELAY_Z,
    FEWEST_LINES,
    FLIPPED_SHARE,
    HIGHEST_LINE_HZ,
    LARGEST_DELAY_S,
    LARGEST_LAG_S,
    LATE_COMMAND_S,
    LEAST_PHASE_RAD,
    LEAST_POWER,
    MOST_SPECTRA,
    NOTED_DELAY_S,
    PHASE_FIT,
    RIVAL_FIT,
    SEGMENTS,
    WEAK_AXIS,
)
from loose_env.importing import median_step
from loose_env.recording import Run
from loose_env.statistics import phase_delay
from loose_env.typing import Array

_NEIGHBOURS = 1.5
"""Lines of a Hann window that are worth one."""


class Delay(NamedTuple):
    """Delay of one channel behind another."""

    seconds: float
    """Positive where it is late [s]."""
    sd: float
    """Standard deviation [s]."""
    sign: int
    """-1 where one is the negative of the other."""
    ratio: float
    """Amplitude over that of the other, median over the lines."""
    middle_hz: float
    """Rms frequency of the lines [Hz]."""


class _Seen(NamedTuple):
    run: Run
    channel: str
    kind: str
    of: str
    delay: Delay


def delay_between(
    x: Array, y: Array, step: float, *, largest: float = LARGEST_DELAY_S
) -> Delay | None:
    """Delay of y behind x by the phase of their coherent lines.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x = signal.sosfilt(
    ...     signal.butter(4, (30, 150), "bandpass", fs=1000, output="sos"), rng.normal(size=4010)
    ... )
    >>> found = delay_between(x[10:], -x[5:-5] + 0.01 * rng.normal(size=4000), 0.001)
    >>> round(found.seconds, 4), found.sign
    (0.005, -1)
    """
    length = min(len(x), len(y))
    if length < 16 * SEGMENTS:
        return None
    size = 2 * length // (SEGMENTS + 1)
    x, y = signal.detrend(x[:length]), signal.detrend(y[:length])
    frequency, cross = signal.csd(x, y, 1 / step, nperseg=size)
    _, own = signal.welch(x, 1 / step, nperseg=size)
    _, other = signal.welch(y, 1 / step, nperseg=size)
    both = own * other
    coherence = np.where(both > 0, np.abs(cross) ** 2 / np.maximum(both, 1e-300), 0.0)
    used = (
        (coherence > COHERENT)
        & (frequency < min(BAND_SHARE / step, HIGHEST_LINE_HZ))
        & (frequency > 1.5 * frequency[1])
    )
    used &= own > LEAST_POWER * own[1:].max(initial=0.0)
    if np.count_nonzero(used) < FEWEST_LINES:
        return None
    at, share = frequency[used], np.minimum(coherence[used], 0.99)
    # Lines far above the others would decide alone, though the model errs at them as much.
    weight = share / (1 - share)
    weight = np.minimum(weight, 4 * np.median(weight))
    found = phase_delay(at, cross[used], weight, largest=largest, either_sign=True)
    if found is None or found.fit < PHASE_FIT or found.rival > RIVAL_FIT:
        return None
    weight /= weight.sum()
    ratio = float(np.median(np.abs(cross[used]) / own[used]))
    sd = max(np.sqrt(_NEIGHBOURS) * found.sd, 0.02 * step)
    middle = float(np.sqrt(np.sum(weight * at**2)))
    return Delay(found.seconds, sd, found.sign, ratio, middle)


def check_clocks(
    machine: Machine,
    runs: Runs,
    factors: Factors,
    settings: DoctorSettings,
) -> Iterator[Finding]:
    """Compare accelerometers, gyroscopes, velocities, torques and commands with the encoders."""
    seen: list[_Seen] = []
    chosen = np.unique(np.linspace(0, len(runs) - 1, MOST_SPECTRA).astype(int))
    for k in chosen:
        run, channels = runs[int(k)]
        if positions(channels):
            motion = sampled_motion(machine, run, channels, factors)
            if len(motion.time) > 16 * SEGMENTS:
                seen += _seen(machine, run, channels, motion)
                seen += _followed(machine, run, channels, motion, factors)
    groups: dict[tuple[str, str], list[_Seen]] = {}
    for each in seen:
        groups.setdefault((each.kind, each.of), []).append(each)
    for (kind, of), group in groups.items():
        if kind != "servo":
            yield from _signs(machine, kind, group)
        yield from _offset(kind, of, group, settings)


def _seen(
    machine: Machine, run: Run, channels: Sequence[Channel], motion: Motion
) -> Iterator[_Seen]:
    model = machine.model
    for channel in channels:
        if channel.kind not in ("acceleration", "turning", "velocity"):
            continue
        if channel.kind == "velocity":
            if channel.of not in positions(channels):
                continue
            sensor, axis = channel.name.removeprefix("sensor."), 0
        else:
            sensor, axis = channel.of, "xyz".index(channel.name[-1])
            if not carried(machine, sensor, motion.known):
                continue
        at = int(model.sensor_adr[model.sensor(sensor).id])
        width = int(model.sensor_dim[model.sensor(sensor).id])
        implied = motion.readings[:, at : at + width]
        spread = implied.std(axis=0)
        if spread[axis] < WEAK_AXIS * spread.max() or spread.max() == 0.0:
            continue
        read = np.interp(motion.time, run.time, filled(run.time, channel.values))
        found = delay_between(implied[:, axis], read, motion.step)
        if found is not None:
            yield _Seen(run, channel.name, channel.kind, channel.of, found)
    if set(machine.joints) <= motion.known:
        for joint, (column, values) in recorded_forces(machine, run, channels).items():
            if joint in run.excited:
                dof = int(model.jnt_dofadr[model.joint(joint).id])
                read = np.interp(motion.time, run.time, values)
                found = delay_between(motion.torques[:, dof], read, motion.step)
                if found is not None:
                    yield _Seen(run, column, "torque", "torques and commands", found)


def _followed(
    machine: Machine,
    run: Run,
    channels: Sequence[Channel],
    motion: Motion,
    factors: Factors,
) -> Iterator[_Seen]:
    """Delays of joints behind the commands of their position servos."""
    measured = positions_in(run, channels, factors)
    for channel in channels:
        drive = machine.drives.get(channel.of) if channel.kind == "command" else None
        if drive is None or not drive.follows or drive.joint not in measured:
            continue
        command = np.interp(motion.time, run.time, filled(run.time, channel.values))
        read = np.interp(motion.time, run.time, measured[drive.joint])
        found = delay_between(command, read, motion.step, largest=LARGEST_LAG_S)
        if found is not None:
            found = found._replace(seconds=found.seconds - drive.lag)
            yield _Seen(run, channel.name, "servo", "position commands", found)


def _signs(machine: Machine, kind: str, group: Sequence[_Seen]) -> Iterator[Finding]:
    for name in dict.fromkeys(each.channel for each in group):
        own = [each.delay for each in group if each.channel == name]
        flipped = sum(d.sign < 0 for d in own)
        # A resonance of one pose turns a phase by pi as well: most runs have to agree.
        if flipped > FLIPPED_SHARE * len(own) and (len(own) > 1 or kind == "velocity"):
            yield Finding(
                check="sign",
                severity=_severity(kind),
                channel=name,
                found=f"runs against the motion of the joints in {flipped} of {len(own)} runs",
                value=float(flipped),
                unit="runs",
                consequence="directions found by it are mirrored",
                remedy="import the column with sign = -1, or turn the sensor's site in the model",
                fix=Correction(kind="scale", columns=(name,), factor=-1.0)
                if kind == "velocity"
                else None,
            )
        units = {"acceleration": ACCELERATION, "turning": ANGLE, "torque": {}}.get(kind)
        if units is None:
            of = next(each.of for each in group)
            units = ANGLE if machine.hinge(of) else LENGTH
        ratio = float(np.median([d.ratio for d in own]))
        words = named_unit(ratio, units) or named_unit(
            inverse(ratio), ANGLE if units is ANGLE else {}
        )
        if words is not None:
            yield Finding(
                check="units",
                severity=_severity(kind),
                channel=name,
                found=f"{ratio:.3g} times what the motion of the joints implies: {words}",
                value=ratio,
                unit="1",
                consequence="readings and positions are taken for different motions",
                remedy="import the column with its unit, or convert it",
            )


def _severity(kind: str) -> Severity:
    """An error where kinematics tell; a rigid arm's dynamics are no judge above a resonance."""
    return "error" if kind in _KINEMATIC else "note"


_KINEMATIC = ("velocity", "turning")


_WORDS = {"acceleration": "accelerometer", "turning": "gyroscope"}


def _offset(
    kind: str, of: str, group: Sequence[_Seen], settings: DoctorSettings
) -> Iterator[Finding]:
    delays = np.array([each.delay.seconds for each in group])
    sds = np.array([each.delay.sd for each in group])
    middle = float(np.median([each.delay.middle_hz for each in group]))
    late = float(np.median(delays))
    scatter = 1.4826 * float(np.median(np.abs(delays - late)))
    sd = float(np.hypot(np.median(sds), scatter) / np.sqrt(len(delays)))
    size = abs(late)
    if (
        size < DELAY_Z * sd
        or 2 * np.pi * middle * size < LEAST_PHASE_RAD
        or scatter > DELAY_SCATTER * size
    ):
        return
    step = float(np.median([median_step(each.run.time) for each in group]))
    # Simulators and buses differ by up to a sample in what they call one moment.
    if size < max(LATE_COMMAND_S if kind == "servo" else NOTED_DELAY_S, step):
        return
    word = "late" if late > 0 else "early"
    runs = len({each.run.name for each in group})
    tail = f"{1e3 * size:.1f} ms {word} (standard deviation {1e3 * sd:.2g} ms, {runs} runs)"
    if kind == "servo":
        if late < 0:
            return  # stiffer than the model's
        yield Finding(
            check="clock",
            severity="note",
            channel="ctrl",
            found=f"the joints follow their commands {tail} beside the delay of the model's servos",
            value=late,
            unit="s",
            consequence="the nominal model does not have this delay of the drives or of the clock "
            "of the commands",
            remedy="'loose gap' identifies it; where the clocks differ, set delay_s at the import",
        )
        return
    channel = f"sensor.{of}" if kind in _WORDS else group[0].channel
    noun = _WORDS.get(kind, "recorder of the velocity" if kind == "velocity" else of)
    subject = f"the {noun}'s clock is" if kind in _WORDS else f"the {noun} are" if (
        kind == "torque") else f"the {noun} is"  # fmt: skip
    cycles, kinematic = 360 * size * middle, kind in _KINEMATIC
    yield Finding(
        check="clock",
        severity="warning" if size >= max(settings.clock_s, 1.5 * step) else "note",
        channel=channel,
        found=f"{subject} {tail} against the joint encoders",
        value=late,
        unit="s",
        consequence=f"{cycles:.0f} degrees of phase at {middle:.3g} Hz, which may pass for a loose "
        "link or a compliance",
        remedy=f"import its columns with delay_s = {late:.4f}"
        if kinematic
        else "a resonance of a gear looks the same: shift data only by what a tap on the tool "
        "shows in both",
    )
