"""Fourier coefficients of a run's commands and readings in the excited band, with sensor noise.

The commands of a real recorder do not repeat after the record, so records are tapered (Hann)
before they are transformed; what a linear arm answers then holds line by line wherever the taper
is long against the arm's memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from loose_env.errors import InvalidData
from loose_env.instrument.data.held_pose import tool_force_in
from loose_env.instrument.data.sensor_noise import quantum, sensor_noise
from loose_env.instrument.data.sensor_selection import readings_in
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.readings import Reading
from loose_env.instrument.settings.thresholds import (
    HIGHEST_LINE,
    LARGEST_COMMAND,
    LEAST_LINE_POWER,
    LOWEST_HZ,
    LOWEST_PATH_LINE,
    POSITION_INFORMATION,
)
from loose_env.recording import Run
from loose_env.typing import Array, ComplexArray

_MOST = 20_000
"""Most lines of a run that are kept, evenly spread."""
_SMOOTH = 3.0
"""Width over which powers are averaged [Hz]."""
_INDEPENDENT = 1.5
"""Lines of a tapered record that are worth one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """Spectral lines of one run: K lines, A commands, c channels."""

    run: str
    """File of the run."""
    number: int
    """Index of the run among those evaluated together, from 0."""
    pose: Array
    """Pose held (n,) [rad or m]."""
    healthy: bool
    """True if the run is a reference of the healthy arm."""
    excited: NDArray[np.intp]
    """Joints that were excited, from 0."""
    frequency: Array
    """Frequencies (K,) [Hz]."""
    command: ComplexArray
    """Commands of the drives' actuators (K, A); zero where none was recorded."""
    force: ComplexArray
    """Measured forces of the joints that stand for their drives (K, n)."""
    lean: tuple[ComplexArray, ComplexArray]
    """Commands (K, A) and forces (K, n) that the taper leaks in from the next lines: what they do
    goes with the difference between the arm's answers there and here."""
    tool_force: ComplexArray
    """Measured force on the tool in its axes (K, 3); zero where none was."""
    tool_lean: ComplexArray
    """The same as `lean` (K, 3)."""
    leaked: ComplexArray
    """Readings that this makes (K, c); zero until
    `loose_env.instrument.inference.response.frequency_response.with_leakage`."""
    measured: NDArray[np.bool_]
    """Joints whose force was measured and stands for their drives (n,)."""
    blind: NDArray[np.bool_]
    """Joints of whose drive nothing is known (n,)."""
    readings: ComplexArray
    """All readings (K, c)."""
    row: tuple[tuple[Reading, int], ...]
    """Sensor and axis of each reading (c,)."""
    noise: Array
    """Variance of what the sensors add (K, c)."""
    read: NDArray[np.bool_]
    """True where a line is below the sensor's bandwidth (K, c)."""
    power: Array
    """Smoothed power against which errors of the model are measured (K, c)."""
    independent: float
    """Independent values per line [1]."""
    next: float
    """Frequency from a line of the whole transform to the next one [Hz]."""
    folded: float
    """Expected aliasing of motion above the Nyquist frequency, 0 to 1."""
    sampled: float
    """Share of a command's step in the readings: 0 where filters smooth it, 1 where they are
    read just after it."""
    period: float
    """Time for which a command is held [s]."""
    seconds: float
    """Length of the run [s]."""
    beside: Lines | None = None
    """The same run of the healthy arm at the same lines, with which it is compared; None where
    there is none."""

    @property
    def spacing(self) -> float:
        """Line spacing [Hz]."""
        return float(np.median(np.diff(self.frequency)))

    def at_lines(self, kept: NDArray[np.intp]) -> Lines:
        """Subset of the lines."""
        names = (
            "frequency", "command", "force", "tool_force", "tool_lean", "leaked", "readings",
            "noise", "read", "power",
        )  # fmt: skip
        fewer = {name: getattr(self, name)[kept] for name in names}
        lean = self.lean[0][kept], self.lean[1][kept]
        beside = None if self.beside is None else self.beside.at_lines(kept)
        return replace(self, **fewer, lean=lean, beside=beside)

    def at_channels(self, kept: Sequence[int]) -> Lines:
        """Subset of the readings."""
        names = ("leaked", "readings", "noise", "read", "power")
        fewer = {name: getattr(self, name)[:, kept] for name in names}
        return replace(self, **fewer, row=tuple(self.row[k] for k in kept))


def thinned(lines: Lines, most: int) -> Lines:
    """Subset of a run's lines, evenly spread over the band."""
    if len(lines.frequency) <= most:
        return lines
    return lines.at_lines(np.linspace(0, len(lines.frequency) - 1, most).round().astype(np.intp))


