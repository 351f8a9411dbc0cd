"""What sensors make of motion: band, gain and cross-axis, noise, steps."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import upfirdn

from loose_env.errors import InvalidSetting

__all__ = [
    "Accelerometer",
    "Encoder",
    "SensorSuite",
    "decimation_filter",
    "read_accelerometer",
    "read_encoder",
]

Array = NDArray[np.float64]
STANDARD_GRAVITY = 9.80665


def _check(settings: object, *names: str) -> None:
    for name in names:
        value = getattr(settings, name)
        if not np.isfinite(value) or value < 0:
            raise InvalidSetting(
                f"{type(settings).__name__}.{name} must be finite, zero or more; got {value!r}"
            )


@dataclass(frozen=True, kw_only=True)
class Accelerometer:
    """A two- or three-axis accelerometer and its recorder.

    Gains, cross-axis sensitivity and mounting differ from arm to arm: they are part of
    `loose_env.arms.mismatch.Mismatch` and reach the readings as one matrix.
    """

    noise_density: float = 100e-6 * STANDARD_GRAVITY
    """White noise [m/s² per √Hz]; capacitive sensors have 22 to 300 µg/√Hz."""
    bandwidth: float = 400.0
    """Half-amplitude frequency of the recorder's low-pass [Hz]; linear-phase, delay taken out."""
    resolution: float = 2 * 50 * STANDARD_GRAVITY / 2**16
    """Step of the digitiser [m/s²]: 16 bits over ±50 g."""

    def __post_init__(self) -> None:
        _check(self, *(f.name for f in fields(self)))


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """A joint encoder on the motor side."""

    resolution: float = 2 * np.pi / 2**20
    """Step of the reading [rad]: 20 bits a turn."""
    noise: float = 2e-6
    """Rms noise of one reading before it is rounded [rad]."""

    def __post_init__(self) -> None:
        _check(self, "resolution", "noise")


@dataclass(frozen=True, kw_only=True)
class SensorSuite:
    """All sensors of an arm and the rate at which they are recorded."""

    rate: float = 1000.0
    """Sampling rate [Hz]."""
    accelerometer: Accelerometer = Accelerometer()
    """Accelerometer at the tool, and on every link where `link_accelerometers` is set."""
    encoder: Encoder = Encoder()
    """Encoder of every joint."""
    link_accelerometers: bool = False
    """Whether every link carries an accelerometer too, at its proximal end (8.3.3)."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InvalidSetting(f"the sampling rate must be positive Hz, got {self.rate!r}")
        if self.accelerometer.bandwidth >= self.rate / 2:
            raise InvalidSetting(
                f"an accelerometer bandwidth of {self.accelerometer.bandwidth} Hz needs a "
                f"sampling rate above twice that, got {self.rate} Hz"
            )

    @classmethod
    def ideal(cls, *, rate: float = 1000.0) -> SensorSuite:
        """Sensors that add nothing but their sampling and band."""
        return cls(
            rate=rate,
            accelerometer=Accelerometer(noise_density=0.0, resolution=0.0),
            encoder=Encoder(resolution=0.0, noise=0.0),
        )


@lru_cache(maxsize=32)
def decimation_filter(factor: int, cutoff: float, rate: float) -> Array:
    """Taps of the recorder's linear-phase low-pass before decimation.

    Parameters
    ----------
    factor : int
        Fast samples per recorded sample.
    cutoff : float
        Half-amplitude frequency [Hz].
    rate : float
        Recorded rate [Hz].

    Returns
    -------
    ndarray (8 factor + 1,)
        Hamming-windowed sinc, sum 1. Read-only.
    """
    half = 4 * factor
    k = np.arange(-half, half + 1)
    taps = np.sinc(2 * cutoff / (rate * factor) * k) * np.hamming(2 * half + 1)
    taps /= taps.sum()
    taps.flags.writeable = False
    return np.asarray(taps)


def read_accelerometer(
    true: Array,
    *,
    sensor: Accelerometer,
    matrix: Array,
    factor: int,
    first: int,
    count: int,
    rate: float,
    rng: np.random.Generator,
) -> Array:
    """Turn true proper acceleration into readings.

    Parameters
    ----------
    true : ndarray (steps, 3)
        Proper acceleration in the sensor frame at every simulation step [m/s²].
    sensor : Accelerometer
        Figures of the sensor.
    matrix : ndarray (d, 3)
        Output per true acceleration: the measured axes' gains, cross-axis and mounting.
    factor : int
        Simulation steps per reading.
    first, count : int
        Step of the first reading, and number of readings.
    rate : float
        Sampling rate [Hz].
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    ndarray (d, count)
        Readings [m/s²].
    """
    taps = decimation_filter(factor, sensor.bandwidth, rate)
    half = len(taps) // 2
    # Steps from half a filter before the first reading to half a filter after the last.
    used = true[first - half : first + factor * (count - 1) + half + 1]
    mixed = np.einsum("dc,tc->dt", matrix, used)
    lead = 2 * half // factor  # outputs before the first whole window
    readings: Array = upfirdn(taps, mixed, down=factor)[:, lead : lead + count]
    # White noise of the given density up to half the sampling rate.
    readings += sensor.noise_density * np.sqrt(rate / 2) * rng.standard_normal(readings.shape)
    return _rounded(readings, sensor.resolution)


def read_encoder(true: Array, *, sensor: Encoder, rng: np.random.Generator) -> Array:
    """Turn joint positions (n, count) [rad] into encoder readings of the same shape."""
    return _rounded(true + sensor.noise * rng.standard_normal(true.shape), sensor.resolution)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step > 0 else values
