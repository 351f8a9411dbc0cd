"""Measured motion: position, velocity and acceleration of every joint with their noise.

One smoother for free, torque-logged and servoed recordings alike. It merges position and velocity
by their noise in the frequency domain and is flat to the end of the band, which the data choose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np
from scipy.signal import resample

from loose_env.gap.core.followers import Followers
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import Channel, align_run, measured_runs
from loose_env.gap.simulator import Simulator
from loose_env.recording import CommandTiming, Recording, Run, joint_sensors
from loose_env.statistics import noise_floor, resolution_of
from loose_env.typing import Array, ComplexArray

HIGHEST_HZ = 60.0
"""Highest band of rigid motion [Hz]: above lie structural modes of any arm."""
LOWEST_HZ = 1.5
"""Lowest band [Hz]."""
_PER_CYCLE = 6
"""Samples per period of the highest frequency that are kept: three times Nyquist's rate, room for
the harmonics of dry friction."""
_LEAST_RATE = 40.0  # lowest rate to which a recording is thinned [1/s]
_FLAT = 1.35
"""Half-amplitude frequency of the low-pass over the end of the band, and:"""
_ORDER = 16  # its order: flat to 1 % at the end of the band
_MOST_SAMPLES = 12_000
"""Thinned samples of all runs, at most: minutes of motion; of longer runs the middle is taken."""
_DISAGREES, _FILTERED = 3.0, 0.02
"""Difference of a calibrated velocity reading from the derivative of the position up to which it is
used: its noise standard deviations, or share of it; drives often filter theirs."""
_SHIFTS = 8  # places of an encoder's steps against the motion
_NEAR = 0.5
"""Length of a record's end in which its motion is a parabola [periods of the end of the band]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunMotion:
    """Motion of one run on its thinned, even grid."""

    name: str  # File of the run
    form: str  # "forward", "inverse" or "free"
    step: float  # Interval of the samples [s]
    position: Array  # Joint positions [rad, m] (T, joints)
    speed: Array  # Joint speeds (T, joints)
    acceleration: Array  # Joint accelerations (T, joints)
    derived: Array  # Joint speeds from the positions alone (T, joints)
    readings: Array  # Readings of `Motion.sensors` in the same band (T, R)
    commands: Array
    """Commands as they act between samples, in the band of the motion (T, actuators)."""
    sampled: Array  # Commands as sampled, in the same band (T, actuators)
    straight: Array  # Commands along straight lines from sample to sample (T, actuators)
    torques: Array  # Measured joint torques, NaN of joints without (T, joints)
    limited: Array  # Share of a sample in which the nominal drive is at its limit (T, joints)
    log_step: float  # Interval of the log [s]
    begin: float  # Time of the first sample after the log's first one [s]
    clock: float = 0.0  # Time of the log's first sample by its own clock [s]
    followed: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    """Speed of each follower per speed of each joint (T, P, joints)."""

    @property
    def time(self) -> Array:
        """Times of the samples [s], from 0 (T,)."""
        return np.arange(len(self.position), dtype=float) * self.step

    @property
    def logged(self) -> Array:
        """Times of the samples by the clock of the log [s] (T,)."""
        return self.clock + self.begin + self.time

    @cached_property
    def finer_commands(self) -> Array:
        """Commands on `FINER` times as many points (FINER T, actuators)."""
        return finer(self.commands)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of all runs."""

    runs: tuple[RunMotion, ...]  # The runs
    band: float  # End of the band in which the motion shows over its noise [Hz]
    noise: Array
    """Noise of a thinned sample's position, speed and torque (3, joints); infinite if not used."""
    sensors: tuple[tuple[str, int], ...]
    """Velocity and inertial sensors read in every run, with the axis, -1 of a scalar."""
    sensor_noise: Array  # Noise of a thinned sample of each of these readings (R,)
    followers: tuple[int, ...] = ()  # Joints that equality constraints carry along
    foretold: tuple[int, ...] = ()  # Joints that move as the nominal model says, unread

    @property
    def step(self) -> float:
        """Interval of the samples [s]."""
        return self.runs[0].step

    def precision(self, turn: Array) -> Array:
        """Precision of each joint's position by both readings, by frequency (F, joints)."""
        return np.asarray(1 / self.noise[0] ** 2 + (turn[:, None] / self.noise[1]) ** 2)

    def stacked(self, name: str) -> Array:
        """One field of all runs, one after the other."""
        return np.concatenate([getattr(run, name) for run in self.runs])

    def rates(self, values: Array, order: int = 1) -> Array:
        """Derivative of stacked values, run by run."""
        return np.concatenate([rates(own, self.step, order) for own in self.split(values)])

    def split(self, values: Array) -> list[Array]:
        """Cut stacked values by run."""
        return np.split(values, np.cumsum([len(r.position) for r in self.runs])[:-1])