def uniform(time: Array, values: Array) -> tuple[float, Array]:
    """Samples at a uniform rate, by linear interpolation.

    Made for runs without pauses, see `loose_env.instrument.data.dropouts`: the number of even
    samples is that of the time.

    Examples
    --------
    >>> time, values = np.array([0.0, 0.1, 0.2, 0.4]), np.array([[0.0], [np.nan], [2.0], [4.0]])
    >>> rate, even = uniform(time, values)
    >>> round(rate, 6), even.ravel().round(6).tolist()
    (10.0, [0.0, 1.0, 2.0, 3.0, 4.0])
    """
    step = float(np.median(np.diff(time)))
    count = int(np.floor((time[-1] - time[0]) / step + 1e-6)) + 1
    even = time[0] + step * np.arange(count)
    out = np.empty((count, values.shape[1]))
    for k, column in enumerate(values.T):
        there = np.isfinite(column)
        if not there.any():
            out[:, k] = 0.0
        elif there.all() and len(time) == count and np.abs(even - time).max() < 0.02 * step:
            out[:, k] = column
        else:
            out[:, k] = np.interp(even, time[there], column[there])
    return 1 / step, out


def lines_of(
    arm: InstrumentedArm,
    run: Run,
    pose: Array,
    excited: NDArray[np.intp],
    *,
    number: int = 0,
    whole: bool = False,
) -> Lines:
    """Transform a run to the frequency domain."""
    rows = tuple((r, axis) for r in readings_in(arm, run)[0] for axis in range(r.axes))
    if not any(r.kind == "acceleration" for r, _ in rows):
        names = [r.sensor for r in arm.readings if r.kind == "acceleration"]
        raise InvalidData(
            f"{run.name}: no accelerometer of the arm was recorded, or it stands still; the model "
            f"has {names}: record 'sensor.{names[0]}.x', '.y' and '.z'"
        )
    drives, n = arm.actuators, arm.n
    columns = [
        run.sensors[r.sensor] if r.axes == 1 else run.sensors[r.sensor][:, axis] for r, axis in rows
    ]
    commands = [run.controls.get(a, np.zeros(run.samples)) for a in drives.names]
    forces = [run.torques.get(j, np.zeros(run.samples)) for j in arm.joints]
    quanta = np.array([quantum(column) for column in columns])
    pushes = [np.zeros(run.samples)] * 3
    if tool_force_in(arm, run):
        pushes = list(run.sensors[str(arm.tool_force)].T)
    rate, even = uniform(run.time, np.stack([*columns, *commands, *forces, *pushes], axis=1))
    c, a = len(rows), len(commands)
    if not np.abs(even[:, c:]).max(initial=0.0) < LARGEST_COMMAND:
        raise InvalidData(
            f"{run.name}: commands or torques beyond {LARGEST_COMMAND:g} are no arm's"
        )
    driven = np.zeros(n, dtype=bool)
    for name in drives.names:
        if name in run.controls:
            driven[arm.actuators.driven_joint(name)] = True
    recorded = np.array([j in run.torques for j in arm.joints])
    measured = recorded & ~driven
    has_servo = drives.stiffness > 0
    # A joint without a command on record is held by its servo, if it has one and rests.
    resting = has_servo & ~driven & ~measured
    resting[excited] = False
    blind = ~driven & ~measured & ~resting
    return _lines(
        arm, run, rate, even, rows, quanta, a,
        number=number, pose=pose, excited=excited, measured=measured, blind=blind, whole=whole,
    )  # fmt: skip


