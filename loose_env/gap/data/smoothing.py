"""Zero-phase smoothing of measured motion, with its remaining noise.

Position, speed and acceleration pass the same low-pass filter as the torques compared with them,
forwards and backwards, so that a torque proportional to an acceleration stays so. The band ends
where the motion does, or earlier, where the noise of the acceleration exceeds that of the torque,
if that does not cut most of the motion: errors are white up to there, and above it they grow with
the square of the frequency. Frequencies without motion carry no information, but a spring's
resonance amplifies noise there. A speed sensor replaces the encoder's derivative at high
frequencies, from where it is the less noisy of the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import butter, sosfiltfilt, welch
from scipy.stats import chi2

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.noise_floor import noise_floor
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

__all__ = ["Band", "Motion", "even_grid", "filled", "motion_band", "smooth_motion"]


_ORDER = 4
"""Order of the low-pass filter, which acts twice."""
_STANDS_OUT = 4.0
"""Power of a motion over that of the noise that makes it visible, in a long run."""
_BULK = 0.99
"""Share of the mean square speed that is the bulk of a motion."""
_CHANCE = 1e-3
"""Chance that noise stands out anywhere in a reading."""
_LOWEST = 2.0
"""Lowest end of a band [Hz]."""
_ROOM = 2.0
"""End of the band over the highest frequency of the motion: nearly all of that passes."""
_HIGHEST = 0.4
"""Highest end of a band, as a share of the sample rate: below half of it."""
_EVALUATED = 1.8
"""Compared samples per period of the band's end; the errors of neighbours hang together little."""
_KERNEL = 4096
"""Samples over which the filters' gains are measured, at most."""


