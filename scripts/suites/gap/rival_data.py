"""What other methods read of a recording, and how they write what they found."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy import signal

from loose_env.errors import InvalidData
from loose_env.gap import Gap, GapResult, NamedEffect, read_result
from loose_env.recording import Recording, Run
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """Choice of the low-pass and of the rate after it."""

    signal_over_floor: float = 10.0
    """Power density of a velocity over its noise floor down to which it counts as motion."""
    lowest_hz: float = 15.0
    """Least cut-off frequency [Hz]: friction at reversals needs a few harmonics of the motion."""
    highest_hz: float = 100.0
    """Largest cut-off frequency [Hz]: above it differentiated noise hides the inertial torque."""
    floor_above_hz: float = 350.0
    """Frequency above which a velocity is noise alone [Hz]; a fraction of Nyquist if that is
    lower."""
    order: int = 4
    """Order of the Butterworth filter, which is run forwards and backwards."""
    rate_over_cutoff: float = 2.5
    """Rate of the decimated samples over the cut-off: just above Nyquist, so that the noise of
    neighbouring samples is nearly independent."""
    margin_s: float = 0.15
    """Time cut off at both ends of a run, where the filter has no past or future [s]."""


@dataclass(frozen=True, kw_only=True)
class LowPass:
    """One low-pass and decimation for all signals of a recording."""

    rate_hz: float
    """Rate of the samples [Hz]."""
    cutoff_hz: float
    """Cut-off frequency [Hz]."""
    settings: FilterSettings

    @property
    def stride(self) -> int:
        """Samples from one decimated sample to the next."""
        return max(1, int(self.rate_hz / (self.settings.rate_over_cutoff * self.cutoff_hz)))

    def smooth(self, values: Array) -> Array:
        """Low-passed values at the full rate, along the first axis."""
        if self.cutoff_hz >= 0.45 * self.rate_hz:
            return values
        sos = signal.butter(self.settings.order, self.cutoff_hz, fs=self.rate_hz, output="sos")
        return np.asarray(signal.sosfiltfilt(sos, values, axis=0))

    def rows(self, samples: int) -> slice:
        """Rows of a run of so many samples that are kept."""
        margin = min(round(self.settings.margin_s * self.rate_hz), samples // 4)
        return slice(margin, samples - margin, self.stride)

    def reduced(self, values: Array) -> Array:
        """Low-passed and decimated values."""
        return self.smooth(values)[self.rows(len(values))]

    def derivative(self, values: Array) -> Array:
        """Derivative by time at the full rate, by central differences of the sixth order."""
        out = np.gradient(values, axis=0)
        ahead = [values[3 + k : len(values) - 3 + k] for k in (1, 2, 3)]
        behind = [values[3 - k : len(values) - 3 - k] for k in (1, 2, 3)]
        weights = (0.75, -0.15, 1.0 / 60.0)
        out[3:-3] = sum(w * (a - b) for w, a, b in zip(weights, ahead, behind, strict=True))
        return out * self.rate_hz


@dataclass(frozen=True, kw_only=True)
class Actuators:
    """Actuators of a model that act on single joints: force = gain u + bias on its joint."""

    dof: tuple[int, ...]
    """Degree of freedom of each."""
    names: tuple[str, ...]
    """Name of each."""
    gear: Array
    """Gear ratio, of shape (m,)."""
    gain: Array
    """Force over command, of shape (m,)."""
    bias: Array
    """Constant, force over length and over velocity, of shape (m, 3)."""
    limits: Array
    """Least and largest force, of shape (m, 2)."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Actuators:
        """Actuators of a model."""
        joint = int(mujoco.mjtTrn.mjTRN_JOINT)
        if (model.actuator_trntype != joint).any() or model.na:
            raise InvalidData("only actuators at joints without a state of their own are read")
        limited = model.actuator_forcelimited.astype(bool)[:, None]
        return cls(
            dof=tuple(int(model.jnt_dofadr[j]) for j in model.actuator_trnid[:, 0]),
            names=tuple(model.actuator(i).name for i in range(model.nu)),
            gear=model.actuator_gear[:, 0].copy(),
            gain=model.actuator_gainprm[:, 0].copy(),
            bias=model.actuator_biasprm[:, :3].copy(),
            limits=np.where(limited, model.actuator_forcerange, [-np.inf, np.inf]),
        )