def _lines(
    arm: InstrumentedArm,
    run: Run,
    rate: float,
    even: Array,
    rows: tuple[tuple[Reading, int], ...],
    quanta: Array,
    a: int,
    *,
    number: int,
    pose: Array,
    excited: NDArray[np.intp],
    measured: NDArray[np.bool_],
    blind: NDArray[np.bool_],
    whole: bool,
) -> Lines:
    count, c = len(even), len(rows)
    # A force on the tool moves servos at their own modes too, whose gains are the least known.
    struck = bool(np.abs(even[:, -3:]).max(initial=0.0) > 0)
    lowest = max(LOWEST_HZ, arm.nominal.band[0]) if struck else LOWEST_HZ
    taper = signal.windows.hann(count, sym=False)
    taper /= np.sqrt(np.mean(taper**2))
    even = signal.detrend(even, axis=0)
    spectrum = np.fft.rfft(even * taper[:, None], axis=0)
    plain = np.fft.rfft(even[:, c:], axis=0)
    lean = 0.5 * float(taper.mean()) * (np.roll(plain, 1, axis=0) - np.roll(plain, -1, axis=0))
    frequency = np.asarray(np.fft.rfftfreq(count, 1 / rate), dtype=float)
    inputs = np.abs(spectrum[:, c:]) ** 2
    if blind[excited].any() or not inputs.any():
        inputs = np.abs(spectrum[:, :3]) ** 2
    width = max(1, round(_SMOOTH * count / rate))
    total = _smoothed(inputs, width).sum(axis=1)
    inside = (frequency >= lowest) & (frequency <= HIGHEST_LINE * rate)
    if not inside.any() or total[inside].max() <= 0:
        raise InvalidData(f"{run.name}: nothing moves between {lowest:g} Hz and half the rate")
    kept = np.flatnonzero(inside & (total > LEAST_LINE_POWER * total[inside].max()))
    if len(kept) < 8:
        raise InvalidData(
            f"{run.name}: only {len(kept)} Fourier lines of {count / rate:.2g} s are excited; "
            "take a longer record or a wider band"
        )
    power = _power(spectrum[:, :c], rows, width)
    noise, read = sensor_noise(
        np.abs(spectrum[:, :c]) ** 2, power, rows, frequency, kept,
        lowest=lowest, highest=HIGHEST_LINE * rate,
    )  # fmt: skip
    noise = np.maximum(noise, count * quanta**2 / 12)
    if whole:  # slower still, errors of gravity and servos look like a drift of the seat
        kept = np.flatnonzero(inside & (frequency >= LOWEST_PATH_LINE * frequency[kept[0]]))
    if len(kept) > _MOST:
        kept = kept[np.linspace(0, len(kept) - 1, _MOST).round().astype(int)]
    readings = spectrum[kept, :c]
    noise, read, power = noise[kept], read[kept], power[kept]
    measured_force = np.where(measured, spectrum[kept, c + a : -3], 0.0)
    told = _telling(rows, frequency[kept], noise)
    rows = tuple(rows[k] for k in told)
    readings, power = readings[:, told], power[:, told]
    noise, read = noise[:, told], read[:, told]
    return Lines(
        run=run.name,
        number=number,
        pose=pose,
        healthy=run.condition == "healthy",
        excited=excited,
        frequency=frequency[kept],
        command=spectrum[kept, c : c + a],
        force=measured_force,
        lean=(lean[kept, :a], np.where(measured, lean[kept, a:-3], 0.0)),
        tool_force=spectrum[kept, -3:],
        tool_lean=lean[kept, -3:],
        leaked=np.zeros_like(readings),
        measured=measured,
        blind=blind,
        readings=readings,
        row=rows,
        noise=noise,
        read=read,
        power=power,
        independent=min(1.0, float(np.median(np.diff(kept))) / _INDEPENDENT),
        next=rate / count,
        folded=0.0,
        sampled=0.0,
        period=1 / rate,
        seconds=count / rate,
    )


def _telling(rows: tuple[tuple[Reading, int], ...], frequency: Array, noise: Array) -> list[int]:
    """Informative channels: no position whose joint velocity is far less noisy."""
    omega2 = (2 * np.pi * frequency) ** 2
    by_velocity: dict[int, float] = {}
    for k, (r, _) in enumerate(rows):
        if r.kind == "velocity":
            told = float(np.mean(omega2 / noise[:, k]))
            by_velocity[r.at] = max(told, by_velocity.get(r.at, 0.0))
    return [
        k
        for k, (r, _) in enumerate(rows)
        if r.kind != "position"
        or float(np.mean(1 / noise[:, k])) > POSITION_INFORMATION * by_velocity.get(r.at, 0.0)
    ]


def _smoothed(power: Array, width: int) -> Array:
    width = min(width, len(power))  # beyond, numpy gives back the kernel's length
    kernel = np.ones(width) / width
    return np.stack([np.convolve(column, kernel, mode="same") for column in power.T], axis=1)


def _power(spectrum: ComplexArray, rows: tuple[tuple[Reading, int], ...], width: int) -> Array:
    """Smoothed power of each channel; the axes of a sensor are summed."""
    power = _smoothed(np.abs(spectrum) ** 2, width)
    out = power.copy()
    for sensor in {r.sensor for r, _ in rows}:
        own = [k for k, (r, _) in enumerate(rows) if r.sensor == sensor]
        out[:, own] = power[:, own].mean(axis=1, keepdims=True)
    return out
