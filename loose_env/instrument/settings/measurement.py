"""Settings of the next measurement: noise, rate, length and band of records, poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.thresholds import HIGHEST_BAND
from loose_env.instrument.settings.validation import check_types
from loose_env.sensors import Accelerometer, SensorSuite

_MOST = {"gap_mm": 1e3, "noise_ug": 1e9, "rate_hz": 1e6, "most_tool": 1e6}
"""Largest accepted values."""
_LENGTHS = (0.2, 600.0)
"""Shortest and longest record [s]."""
_SAMPLES = 5_000_000
"""Most samples of a record."""
_POSES, _IN_TURN = 10_000, 100
_SEEDS = 2**63


@dataclass(frozen=True, kw_only=True)
class NextSettings:
    """Settings of the next measurement, for a plan and for a diagnosis.

    Examples
    --------
    >>> NextSettings(poses=0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: poses is a whole number from 1 to 10000, got 0
    """

    gap_mm: float = 0.1
    """Free travel of interest [mm]: seats should move about as far as this."""
    noise_ug: float = 100.0
    """Noise of the tool accelerometer [µg/√Hz]."""
    rate_hz: float = 1000.0
    """Sampling rate [Hz]."""
    seconds: float = 4.0
    """Length of each record [s]."""
    most_tool: float = 15.0
    """Largest rms acceleration of the tool [m/s²]; peaks are four times that, which the
    accelerometer has to bear."""
    torque_share: float = 0.8
    """Share of each drive's peak torque that holding and shaking may take together [1]."""
    ground_m: float | None = None
    """Height that no link may go below, in the model's frame [m]; by default that of the base
    where the arm stands on it."""
    poses: int = 24
    """Number of candidate poses."""
    band_low: float | None = None
    """Lower end of the noise's band [Hz]; by default as the arm's modes ask for."""
    band_high: float | None = None
    """Upper end of the noise's band, at most 0.4 of the rate [Hz]; by default as the arm's modes
    and the rate ask for."""
    in_turn: int = 1
    """Joints that are shaken one after the other in the pose."""
    margin: float = 0.05
    """Share of each joint's range that is kept free at either end [1]."""
    seed: int = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        for name, most in _MOST.items():
            value = getattr(self, name)
            if not 0 < value <= most:
                raise InvalidSetting(f"{name} is a positive number up to {most:g}, got {value!r}")
        if not _LENGTHS[0] <= self.seconds <= _LENGTHS[1]:
            raise InvalidSetting(
                f"seconds is a length of {_LENGTHS[0]:g} to {_LENGTHS[1]:g} s, got {self.seconds!r}"
            )
        if self.seconds * self.rate_hz > _SAMPLES:
            raise InvalidSetting(
                f"{self.seconds:g} s at {self.rate_hz:g} Hz are more than {_SAMPLES} samples; take "
                "a lower rate_hz or fewer seconds"
            )
        ends = self.band_low, self.band_high
        for name, end in zip(("band_low", "band_high"), ends, strict=True):
            if end is not None and not end > 0:
                raise InvalidSetting(f"{name} is a frequency above 0 Hz, got {end!r}")
        if ends[0] is not None and ends[1] is not None and not ends[0] < ends[1]:
            raise InvalidSetting(f"a band goes upwards, got {ends[0]:g} to {ends[1]:g} Hz")
        if ends[1] is not None and ends[1] > self.allowed_hz * (1 + 1e-9):
            raise InvalidSetting(
                f"band_high is at most 0.4 of the rate, {self.allowed_hz:g} Hz at rate_hz "
                f"{self.rate_hz:g}, got {ends[1]:g}; take a higher rate or a lower band"
            )
        for name, most in (("poses", _POSES), ("in_turn", _IN_TURN)):
            value = getattr(self, name)
            if not 1 <= value <= most:
                raise InvalidSetting(f"{name} is a whole number from 1 to {most}, got {value}")
        if not 0 < self.torque_share <= 1:
            raise InvalidSetting(
                f"torque_share is above 0 and at most 1, got {self.torque_share!r}"
            )
        if not 0 <= self.margin < 0.5:
            raise InvalidSetting(f"margin is a share from 0 to below 0.5, got {self.margin!r}")
        if not 0 <= self.seed < _SEEDS:
            raise InvalidSetting(f"seed is zero or more, and below 2**63, got {self.seed!r:.60}")

    @property
    def allowed_hz(self) -> float:
        """Highest frequency of a band that the rate allows [Hz]."""
        return HIGHEST_BAND * self.rate_hz

    def at_rate(self, rate_hz: float) -> NextSettings:
        """These settings for a recorder of another rate; the band ends where that rate allows.

        Examples
        --------
        >>> slow = NextSettings(band_high=200.0).at_rate(250.0)
        >>> slow.rate_hz, slow.band_high
        (250.0, 100.0)
        """
        high = None if self.band_high is None else min(self.band_high, HIGHEST_BAND * rate_hz)
        return replace(self, rate_hz=rate_hz, band_high=high)

    def band_of(self, band: tuple[float, float]) -> tuple[float, float]:
        """Band with its ends replaced by the settings and limited by the rate [Hz].

        Raises
        ------
        InvalidSetting
            If that leaves nothing of it.

        Examples
        --------
        >>> NextSettings(band_high=60.0).band_of((30.0, 150.0))
        (30.0, 60.0)
        >>> NextSettings(rate_hz=200.0).band_of((30.0, 150.0))
        (30.0, 80.0)
        """
        low = band[0] if self.band_low is None else self.band_low
        high = min(band[1], self.allowed_hz) if self.band_high is None else self.band_high
        if not low < high:
            raise InvalidSetting(
                f"a band from {low:g} to {high:g} Hz is none: the arm's own goes from {band[0]:g} "
                f"to {band[1]:g} Hz, and a rate of {self.rate_hz:g} Hz allows up to "
                f"{self.allowed_hz:g} Hz; give band_low and band_high, or a higher rate"
            )
        return float(low), float(high)

    @property
    def sensors(self) -> SensorSuite:
        """Sensors with that noise and rate."""
        density = self.noise_ug * 1e-6 * 9.80665
        band = min(400.0, 0.45 * self.rate_hz)
        return SensorSuite(
            rate=self.rate_hz,
            accelerometer=Accelerometer(noise_density=density, bandwidth=band),
        )
