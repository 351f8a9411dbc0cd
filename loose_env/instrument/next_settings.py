"""How the next measurement is chosen: noise, rate, length and band of records, and the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.sensors import Accelerometer, SensorSuite

__all__ = ["NextSettings"]


@dataclass(frozen=True, kw_only=True)
class NextSettings:
    """How the next measurement is chosen."""

    gap_mm: float = 0.1
    """Free travel of interest [mm]: seats should move about as far as this."""
    noise_ug: float = 100.0
    """Noise of the tool accelerometer [µg/√Hz]."""
    rate_hz: float = 1000.0
    """Sampling rate [Hz]."""
    seconds: float = 3.0
    """Length of each record [s]."""
    most_tool: float = 15.0
    """Largest rms acceleration of the tool [m/s²]; peaks are four times that, which the
    accelerometer has to bear."""
    torque_share: float = 0.8
    """Share of each drive's peak torque that holding and shaking may take together [1]."""
    poses: int = 48
    """Poses that are weighed."""
    band_low: float | None = None
    """Lower end of the noise's band [Hz]; by default as the arm's modes ask for."""
    band_high: float | None = None
    """Upper end of the noise's band, at most 0.4 of the rate [Hz]; by default as the arm's modes
    ask for."""
    in_turn: int = 1
    """Joints that are shaken one after the other in the pose."""
    margin: float = 0.05
    """Share of each joint's range that is kept free at either end [1]."""
    seed: int = 0
    """Of everything that is drawn."""

    def __post_init__(self) -> None:
        """Check.

        Raises
        ------
        InvalidSetting
            If a figure makes no sense.
        """
        for name in ("gap_mm", "noise_ug", "rate_hz", "seconds", "most_tool"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidSetting(f"{name} is a positive number, got {value!r}")
        ends = self.band_low, self.band_high
        for name, end in zip(("band_low", "band_high"), ends, strict=True):
            if end is not None and not (np.isfinite(end) and end > 0):
                raise InvalidSetting(f"{name} is a frequency above 0 Hz, got {end!r}")
        if ends[0] is not None and ends[1] is not None and not ends[0] < ends[1]:
            raise InvalidSetting(f"a band goes upwards, got {ends[0]:g} to {ends[1]:g} Hz")
        if self.poses < 1 or self.in_turn < 1:
            raise InvalidSetting(
                f"poses and in_turn are 1 or more, got {self.poses} and {self.in_turn}"
            )
        if not 0 < self.torque_share <= 1:
            raise InvalidSetting(
                f"torque_share is above 0 and at most 1, got {self.torque_share!r}"
            )
        if not 0 <= self.margin < 0.5:
            raise InvalidSetting(f"margin is a share from 0 to below 0.5, got {self.margin!r}")
        if self.seed < 0:
            raise InvalidSetting(f"seed is zero or more, got {self.seed}")

    def band_of(self, band: tuple[float, float]) -> tuple[float, float]:
        """A band with the ends that are given in the place of its own [Hz].

        Raises
        ------
        InvalidSetting
            If that leaves nothing of it.

        Examples
        --------
        >>> NextSettings(band_high=60.0).band_of((30.0, 150.0))
        (30.0, 60.0)
        """
        low = band[0] if self.band_low is None else self.band_low
        high = band[1] if self.band_high is None else self.band_high
        if not low < high:
            raise InvalidSetting(
                f"a band from {low:g} to {high:g} Hz is none: the arm's own goes from {band[0]:g} "
                f"to {band[1]:g} Hz; give both band_low and band_high"
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
