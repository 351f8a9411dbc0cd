"""Smoothed position, speed and acceleration of a run's joints, with their remaining noise.

Position, speed and acceleration pass the same low-pass filter as the torques compared with them,
forwards and backwards, so that a torque proportional to an acceleration stays so. The band ends
where the motion does, or earlier, where the noise of the acceleration exceeds that of the torque,
if that does not cut most of the motion: errors are white up to there, and above it they grow with
the square of the frequency. Frequencies without motion carry no information, but a spring's
resonance amplifies noise there. A speed sensor replaces the encoder's derivative at high
frequencies, from where it is the less noisy of the two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import sosfiltfilt

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.motion_band import HIGHEST, ORDER, Band, band_end, low_pass
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.statistics import noise_floor
from loose_env.typing import Array

_EVALUATED = 1.8
"""Compared samples per period of the band's end; errors of neighbours are little autocorrelated."""
_KERNEL = 4096
"""Samples over which the filters' gains are measured, at most."""
_POSITION, _SPEED = int(mujoco.mjtSensor.mjSENS_JOINTPOS), int(mujoco.mjtSensor.mjSENS_JOINTVEL)


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothedMotion:
    """Smoothed motion of all joints on a uniform grid, with the compared points."""

    band: Band
    """Filter of the motion."""
    time: Array
    """Grid times [s] (G,)."""
    position: Array
    """Position [rad, m] (G, joints)."""
    speed: Array
    """Velocity [rad/s, m/s] (G, joints)."""
    acceleration: Array
    """Acceleration [rad/s², m/s²] (G, joints)."""
    noise: Array
    """Standard deviation of position, speed and acceleration (3, joints)."""
    crossing: Array
    """Frequency above which a speed sensor counts, infinite without one (joints,) [Hz]."""
    chosen: NDArray[np.intp]
    """Indices of the compared grid points (E,)."""

    @property
    def states(self) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration at the compared points (E, joints)."""
        at = self.chosen
        return self.position[at], self.speed[at], self.acceleration[at]


def even_grid(time: Array) -> Array:
    """Uniform grid with as many points from the first to the last time (T,)."""
    return np.linspace(time[0], time[-1], len(time))


def filled(time: Array, values: Array, grid: Array) -> Array:
    """Interpolate values (T,) to a grid (G,), linearly across gaps.

    Examples
    --------
    >>> filled(np.arange(3.0), np.array([1.0, np.nan, 3.0]), np.arange(3.0))
    array([1., 2., 3.])
    """
    good = np.isfinite(values)
    if good.all() and len(grid) == len(time) and np.allclose(grid, time, rtol=0, atol=1e-9):
        return values
    return np.asarray(np.interp(grid, time[good], values[good]))


def smooth_motion(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    readings: dict[str, Array] | None = None,
    band: Band | None = None,
) -> SmoothedMotion:
    """Smooth the motion of a run."""
    grid = even_grid(trial.time)
    rate = trial.rate
    positions, speeds = _joint_columns(trial, machine, channels, readings or {}, grid)
    if band is None:
        band = Band(rate=rate, end=band_end(trial, machine, channels, positions, speeds))
    if len(grid) < 4 * ORDER or grid[-1] < 2.0 / band.end:
        raise InvalidData(
            f"{trial.name}: {trial.time[-1]:.3g} s are too short to smooth a motion with; an "
            f"inverse comparison needs at least {2.0 / band.end:.2g} s"
        )
    count = len(machine.joints)
    found = np.zeros((3, len(grid), count))
    found[0] = trial.position
    noise, crossing = np.zeros((3, count)), np.full(count, np.inf)
    for joint, values in positions.items():
        speed = speeds.get(joint)
        crossing[joint] = _crossing(values, speed, band)
        found[:, :, joint] = _smoothed(values, speed, band, crossing[joint])
        noise[:, joint] = _noise_left(values, speed, band, crossing[joint])
    every = max(1, int(rate / (_EVALUATED * band.end)))
    return SmoothedMotion(
        band=band, time=grid, position=found[0], speed=found[1], acceleration=found[2],
        noise=noise, crossing=crossing, chosen=np.arange(0, len(grid), every),
    )  # fmt: skip


def with_readings(
    motion: SmoothedMotion,
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    readings: Mapping[str, Array],
) -> SmoothedMotion:
    """Motion with other readings of some sensors, through the same filters."""
    there = {j for c in readings if (j := _joint_read(machine, c)[1]) is not None}
    positions, speeds = _joint_columns(trial, machine, channels, readings, motion.time)
    parts = [motion.position.copy(), motion.speed.copy(), motion.acceleration.copy()]
    for joint in there & positions.keys():
        smooth = _smoothed(
            positions[joint], speeds.get(joint), motion.band, float(motion.crossing[joint])
        )
        for part, values in zip(parts, smooth, strict=True):
            part[:, joint] = values
    return replace(motion, position=parts[0], speed=parts[1], acceleration=parts[2])


def _joint_columns(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    readings: Mapping[str, Array],
    grid: Array,
) -> tuple[dict[int, Array], dict[int, Array]]:
    """Position and speed readings on the grid, by joint index."""
    positions: dict[int, Array] = {}
    speeds: dict[int, Array] = {}
    for k, channel in enumerate(channels):
        kind, joint = _joint_read(machine, channel.column)
        values = readings.get(channel.column, trial.measured[:, k])
        if joint is None or not np.isfinite(values).any():
            continue
        found = positions if kind == _POSITION else speeds
        if joint not in found:
            found[joint] = filled(trial.time, values, grid)
    return positions, speeds


def _joint_read(machine: NominalModel, column: str) -> tuple[int, int | None]:
    """Sensor type and joint of a column; no joint if it reads no position or speed of one."""
    prefix, _, name = column.partition(".")
    if prefix != "sensor":
        return -1, None
    sensor = machine.model.sensor(name)
    kind = int(sensor.type[0])
    return kind, int(sensor.objid[0]) if kind in (_POSITION, _SPEED) else None


def _derivative(values: Array, rate: float, order: int = 1) -> Array:
    """Derivative on the grid, from the quintic spline through the values (T,)."""
    grid = np.arange(len(values)) / rate
    spline = make_interp_spline(grid, values, k=5)
    assert isinstance(spline, BSpline)
    return np.asarray(spline(grid, nu=order))


def _low(values: Array, band: Band, crossing: float) -> Array:
    """Complementary low-pass of the encoder: 1 / (1 + (f / crossing)²), zero-phase."""
    if crossing >= HIGHEST * band.rate:
        return values
    low = low_pass(1, crossing, band.rate)
    pad = min(len(values) - 1, int(2 * band.rate / crossing))
    return np.asarray(sosfiltfilt(low, values, padlen=pad))


def _settled(values: Array, band: Band, crossing: float) -> Array:
    """Flatten the ends of values (T,), where filters of a run have transients.

    A derivative is inaccurate there, and a slow filter would spread that far into the run.
    """
    ends = int(2 * band.rate / band.end)
    inner = values[ends : len(values) - ends]
    span = min(max(ends, int(band.rate / (2 * np.pi * crossing))), len(inner) // 2)
    if not span:
        return values
    return np.pad(inner, ends, mode="mean", stat_length=span)


def _smoothed(position: Array, speed: Array | None, band: Band, crossing: float) -> Array:
    """Smooth to position, speed and acceleration (3, T)."""
    smooth = band.smooth(position)
    rate = _derivative(smooth, band.rate)
    if speed is not None:
        other = band.smooth(speed)
        rate = other + _low(_settled(rate - other, band, crossing), band, crossing)
    return np.stack([smooth, rate, _derivative(rate, band.rate)])


def _crossing(position: Array, speed: Array | None, band: Band) -> float:
    """Crossover frequency above which the speed sensor is less noisy [Hz].

    Where speed and derivative differ by more than their noise, that difference is taken as the
    error of the speed sensor: many drives filter their speed signal.
    """
    if speed is None:
        return np.inf
    noise = noise_floor(speed)
    smooth = band.smooth(position)
    apart = band.smooth(speed) - _derivative(smooth, band.rate)
    edge = min(len(apart) // 4, int(band.rate / band.end))
    inner = apart[edge : len(apart) - edge]
    passed = np.sqrt(2 * band.end / band.rate)
    derived = 2 * np.pi * band.end * noise_floor(position) * passed / np.sqrt(3)
    excess = float(np.var(inner)) - derived**2
    noise = max(noise, np.sqrt(max(excess, 0.0)) / passed)
    return float(noise / (2 * np.pi * noise_floor(position)))


def _noise_left(position: Array, speed: Array | None, band: Band, crossing: float) -> Array:
    """Standard deviation of filtered white noise in position, speed and acceleration.

    Gains of the filters are the norms of their impulse responses.
    """
    size = min(len(position), _KERNEL)
    impulse, nothing = np.zeros(size), np.zeros(size)
    impulse[size // 2] = 1.0
    other = None if speed is None else nothing
    power = noise_floor(position) ** 2 * np.sum(
        _smoothed(impulse, other, band, crossing) ** 2, axis=1
    )
    if speed is not None:
        power = power + noise_floor(speed) ** 2 * np.sum(
            _smoothed(nothing, impulse, band, crossing) ** 2, axis=1
        )
    return np.asarray(np.sqrt(power))