def smooth(recording: Recording, machine: NominalModel, *, like: Motion | None = None) -> Motion:
    """Estimate the motion of every run from its position and velocity readings.

    In the band and with the noise of another motion of the machine, where one is given. A joint
    that is not read moves as the nominal servo moves it under its commands.

    Raises
    ------
    InvalidData
        If a joint's position was not read.
    """
    model: mujoco.MjModel = machine.model
    runs_, _ = measured_runs(recording.runs, model)
    common = set.intersection(*(set(run.sensors) for run in runs_))
    sensors = sensors_of(model, common)
    encoders = joint_sensors(model)
    read = {j for j in machine.joints if set(encoders[j].position) & common}
    followers = Followers.of(machine, read)
    unread = [k for k, j in enumerate(machine.joints) if j not in read]
    held = servoed(machine, runs_) if read else {}
    foretold = sorted(held.keys() & set(unread) - {*followers.numbers})
    beside = sorted(held.keys() - set(unread)) if foretold else []
    moved = motions_of_model(runs_, machine, [*foretold, *beside])
    logs = [
        _Log.of(run, machine, sensors, followers, dict(zip(foretold, own.T, strict=False)))
        for run, own in zip(runs_, moved, strict=True)
    ]
    step = float(np.median([log.step for log in logs]))
    floors = np.stack([log.floors for log in logs])
    noise = np.median(floors, axis=0)
    noise[0, foretold] = np.median(np.delete(noise[0], foretold))
    ends = [_band_end(log, noise) for log in logs]
    band = float(np.clip(max(ends), LOWEST_HZ, min(0.35 / step, HIGHEST_HZ)))
    if like is not None:
        band = like.band
    # as wrong as the nominal model is of the joints that are read, in the band of the motion
    wrong = _misfit([log.position for log in logs], moved, [*foretold, *beside], len(foretold))
    noise[0, foretold] = np.maximum(wrong / np.sqrt(2 * band * step), noise[0, foretold])
    thin = max(1, int(1 / (step * max(_PER_CYCLE * band, _LEAST_RATE))))
    if like is not None:
        noise = like.noise * np.sqrt(thin)
    most = _most_of_each([len(log.position) // thin for log in logs])
    alone = [
        [
            _smoothed(q, None, sd, band, log.step)
            for q, sd in zip(log.position.T, noise.T, strict=True)
        ]
        for log in logs
    ]
    if like is None:
        noise[0] = np.maximum(noise[0], _rounding(logs, alone, band))
    found = {}
    for joint in range(len(machine.joints)):
        pairs = [
            (own[joint][1], low_passed(log.speed[:, joint, None], band, log.step)[:, 0])
            for own, log in zip(alone, logs, strict=True)
            if np.isfinite(log.speed[:, joint]).all()
        ]
        own = _Calibration.of(pairs, noise[:, joint], band, step) if pairs else None
        if own is not None and own.usable:
            found[joint] = own
        else:
            noise[1, joint] = np.inf
    runs = tuple(
        _run_motion(log, own, found, noise, band, thin, most, machine)
        for log, own in zip(logs, alone, strict=True)
    )
    if followers.numbers:
        runs = tuple(replace(run, followed=followers.paths(run.position)) for run in runs)
    seen = [[noise_floor(c) for c in log.readings.T] for log in logs]
    level = np.median(np.array(seen).reshape(len(logs), -1), axis=0) / np.sqrt(thin)
    return Motion(
        runs=runs, band=band, noise=noise / np.sqrt(thin), sensors=sensors,
        sensor_noise=level if like is None else like.sensor_noise,
        followers=followers.numbers,
        foretold=tuple(foretold) if like is None else like.foretold,
    )  # fmt: skip


def _misfit(
    measured: Sequence[Array], played: Sequence[Array], joints: Sequence[int], unread: int
) -> Array:
    """Error of the first, unread joints of a simulation, by that of the others (unread,)."""
    # As the same share of each joint's own motion; all of it where no other was read.
    if not unread:
        return np.zeros(0)
    moves = np.mean([np.var(own, axis=0) for own in played], axis=0)
    ends = zip(measured, played, strict=True)
    # of samples as they are: grids differ by less than one
    off = [np.var(own[:, joints][: len(sim)] - sim[: len(own)], axis=0) for own, sim in ends]
    shares = np.mean(off, axis=0)[unread:] / np.maximum(moves[unread:], 1e-300)
    return np.asarray(np.sqrt(moves[:unread] * (np.median(shares) if len(shares) else 1.0)))


def _rounding(logs: Sequence[_Log], alone: Sequence[Sequence[Array]], band: float) -> Array:
    """Noise of each position by what its steps make of the motion within its band (joints,)."""
    # As of a sample of white noise. Steps that last long are not white: they have most of their
    # error below.
    found = []
    for log, motions in zip(logs, alone, strict=True):
        share = 2 * _FLAT * band * log.step
        errors = []
        for read, own in zip(log.position.T, motions, strict=True):
            step = resolution_of(read)
            shifts = own[0][:, None] + step * np.arange(_SHIFTS) / _SHIFTS
            off = step * np.round(shifts / step) - shifts if step else 0 * shifts
            errors.append(np.sqrt(np.mean(low_passed(off, band, log.step) ** 2) / share))
        found.append(errors)
    return np.median(np.array(found), axis=0)


def servoed(machine: NominalModel, runs: Iterable[Run]) -> dict[int, int]:
    """Joints with the servo of the model that holds each, if commands drive all runs."""
    return machine.servos if all(run.comparison == "forward" for run in runs) else {}


def servo_share(machine: NominalModel, servo: int) -> float:
    """Position to which a servo leads its joint, per command [rad, m]."""
    model = machine.model
    stiffness = model.actuator_biasprm[servo, 1] * model.actuator_gear[servo, 0]
    return float(-model.actuator_gainprm[servo, 0] / stiffness)


def motions_of_model(
    runs: Sequence[Run], machine: NominalModel, joints: Sequence[int]
) -> list[Array]:
    """Positions of servoed joints in simulations of the nominal model, at the samples (T, J)."""
    # NaN where that diverges.
    if not joints:
        return [np.empty((len(run.time), 0)) for run in runs]
    encoders = joint_sensors(machine.model)
    names = [encoders[machine.joints[k]].position[0] for k in joints]
    channels = tuple(Channel(f"sensor.{name}") for name in names)
    trials = []
    for run in runs:
        trial = align_run(run, machine, channels, step=machine.time_step)
        start = trial.position.copy()
        for k, joint in enumerate(machine.joints):
            own = [name for name in encoders[joint].position if name in run.sensors]
            first = run.sensors[own[0]][0] if own else np.nan
            start[k] = first if np.isfinite(first) else start[k]
        for k in joints:  # what it reads may be nonsense
            servo = machine.servos[k]
            start[k] = servo_share(machine, servo) * trial.controls[0, servo]
        trials.append(replace(trial, position=start, resting=True))
    return Simulator(machine, trials, channels, threads=1).predict([Hypothesis()])[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Log:
    """Readings of one run on an even grid."""

    run: Run
    step: float
    position: Array
    speed: Array
    torque: Array
    commands: Array
    readings: Array

    @classmethod
    def of(
        cls,
        run: Run,
        machine: NominalModel,
        seen: Sequence[tuple[str, int]],
        followers: Followers,
        foretold: Mapping[int, Array],
    ) -> _Log:
        step = float(np.median(np.diff(run.time)))
        grid = np.arange(run.time[0], run.time[-1] + 1e-9, step)
        sensors = joint_sensors(machine.model)
        nothing = np.full(len(grid), np.nan)

        def read(columns: Mapping[str, Array], names: Sequence[str]) -> Array:
            known = [columns[name] for name in names if name in columns]
            good = np.isfinite(known[0]) if known else np.zeros(1, bool)
            if not good.any():
                return nothing
            return np.asarray(np.interp(grid, run.time[good], known[0][good]))

        def whole(name: str, axis: int) -> Array:
            values = run.sensors[name] if axis < 0 else run.sensors[name][:, axis]
            return read({name: values}, [name])

        def beside(columns: Sequence[Array]) -> Array:
            return np.stack(columns, axis=1) if columns else np.zeros((len(grid), 0))

        readings = [read(run.sensors, sensors[j].position) for j in machine.joints]
        position = np.stack([_without_jumps(q) for q in readings], axis=1)
        for k, own in foretold.items():
            position[:, k] = np.interp(grid, run.time, own)
        unread = np.flatnonzero(~np.isfinite(position).all(axis=0)).tolist()
        followers.fill(run.name, position, unread)
        sampled = [
            replace(run.timing(a), shift_s=0.0).acting(run.time, run.controls[a], grid + 1e-9)
            if a in run.controls
            else 0 * grid
            for a in machine.actuators
        ]
        return cls(
            run=run,
            step=step,
            position=position,
            speed=np.stack([read(run.sensors, sensors[j].velocity) for j in machine.joints], 1),
            torque=np.stack([read(run.torques, [j]) for j in machine.joints], axis=1),
            commands=beside(sampled),
            readings=beside([whole(name, axis) for name, axis in seen]),
        )

    @property
    def floors(self) -> Array:
        """Noise of position, speed and torque (3, joints); infinite where not read."""
        read = (self.position, self.speed, self.torque)
        each = (c for columns in read for c in columns.T)
        found = [noise_floor(c) if np.isfinite(c).all() else np.inf for c in each]
        return np.reshape(found, (3, -1))


def _band_end(log: _Log, noise: Array) -> float:
    """Highest frequency at which any joint's motion shows over its noise [Hz]."""
    # Power thirty times the noise, smoothed over a quarter hertz, and no further than six times the
    # frequency below which lies 99 % of the mean square acceleration.
    found, window = [], np.hanning(len(log.position))
    frequency = np.fft.rfftfreq(len(window), log.step)
    for values, sd in zip(log.position.T, noise[0], strict=True):
        free = values - np.linspace(values[0], values[-1], len(values))
        power = np.abs(np.fft.rfft(free * window)) ** 2 / (window @ window)  # of white noise, sd²
        width = max(int(0.25 / frequency[1]), 1)
        power = np.convolve(power, np.ones(2 * width + 1) / (2 * width + 1), "same")
        peak = int(np.argmax(power * frequency**2))
        quiet = np.flatnonzero(power < 30 * sd**2)
        quiet = quiet[quiet > peak]
        last = quiet[0] if len(quiet) else len(frequency) - 1
        # dry friction makes a third harmonic, and a swing has nothing between
        third = np.flatnonzero(power[: int(3.3 * peak)] >= 30 * sd**2)
        last = max(int(last), int(third[-1]) if len(third) else 0)
        bulk = np.cumsum(np.maximum(power - sd**2, 0)[: last + 1] * frequency[: last + 1] ** 4)
        if bulk[-1] > 0:
            most = 6 * frequency[np.searchsorted(bulk, 0.99 * bulk[-1])]
            found.append(float(min(frequency[last], most)))
    return max(found, default=LOWEST_HZ)


def _run_motion(
    log: _Log,
    positions: Sequence[Array],
    found: Mapping[int, _Calibration],
    noise: Array,
    band: float,
    thin: int,
    most: int,
    machine: NominalModel,
) -> RunMotion:
    """Smooth one log, thin it, and take its middle if it is longer than some samples."""
    parts = []
    for joint, own in enumerate(positions):
        v = log.speed[:, joint]
        if joint in found and np.isfinite(v).all():
            v = found[joint].applied(v, own, band, log.step)
            own = _smoothed(log.position[:, joint], v, noise[:, joint], band, log.step)
        parts.append(own)
    timings = [log.run.timing(name) for name in machine.actuators]
    lines = [replace(timing, mode="linear") for timing in timings]
    whole = np.stack(parts, axis=2)
    count = len(log.position) // thin
    first = max(count - most, 0) // 2
    taken = slice(first, min(first + most, count))

    def kept(values: Array) -> Array:
        # samples, not means: the force along a mean motion is not the mean force
        return np.ascontiguousarray(values[(thin - 1) // 2 :: thin][taken])

    return RunMotion(
        name=log.run.name,
        form=log.run.comparison,
        step=log.step * thin,
        position=kept(whole[0]),
        speed=kept(whole[1]),
        acceleration=kept(whole[2]),
        derived=kept(np.stack([own[1] for own in positions], axis=1)),
        readings=kept(low_passed(log.readings, band, log.step)),
        # through the same filter: a stiff servo acts on a small difference of large signals
        commands=kept(low_passed(log.commands, band, log.step, timings)),
        sampled=kept(low_passed(log.commands, band, log.step)),
        straight=kept(low_passed(log.commands, band, log.step, lines)),
        torques=kept(low_passed(log.torque, band, log.step)),
        limited=_blocks(_limited(log, whole[0], whole[1], machine), thin)[taken],
        log_step=log.step,
        begin=((thin - 1) // 2 + first * thin) * log.step,
        clock=float(log.run.time[0]),
    )


def _most_of_each(counts: Sequence[int]) -> int:
    """Samples to take of each run, so that all together are no more than are used."""
    left, most = _MOST_SAMPLES, max(counts)
    for number, count in enumerate(sorted(counts)):
        share = left // (len(counts) - number)
        if count > share:
            return share
        left -= count
    return most


def _blocks(values: Array, thin: int) -> Array:
    """Means of blocks of samples."""
    count = len(values) // thin
    return np.asarray(values[: count * thin].reshape(count, thin, -1).mean(axis=1))


def _limited(log: _Log, position: Array, speed: Array, machine: NominalModel) -> Array:
    """Samples in which the nominal drive of a joint is at its limit, 1 or 0 (T, joints)."""
    # Commands act only where they drive the run: measured torques are what the drives gave.
    commands, model, found = log.commands, machine.model, np.zeros_like(position)
    if log.run.comparison != "forward":
        return found
    for k, name in enumerate(machine.actuators):
        if not (machine.affine_actuators[k] and model.actuator_forcelimited[k]):
            continue
        joint = machine.joint_number(machine.actuated_joint[name])
        gear, bias = model.actuator_gear[k, 0], model.actuator_biasprm[k]
        asked = model.actuator_gainprm[k, 0] * commands[:, k] + bias[0]
        asked = asked + gear * (bias[1] * position[:, joint] + bias[2] * speed[:, joint])
        low, high = model.actuator_forcerange[k]
        found[:, joint] = np.maximum(found[:, joint], (asked < low) | (asked > high))
    return found


def _smoothed(q: Array, v: Array | None, noise: Array, band: float, step: float) -> Array:
    """Position, speed and acceleration that fit the readings, smooth above a band (3, T)."""
    # Weighted by the noise of both readings. Beyond the ends the motion goes on with the
    # acceleration it has there: a swing begins with its largest.
    ends, pad = _continued(q, band, step)
    line = np.linspace(ends[0], ends[-1], len(ends))
    slope = (ends[-1] - ends[0]) / ((len(ends) - 1) * step)
    turn: Array = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(ends), step), float)
    shape = np.fft.rfft(ends - line)
    if v is not None:
        rates = np.gradient(ends, step)
        rates[pad : pad + len(v)] = v
        rates -= slope
        precise = 1 / noise[0] ** 2 + turn**2 / noise[1] ** 2
        shape = (shape / noise[0] ** 2 - 1j * turn * np.fft.rfft(rates) / noise[1] ** 2) / precise
    shape = shape * _passed(turn, band)
    offsets = (line, slope, 0.0)
    whole = [
        np.fft.irfft((1j * turn) ** k * shape, len(ends)) + offset
        for k, offset in enumerate(offsets)
    ]
    return np.stack(whole)[:, pad : pad + len(q)]


def low_passed(
    values: Array, band: float, step: float, timings: Sequence[CommandTiming] = ()
) -> Array:
    """Columns (T, K) through the low-pass of the motion, those of commands as they act."""
    # A column with gaps stays as it is.
    found = values.copy()
    for k, column in enumerate(values.T):
        if not np.isfinite(column).all():
            continue
        ends, pad = _reflected(column, band, step)
        line = np.linspace(ends[0], ends[-1], len(ends))
        turn: Array = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(ends), step), float)
        shape = np.fft.rfft(ends - line) * _passed(turn, band)
        if timings:
            shape = shape * timings[k].response(turn, step)
            line = line - timings[k].delay(step) * (ends[-1] - ends[0]) / (len(ends) - 1) / step
        whole = np.fft.irfft(shape, len(ends)) + line
        found[:, k] = whole[pad : pad + len(column)]
    return found


FINER = 4
"""Points between samples on which delays and lags act."""


def finer(values: Array) -> Array:
    """Band-limited columns (T, K) on `FINER` times as many points (FINER T, K)."""
    mirrored = np.concatenate([values, values[::-1]])
    return np.asarray(resample(mirrored, FINER * len(mirrored))[: FINER * len(values)])


def mirrored(values: Array, step: float) -> tuple[Array, ComplexArray]:
    """Frequencies [rad/s] and spectrum of columns (T, K) or of one, so that they have no ends."""
    whole = np.concatenate([values, values[::-1]])
    turn = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(whole), step), float)
    return turn, np.fft.rfft(whole, axis=0)


