"""Clock offsets by the phase delay between a channel and what the encoders or a command imply.

A clock changes the phase of every line by 2 pi f d and the amplitude of none; a resonance between
two sensors changes both. An offset is therefore told by rigid lines alone, those with the amplitude
that the encoders imply, up to the frequency where they become few. Each has the weight
coherence / (1 - coherence), the inverse variance of its phase up to a factor; see
`loose_env.statistics.phase_delay`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from loose_env.doctor.findings import Defect, DoctorSettings, Finding
from loose_env.doctor.machine import Machine, Motion, forces_of, positions_of, servos_of
from loose_env.doctor.signals import implied_readings
from loose_env.importing import early_by, filled
from loose_env.statistics import phase_delay
from loose_env.typing import Array, ComplexArray

# Clocks
COHERENT = 0.7
"""Coherence of a line, from which its phase is used: its standard deviation over eight averages is
0.16 rad."""
HIGHEST_LINE = 0.4
"""Highest line used over the sampling rate: anti-aliasing filters need the rest."""
HIGHEST_LINE_HZ = 500.0
"""Highest line used [Hz]: above, no arm between two sensors is rigid."""
LEAST_POWER = 1e-4
"""Power of a line over that of the strongest, below which its phase is not used: leakage of the
window is as large."""
FEWEST_LINES = 6
"""Coherent lines that an estimate of a delay needs: fewer fit any delay."""
SEGMENTS = 8
"""Segments of a run whose spectra are averaged: the scatter of a coherence is then 0.1."""
FLAT = 0.25
"""Logarithm of a line's amplitude over the implied one, above which it is not rigid: the least
coherent scatter by 0.16, and up to half a resonance's frequency gains rise by 0.3."""
MOSTLY = 0.75
"""Share of rigid lines, down to which the lines below a frequency are used: beyond a resonance a
few have the right amplitude by chance."""
LARGEST_DELAY_S = 0.05
"""Largest clock offset searched [s]: three periods at the lower end of a usual band."""
LARGEST_LAG_S = 0.4
"""Largest delay behind a position command searched [s]: hobby servos on a bus are 0.2 s late."""
PHASE_FIT = 0.85
"""Mean resultant length of the phases after the delay is taken out, from which it is believed:
resonances between the two sensors turn the phase and leave less."""
RIVAL_FIT = 0.93
"""Fit of another delay over the best one, from which the delay is ambiguous: a few lines of noise
decide between them."""
DELAY_Z = 4.0
"""Delay over its standard deviation, from which it is told: errors of the model are alike over
lines and runs, and the standard deviation counts them as independent."""
LEAST_PHASE_RAD = 0.1
"""Phase at the middle of the lines that a delay has to make to be told [rad]: sensors' filters and
mounting make as much."""
DELAY_SCATTER = 0.5
"""Scatter of the delay over runs and axes in units of the delay, above which it is no clock's: a
clock is late by the same time in all."""
NOTED_DELAY_S = 5e-4
"""Delay from which it is told [s]: five standard deviations that a diagnosis allows for."""
LATE_COMMAND_S = 0.02
"""Delay of motion behind a position command beside that of the model's servo, from which it is told
[s]: buses and drives of industrial arms take less."""

_NEIGHBOURS = 1.5
"""Lines of a Hann window that are worth one."""
_SENSORS = {"acceleration": "accelerometer's clock", "turning": "gyroscope's clock"}
_TAP = "a compliance looks the same: shift data only by what a tap on the tool shows in both"
_OFFSET = Defect("clock", "note", "phase that may pass for a loose link or a compliance", _TAP)
_LAG = Defect(
    "clock", "note",
    "the nominal model does not have this delay of the drives or of the clock of the commands",
    "'loose gap' identifies it; where the clocks differ, set delay_s at the import",
)  # fmt: skip
_LEAD = Defect(
    "clock", "warning",
    "no joint moves before its command: the commands were logged late, or sampled from references "
    "that the controller had interpolated already",
    "import the commands with delay_s = the time by which they are late",
)  # fmt: skip
_EARLY = Defect(
    "clock", "warning",
    "commands taken as held leave residuals at every joint where the controller interpolates them",
    'import again, or add "commands": {"ACTUATOR": {"mode": "linear"}} to the runs of '
    "recording.json",
)  # fmt: skip