@dataclass(frozen=True, kw_only=True)
class JointRun:
    """One run at the full rate; joints in the model's order, torques at the joints."""

    name: str
    low_pass: LowPass
    position: Array
    """As read, of shape (T, n) [rad or m]."""
    velocity: Array
    """As read, of shape (T, n) [rad/s or m/s]."""
    proportional: Array
    """Torque of the actuators from command and position, of shape (T, n) [N m or N]."""
    derivative: Array
    """Torque of the actuators from velocity, of shape (T, n)."""
    command_slope: Array
    """Derivative of `proportional` by the time of the command, of shape (T, n) [N m/s]."""
    derivative_gain: Array
    """Torque over velocity of `derivative`, zero where a drive is saturated, of shape (T, n)."""
    measured: Array | None
    """Measured torque, of shape (T, n); None for a run with commands or without torques."""

    @property
    def torque(self) -> Array:
        """Torque at the joints, of shape (T, n)."""
        return self.proportional + self.derivative if self.measured is None else self.measured

    @property
    def samples(self) -> int:
        """Number of decimated samples."""
        return len(range(*self.low_pass.rows(len(self.position)).indices(len(self.position))))

    def motion(self) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration, low-passed and decimated, each of shape (t, n)."""
        keep = self.low_pass.rows(len(self.position))
        speed = self.low_pass.smooth(self.velocity)
        acceleration = self.low_pass.derivative(speed)
        return self.low_pass.smooth(self.position)[keep], speed[keep], acceleration[keep]

    def position_rate(self) -> Array:
        """Low-passed velocity from the encoder, of shape (T, n)."""
        return self.low_pass.derivative(self.low_pass.smooth(self.position))

    def smooth_velocity(self) -> Array:
        """Low-passed velocity at the full rate, of shape (T, n)."""
        return self.low_pass.smooth(self.velocity)


@dataclass(frozen=True, kw_only=True)
class _Raw:
    """Readings of one run, in the model's order of joints."""

    name: str
    position: Array
    velocity: Array
    command: Array | None
    measured: Array | None


def joint_runs(
    recording: Recording, settings: FilterSettings | None = None
) -> tuple[JointRun, ...]:
    """Runs of a recording as joint motions and torques."""
    settings = settings or FilterSettings()
    actuators = Actuators.of(recording.model())
    raw = [_raw(recording, run, actuators) for run in recording.runs]
    rate = 1.0 / float(np.median(np.diff(recording.runs[0].time)))
    low_pass = LowPass(rate_hz=rate, cutoff_hz=_cutoff(raw, rate, settings), settings=settings)
    return tuple(_joint_run(run, actuators, low_pass) for run in raw)


def noise_replicas(
    recording: Recording, runs: tuple[JointRun, ...], rng: np.random.Generator
) -> tuple[JointRun, ...]:
    """The same runs with as much sensor noise added once more, through the same filter."""
    actuators = Actuators.of(recording.model())

    def noisy(values: Array) -> Array:
        return np.asarray(values + _noise(values) * rng.normal(size=values.shape))

    replicas = []
    for run, own in zip(recording.runs, runs, strict=True):
        raw = _raw(recording, run, actuators)
        raw = dataclasses.replace(
            raw,
            position=noisy(raw.position),
            velocity=noisy(raw.velocity),
            measured=None if raw.measured is None else noisy(raw.measured),
        )
        replicas.append(_joint_run(raw, actuators, own.low_pass))
    return tuple(replicas)


def _raw(recording: Recording, run: Run, actuators: Actuators) -> _Raw:
    sensors = recording.joint_sensors()
    rate = 1.0 / float(np.median(np.diff(run.time)))
    positions, velocities = [], []
    for joint, own in sensors.items():
        if not own.position or own.position[0] not in run.sensors:
            raise InvalidData(f"{run.name}: joint {joint!r} has no position sensor")
        positions.append(_whole(run.sensors[own.position[0]]))
        if own.velocity and own.velocity[0] in run.sensors:
            velocities.append(_whole(run.sensors[own.velocity[0]]))
        else:
            velocities.append(np.gradient(positions[-1], 1.0 / rate))
    command = measured = None
    if run.comparison == "forward":
        zero = np.zeros(run.samples)
        command = np.stack(
            [_whole(run.controls.get(name, zero)) for name in actuators.names], axis=1
        )
    elif run.comparison == "inverse":
        measured = np.stack(
            [_whole(run.torques.get(joint, np.zeros(run.samples))) for joint in sensors], axis=1
        )
    return _Raw(
        name=run.name,
        position=np.stack(positions, axis=1),
        velocity=np.stack(velocities, axis=1),
        command=command,
        measured=measured,
    )