def rates(values: Array, step: float, order: int = 1) -> Array:
    """Derivative of band-limited columns (T, K) or of one (T,)."""
    turn, wave = mirrored(values, step)
    found = np.fft.irfft(((1j * turn) ** order * wave.T).T, 2 * len(values), axis=0)
    return np.asarray(found[: len(values)])


def _continued(q: Array, band: float, step: float) -> tuple[Array, int]:
    """Record with parabolas at its ends, which lead into lines, and their length."""
    pad = min(len(q) - 2, int(3 / band / step) + 20)
    near = int(np.clip(_NEAR / band / step, 6, len(q)))
    ahead, parts = np.arange(1, pad + 1), []
    # the acceleration fades out over half the way, so that both ends meet in a line
    fade = np.clip(2 - 2 * ahead / pad, 0.0, 1.0)
    for own in (q[near - 1 :: -1] if near < len(q) else q[::-1], q[-near:]):
        at = np.arange(1 - near, 1)
        bend, rise, _ = np.polyfit(at, own, 2)
        speed = rise + 2 * bend * np.cumsum(fade)
        parts.append(own[-1] + np.cumsum(speed))
    return np.concatenate([parts[0][::-1], q, parts[1]]), pad


def _reflected(values: Array, band: float, step: float) -> tuple[Array, int]:
    """Record with odd reflections at its ends, and their length."""
    pad = min(len(values) - 2, int(3 / band / step) + 20)
    ahead = 2 * values[0] - values[pad:0:-1]
    behind = 2 * values[-1] - values[-2 : -pad - 2 : -1]
    return np.concatenate([ahead, values, behind]), pad