@lru_cache(maxsize=256)
def _low_pass(order: int, end: float, rate: float) -> Array:
    """Second-order sections of a Butterworth low-pass, shared by all hypotheses."""
    return np.asarray(butter(order, end, fs=rate, output="sos"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """Zero-phase low-pass filter on a uniform grid."""

    rate: float
    """Sample rate of the grid [1/s]."""
    end: float
    """Cut-off frequency, at which half of an amplitude passes [Hz]."""

    def smooth(self, values: Array) -> Array:
        """Filter values (T, ...) forwards and backwards."""
        low = _low_pass(_ORDER, self.end, self.rate)
        pad = min(len(values) - 1, int(2 * self.rate / self.end))
        return np.asarray(sosfiltfilt(low, values, axis=0, padlen=pad))


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
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


def motion_band(columns: Sequence[Array], rate: float) -> float:
    """Highest frequency at which any of some readings exceeds its noise [Hz].

    Parameters
    ----------
    columns : sequence of ndarray (T,)
        Positions and speeds, without gaps.
    rate : float
        Samples per second.

    Examples
    --------
    >>> time = np.arange(4000) / 500
    >>> noisy = np.sin(2 * np.pi * 3 * time) + np.random.default_rng(1).normal(0, 0.01, 4000)
    >>> 2.9 < motion_band([noisy], 500.0) < 5.0
    True
    """
    return min(max((_ends(v, rate)[1] for v in columns), default=_LOWEST), _HIGHEST * rate)


def _ends(values: Array, rate: float) -> tuple[float, float]:
    """Upper frequencies of most of a reading's motion, and of all above noise [Hz].

    Most of the motion is 99 % of the mean square speed above the noise.
    """
    floor = noise_floor(values)
    change = np.diff(values, 2)
    size = min(len(change), max(64, int(2 * rate)))
    frequency, power = welch(change, fs=rate, window="blackmanharris", nperseg=size, detrend=False)
    # Second differences amplify high frequencies, of signal and noise alike.
    raised = (2 - 2 * np.cos(2 * np.pi * frequency / rate)) ** 2
    segments = max(1, (len(change) - size // 2) // (size - size // 2))
    by_chance = chi2.isf(_CHANCE / len(frequency), 2 * segments) / (2 * segments)
    stands_out = max(_STANDS_OUT * (1 + 2 / np.sqrt(segments)), by_chance)
    visible = power > stands_out * raised * floor**2 * 2 / rate
    # One line alone may be interference: its neighbour has to exceed the noise too.
    sure = np.flatnonzero(visible[1:-1] & (visible[:-2] | visible[2:])) + 1
    if not len(sure):
        return _LOWEST, _LOWEST
    speeds = np.cumsum(power[sure] / np.sqrt(raised[sure]))
    bulk = sure[int(np.searchsorted(speeds, _BULK * speeds[-1]))]
    return max(_LOWEST, float(frequency[bulk])), max(_LOWEST, float(frequency[sure[-1]]))


def smooth_motion(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    readings: dict[str, Array] | None = None,
    band: Band | None = None,
) -> Motion:
    """Smooth the motion of a run.

    Parameters
    ----------
    trial : Trial
        The run.
    machine : NominalModel
        The nominal model.
    channels : sequence of Channel
        The run's columns.
    readings : dict, optional
        Column -> readings (T,) in place of those measured.
    band : Band, optional
        What passes; by default what holds the motion, as far as the torque's noise is the louder.

    Raises
    ------
    InvalidData
        If the run is too short to be smoothed.
    """  # fmt: skip
    grid = even_grid(trial.time)
    rate = trial.rate
    positions, speeds = _joint_columns(trial, machine, channels, readings or {}, grid)
    if band is None:
        band = Band(rate=rate, end=_band_end(trial, machine, channels, positions, speeds))
    if len(grid) < 4 * _ORDER or grid[-1] < 2.0 / band.end:
        raise InvalidData(
            f"{trial.name}: {trial.time[-1]:.3g} s are too short to smooth a motion with; an "
            f"inverse comparison needs at least {2.0 / band.end:.2g} s"
        )
    count = len(machine.joints)
    found = np.zeros((3, len(grid), count))
    found[0] = trial.position
    noise = np.zeros((3, count))
    for joint, values in positions.items():
        speed = speeds.get(joint)
        crossing = _crossing(values, speed, band)
        found[:, :, joint] = _smoothed(values, speed, band, crossing)
        noise[:, joint] = _noise_left(values, speed, band, crossing)
    every = max(1, int(rate / (_EVALUATED * band.end)))
    return Motion(
        band=band, time=grid, position=found[0], speed=found[1], acceleration=found[2],
        noise=noise, chosen=np.arange(0, len(grid), every),
    )  # fmt: skip


def _band_end(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    positions: dict[int, Array],
    speeds: dict[int, Array],
) -> float:
    """End of the band of a run [Hz].

    The end of the motion; or lower, where noise of the acceleration exceeds that of the torque, but
    not so low that it cuts most of the motion: the model is not linear in that.
    """
    rate = trial.rate
    ends = [_ends(values, rate) for values in positions.values()]
    bulk = max((low for low, _ in ends), default=_LOWEST)
    highest = motion_band([*positions.values(), *speeds.values()], rate)
    balanced = _balance(trial, machine, channels, positions, speeds)
    end = max(balanced, _ROOM * bulk) if balanced > 0 else np.inf
    return float(min(_ROOM * highest, end, _HIGHEST * rate))


def _balance(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    positions: dict[int, Array],
    speeds: dict[int, Array],
) -> float:
    """Frequency where torque noise equals inertia times acceleration noise [Hz].

    Geometric mean over the joints whose torque was measured; 0 if there are none.
    """
    frequency = np.geomspace(_LOWEST, _HIGHEST * trial.rate, 200)
    turn = 2 * np.pi * frequency
    found = []
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        if prefix != "torque" or not np.isfinite(trial.measured[:, k]).any():
            continue
        joint = machine.joint_number(name)
        if joint not in positions:
            continue
        known = 1 / (turn**2 * noise_floor(positions[joint])) ** 2
        if joint in speeds:
            known = known + 1 / (turn * noise_floor(speeds[joint])) ** 2
        ratio = machine.inertias[joint] / np.sqrt(known) / noise_floor(trial.measured[:, k])
        found.append(frequency[min(int(np.searchsorted(ratio, 1.0)), len(frequency) - 1)])
    return float(np.exp(np.mean(np.log(found)))) if found else 0.0


def _joint_columns(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    readings: dict[str, Array],
    grid: Array,
) -> tuple[dict[int, Array], dict[int, Array]]:
    """Position and speed readings on the grid, by joint index."""
    positions: dict[int, Array] = {}
    speeds: dict[int, Array] = {}
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        values = readings.get(channel.column, trial.measured[:, k])
        if prefix != "sensor" or not np.isfinite(values).any():
            continue
        sensor = machine.model.sensor(name)
        kind, joint = int(sensor.type[0]), int(sensor.objid[0])
        if kind == mujoco.mjtSensor.mjSENS_JOINTPOS and joint not in positions:
            positions[joint] = filled(trial.time, values, grid)
        elif kind == mujoco.mjtSensor.mjSENS_JOINTVEL and joint not in speeds:
            speeds[joint] = filled(trial.time, values, grid)
    return positions, speeds


def _derivative(values: Array, rate: float, order: int = 1) -> Array:
    """Derivative on the grid, from the quintic spline through the values (T,)."""
    grid = np.arange(len(values)) / rate
    spline = make_interp_spline(grid, values, k=5)
    assert isinstance(spline, BSpline)
    return np.asarray(spline(grid, nu=order))


def _low(values: Array, band: Band, crossing: float) -> Array:
    """Complementary low-pass of the encoder: 1 / (1 + (f / crossing)²), zero-phase."""
    if crossing >= _HIGHEST * band.rate:
        return values
    low = _low_pass(1, crossing, band.rate)
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