def _joint_run(raw: _Raw, actuators: Actuators, low_pass: LowPass) -> JointRun:
    proportional, derivative, slope, damping = (np.zeros_like(raw.position) for _ in range(4))
    if raw.command is not None:
        held = _held(raw.command)
        rate = low_pass.derivative(low_pass.smooth(held))
        for i, dof in enumerate(actuators.dof):
            gear, gain, bias = actuators.gear[i], actuators.gain[i], actuators.bias[i]
            p = gain * held[:, i] + bias[0] + bias[1] * gear * raw.position[:, dof]
            d = bias[2] * gear * raw.velocity[:, dof]
            low, high = actuators.limits[i]
            free = (p + d > low) & (p + d < high)
            # a saturated drive gives its limit, whatever its gains are
            proportional[:, dof] += gear * np.where(free, p, np.clip(p + d, low, high))
            derivative[:, dof] += gear * np.where(free, d, 0.0)
            damping[:, dof] += np.where(free, bias[2] * gear * gear, 0.0)
            slope[:, dof] += gear * np.where(free, gain * rate[:, i], 0.0)
    return JointRun(
        name=raw.name,
        low_pass=low_pass,
        position=raw.position,
        velocity=raw.velocity,
        proportional=proportional,
        derivative=derivative,
        command_slope=slope,
        derivative_gain=damping,
        measured=raw.measured,
    )


def _held(command: Array) -> Array:
    """Mean around each sample of a command that is held from sample to sample."""
    wide = np.vstack((command[:1], command[:1], command, command[-1:]))
    near, far = wide[2:-1] + wide[1:-2], wide[3:] + wide[:-3]
    return np.asarray((13.0 * near - far) / 24.0)


def _cutoff(raw: list[_Raw], rate: float, settings: FilterSettings) -> float:
    """Highest frequency at which some joint moves clearly above its noise [Hz]."""
    highest = settings.lowest_hz
    for run in raw:
        length = min(1024, len(run.velocity))
        frequency, power = signal.welch(run.velocity, rate, nperseg=length, axis=0)
        floor = np.median(power[frequency > min(settings.floor_above_hz, 0.35 * rate)], axis=0)
        moving = (power > settings.signal_over_floor * floor).any(axis=1)
        if moving.any():
            highest = max(highest, float(frequency[moving].max()))
    return min(highest, settings.highest_hz, 0.4 * rate)


def _noise(values: Array) -> Array:
    """Standard deviation of white noise in smooth signals, from their fifth differences."""
    # sum of the squared binomials of order 5 is 252
    differences = np.diff(values, 5, axis=0) / np.sqrt(252.0)
    return np.asarray(1.4826 * np.median(np.abs(differences), axis=0))


def _whole(values: Array) -> Array:
    """Values with missing samples interpolated."""
    good = np.isfinite(values)
    if good.all():
        return values
    if not good.any():
        raise InvalidData("a column holds no numbers")
    at = np.arange(len(values))
    return np.interp(at, at[good], values[good])


RESULT = "result.json"
"""File of a result."""


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """When a model counts as right, and a list of effects as an explanation."""

    no_gap: float = 1.25
    """Held-out residual up to which nothing is missing [noise sd]: filtering and interpolation
    leave up to a quarter beside the noise."""
    explained: float = 0.5
    """Least share of the held-out mean square above the noise that effects have to explain: less
    than half says that the main cause is another one."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a method came to on one recording."""

    method: str
    """Name of the method."""
    before: float
    """Held-out residual of the nominal model within its tolerance [noise sd]."""
    after: float
    """The same of the model with the effects, or of the predictor [noise sd]."""
    held_out: str
    """File of the held-out run."""
    effects: Sequence[NamedEffect] = ()
    settings: Mapping[str, Any] | None = None
    """What the result depends on besides the recording."""

    @property
    def explained(self) -> float:
        """Share of the held-out mean square above the noise that is gone."""
        above = max(self.before**2 - 1.0, 1e-9)
        return (self.before**2 - self.after**2) / above


def write_finding(
    folder: Path, finding: Finding, settings: VerdictSettings | None = None
) -> GapResult:
    """Write what was found as ``result.json``, read back once, and return it."""
    settings = settings or VerdictSettings()
    named = bool(finding.effects) and finding.explained >= settings.explained
    if named:
        verdict = "named"
    elif finding.before > settings.no_gap:
        verdict = "unexplained"
    else:
        verdict = "no_gap"
    result = GapResult(
        verdict=verdict,  # type: ignore[arg-type]
        gap=Gap(before=finding.before, after=finding.after),
        effects=tuple(finding.effects) if named else (),
        doubtful=() if named else tuple(finding.effects),
        held_out_runs=(finding.held_out,),
        model=None,
        settings={"method": finding.method, **(finding.settings or {})},
    )
    return read_result(result.write(folder / RESULT))