def _passed(turn: Array, band: float) -> Array:
    """Gain of the low-pass at angular frequencies."""
    return np.asarray(1 / (1 + (turn / (2 * np.pi * _FLAT * band)) ** _ORDER))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Calibration:
    """How a velocity reading differs from the derivative of the position."""

    derived: bool  # Whether the derivative is explained by the reading, not the reverse
    zero: float  # Constant of what is explained
    gain: float  # Gain of what explains it
    late: float  # Coefficient of its rate: a delay
    usable: bool  # Whether nothing else is between them, beyond their noise

    @classmethod
    def of(
        cls, pairs: Sequence[tuple[Array, Array]], noise: Array, band: float, step: float
    ) -> _Calibration:
        """Calibrate by the derivative and the reading in all runs."""
        # The noisier of both is explained, for noise of the other attenuates the gain. Each
        # frequency weighs by the noise of both there; that of positions grows with it. A reading of
        # a joint that hardly moves stays as it is, its delay within an interval of the log.
        derived = bool(noise[1] < noise[0] * 2 * np.pi * band / np.sqrt(3))
        end = 2 * np.pi * band
        normal, slope, power, count = np.diag([0.0, 0.0, step**-2]), np.zeros(3), 0.0, 0
        for pair in pairs:
            window = np.hanning(len(pair[0]))
            turn = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(window), step), float)
            known, explained = pair[::-1] if derived else pair
            terms = np.stack([np.ones_like(known), known, rates(known, step)], axis=1)
            noises = [(turn * noise[0]) ** 2, noise[1] ** 2 + 0 * turn]
            weight = 2 * (turn <= end) / sum(noises) / (window @ window)
            wave = np.fft.rfft(terms * window[:, None], axis=0)
            own, shown = wave.conj().T * weight, np.fft.rfft(explained * window)
            normal, slope = normal + (own @ wave).real, slope + (own @ shown).real
            # noise of what explains would draw its gain to zero; so it draws it to one
            slope[1] += (window @ window) * float(weight @ noises[derived])
            power += float(weight @ np.abs(shown) ** 2)
            count += 2 * int(np.sum(turn <= end))
        zero, gain, late = np.linalg.lstsq(normal, slope, rcond=None)[0]
        left = power - float(slope @ [zero, gain, late])
        agrees = left <= max(_DISAGREES**2 * count, _FILTERED**2 * power)
        return cls(
            derived=derived, zero=float(zero), gain=float(gain), late=float(late),
            usable=bool(agrees and 0.5 < gain < 2),
        )  # fmt: skip

    def applied(self, v: Array, own: Array, band: float, step: float) -> Array:
        """Velocity reading as the derivative that it stands for."""
        if self.derived:
            rate = rates(low_passed(v[:, None], band, step)[:, 0], step)
            return np.asarray(self.zero + self.gain * v + self.late * rate)
        return np.asarray((v - self.zero - self.late * own[2]) / self.gain)