class Delay(NamedTuple):
    """Delay of one channel behind another."""

    seconds: float
    """Positive where it is late [s]."""
    sd: float
    """Standard deviation [s]."""
    middle_hz: float
    """Rms frequency of the lines [Hz]."""


class _Seen(NamedTuple):
    motion: Motion
    channel: str
    delay: Delay
    lag: float = 0.0
    """Delay that the model has itself [s]."""


def delay_between(
    x: Array, y: Array, step: float, *, largest: float = LARGEST_DELAY_S, rigid: bool = True
) -> Delay | None:
    """Delay of y behind x by the phase of their coherent lines; None where no delay explains it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> from loose_env.statistics import bandpass
    >>> x = bandpass(rng.normal(size=4010), 1000, (30, 150))
    >>> found = delay_between(x[10:], -x[5:-5] + 0.01 * rng.normal(size=4000), 0.001)
    >>> round(found.seconds, 4)
    0.005
    """
    if len(x) < 16 * SEGMENTS:
        return None
    size = 2 * len(x) // (SEGMENTS + 1)
    frequency = np.asarray(np.fft.rfftfreq(size, step), dtype=float)
    own, cross, other = _spectra(x, y, size)
    coherence = np.abs(cross) ** 2 / np.maximum(own * other, 1e-300)
    used = (coherence > COHERENT) & (own > LEAST_POWER * own[1:].max(initial=0.0))
    used &= (frequency > 1.5 * frequency[1]) & (
        frequency < min(HIGHEST_LINE / step, HIGHEST_LINE_HZ)
    )
    lines = np.flatnonzero(used)
    if rigid:
        gain = np.log(np.maximum(np.abs(cross), 1e-300) / np.maximum(own, 1e-300))[lines]
        as_implied = np.abs(gain) <= FLAT
        enough = np.cumsum(as_implied) >= MOSTLY * np.arange(1, len(lines) + 1)
        last = int(np.flatnonzero(enough)[-1]) + 1 if enough.any() else 0
        lines = lines[:last][as_implied[:last]]
    if len(lines) < FEWEST_LINES:
        return None
    at, share = frequency[lines], np.minimum(coherence[lines], 0.99)
    # Lines far above the others would decide alone, though the model errs at them as much.
    weight = share / (1 - share)
    weight = np.minimum(weight, 4 * np.median(weight))
    found = phase_delay(at, cross[lines], weight, largest=largest, either_sign=True)
    if found is None or found.fit < PHASE_FIT or found.rival > RIVAL_FIT:
        return None
    sd = max(np.sqrt(_NEIGHBOURS) * found.sd, 0.02 * step)
    return Delay(found.seconds, sd, float(np.sqrt(np.sum(weight * at**2) / weight.sum())))