def _without_jumps(q: Array) -> Array:
    """Bridge isolated glitches of an encoder: second differences far outside all others."""
    bend = np.abs(np.diff(q, 2))
    limit = 12 * max(float(np.percentile(bend, 90)), resolution_of(q))
    bad = np.flatnonzero(bend > limit) + 1
    if not len(bad) or len(bad) > 0.004 * len(q):
        return q
    hidden = np.zeros(len(q), bool)
    for k in bad:
        hidden[max(k - 2, 1) : k + 3] = True
    hidden[[0, -1]] = False
    rows, found = np.arange(len(q)), q.copy()
    edges = np.flatnonzero(np.diff(hidden.astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        near = rows[max(first - 14, 0) : last + 15]
        near = near[~hidden[near]]
        cubic = np.polynomial.Polynomial.fit(near, q[near], 3)
        found[first + 1 : last + 1] = cubic(rows[first + 1 : last + 1])
    return found


def sensors_of(model: mujoco.MjModel, present: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """Sensors with axes, -1 of a scalar, whose readings the motion foretells."""
    kinds = {int(k) for k in (
        mujoco.mjtSensor.mjSENS_JOINTVEL, mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_VELOCIMETER,
    )}  # fmt: skip
    known, found = set(present), []
    for k in range(model.nsensor):
        name, size = model.sensor(k).name, int(model.sensor_dim[k])
        if name in known and int(model.sensor_type[k]) in kinds:
            found += [(name, axis) for axis in range(size)] if size > 1 else [(name, -1)]
    return tuple(found)