def _spectra(x: Array, y: Array, size: int) -> tuple[Array, ComplexArray, Array]:
    """Power of x, cross-spectrum conj(X) Y and power of y, by half-overlapping Hann segments."""
    line, found = np.linspace(-1, 1, len(x)), []
    for values in (x, y):
        plain = values - values.mean()
        plain -= line * (line @ plain) / (line @ line)
        parts = sliding_window_view(plain, size)[:: size - size // 2]
        parts = (parts - parts.mean(axis=1, keepdims=True)) * np.hanning(size + 1)[:-1]
        found.append(np.fft.rfft(parts, axis=1))
    a, b = found
    return (abs(a) ** 2).mean(0), (np.conj(a) * b).mean(0), (abs(b) ** 2).mean(0)


def check_clocks(
    machine: Machine, motions: Sequence[Motion], settings: DoctorSettings
) -> Iterator[Finding]:
    """Compare accelerometers, gyroscopes, velocities, torques and commands with the encoders."""
    groups: dict[str, list[_Seen]] = {}
    for motion in motions:
        if positions_of(machine, motion.run):
            for kind, seen in _seen(machine, motion):
                groups.setdefault(kind, []).append(seen)
    for kind, group in groups.items():
        yield from _offset(kind, group, settings)
    runs = [each.run for each in motions if not each.run.excited]  # noise is not simulated
    if early := early_by(machine.model, runs):
        found = f"the drives act {1e3 * early:.3g} ms before the commands as the runs have them"
        yield _EARLY.at("ctrl", found, -early, unit="s")


def _seen(machine: Machine, motion: Motion) -> Iterator[tuple[str, _Seen]]:
    """Delays of all channels of a run, by the clock that they have."""
    run, step = motion.run, float(motion.edges[1] - motion.edges[0])
    for c, implied in implied_readings(machine, motion):
        found = delay_between(implied, motion.mean(c.values), step)
        if found is not None:
            clock = f"{_SENSORS.get(c.kind, 'recorder of the velocity')} of {c.of}"
            yield clock, _Seen(motion, c.name if c.kind == "velocity" else f"sensor.{c.of}", found)
    if set(machine.joints) <= motion.known:
        for joint, (column, values) in forces_of(machine, run).items():
            if joint in run.excited:
                dof = int(machine.model.jnt_dofadr[machine.model.joint(joint).id])
                found = delay_between(motion.torques[:, dof], motion.mean(values), step)
                if found is not None:
                    yield "torques and commands", _Seen(motion, column, found)
    measured = positions_of(machine, run)
    for drive, command in servos_of(machine, run):
        if drive.joint in measured:
            read = motion.mean(filled(run.time, measured[drive.joint].values))
            given = motion.mean(command)
            found = delay_between(given, read, step, largest=LARGEST_LAG_S, rigid=False)
            if found is not None:
                yield "servo", _Seen(motion, f"ctrl.{drive.name}", found, drive.lag)


def _offset(kind: str, group: Sequence[_Seen], settings: DoctorSettings) -> Iterator[Finding]:
    """Judge one clock by the delays of its channels in all runs."""
    delays = np.array([each.delay.seconds for each in group])
    middle = float(np.median([each.delay.middle_hz for each in group]))
    late = float(np.median(delays))
    scatter = 1.4826 * float(np.median(np.abs(delays - late)))
    sd = float(np.hypot(np.median([each.delay.sd for each in group]), scatter) / len(delays) ** 0.5)
    # Simulators and buses differ by up to a sample in what they call one moment.
    step = float(np.median([each.motion.edges[1] - each.motion.edges[0] for each in group]))
    lead = kind == "servo" and late < 0
    if kind == "servo" and not lead:
        late -= float(np.median([each.lag for each in group]))
        if late < LATE_COMMAND_S:
            return  # stiffer than the model's, or of the usual buses and drives
    size = abs(late)
    scattered = size < DELAY_Z * sd or scatter > DELAY_SCATTER * size
    if scattered or size < max(NOTED_DELAY_S, step) or 2 * np.pi * middle * size < LEAST_PHASE_RAD:
        return
    runs = len({each.motion.run.name for each in group})
    word = "late" if late > 0 else "early"
    tail = f"{1e3 * size:.1f} ms {word} (standard deviation {1e3 * sd:.2g} ms, {runs} runs)"
    if lead:
        found = f"the joints move before their commands: {tail}"
        yield _LEAD.at("ctrl", found, late, unit="s")
    elif kind == "servo":
        found = f"the joints follow their commands {tail} beside the delay of the model's servos"
        yield _LAG.at("ctrl", found, late, unit="s")
    else:
        verb = "are" if kind.startswith("torques") else "is"
        subject = kind.rpartition(" of ")[0] if "clock" in kind else kind
        kinematic = "gyroscope" in kind or "velocity" in kind
        cycles = (
            f"{360 * size * middle:.0f} degrees of phase at {middle:.3g} Hz, which may pass for "
        )
        yield _OFFSET.at(
            group[0].channel, f"the {subject} {verb} {tail} against the joint encoders", late,
            unit="s", consequence=cycles + "a loose link or a compliance",
            remedy=f"import its columns with delay_s = {late:.4f}" if kinematic else _TAP,
            severity="warning" if size >= max(settings.clock_s, 1.5 * step) else "note",
        )  # fmt: skip
