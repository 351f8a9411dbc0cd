"""What a diagnosis can be told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.tolerances import Tolerances

__all__ = ["DiagnoseSettings"]


@dataclass(frozen=True, kw_only=True)
class DiagnoseSettings:
    """What is known of the machine beforehand, and how to go on.

    Examples
    --------
    >>> DiagnoseSettings(sound=1.5)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: sound is a probability between 0 and 1, got 1.5
    """

    sound: float = 0.5
    """Probability, before any data, that nothing is loose."""
    sure: float = 0.98
    """Probability from which, after two runs, nothing more is to be measured."""
    figures: float = Tolerances.figures
    """Standard deviation of masses, inertias, rotors and drive gains of the model, relative."""
    damping: float = Tolerances.damping
    """Standard deviation of the joints' damping, relative."""
    length: float = Tolerances.length
    """Standard deviation of link lengths, relative."""
    joint_zero: float = Tolerances.joint_zero
    """Standard deviation of the joints' zeros [rad or m]."""
    sensor_gain: float = Tolerances.sensor_gain
    """Standard deviation of an accelerometer's gain, relative."""
    cross_axis: float = Tolerances.cross_axis
    """Standard deviation of what leaks from one accelerometer axis into another, mounting
    included, relative."""
    command_delay: float = Tolerances.command_delay
    """Standard deviation of the time by which commands and torques are noted too late or too early
    against the readings, in every run anew [s]."""
    sensor_delay: float = Tolerances.sensor_delay
    """Standard deviation of the time by which accelerometers lag the joints' sensors, in every run
    anew [s]."""
    seconds: float = 4.0
    """Length of the next record [s]."""
    band_low: float | None = None
    """Lower end of the next band [Hz]; by default as the arm's modes ask for."""
    band_high: float | None = None
    """Upper end of the next band, at most 0.4 of the sampling rate [Hz]; by default as the arm's
    modes ask for."""
    poses: int = 24
    """Poses among which the next one is chosen."""
    seed: int = 0
    """Of the draw of these poses."""

    def __post_init__(self) -> None:
        """Check."""
        for name in ("sound", "sure"):
            value = getattr(self, name)
            if not (np.isfinite(value) and 0 < value < 1):
                raise InvalidSetting(f"{name} is a probability between 0 and 1, got {value!r}")
        if not (np.isfinite(self.seconds) and 0.2 <= self.seconds <= 600):
            raise InvalidSetting(f"seconds is a length of 0.2 to 600 s, got {self.seconds!r}")
        if self.poses < 1:
            raise InvalidSetting(f"poses is a number of one or more, got {self.poses!r}")
        _ = self.tolerances, self.next_settings()  # they check themselves

    def next_settings(self, rate_hz: float = NextSettings.rate_hz) -> NextSettings:
        """Settings with which the next measurement is chosen, for a sampling rate [Hz]."""
        return NextSettings(
            seconds=self.seconds,
            poses=self.poses,
            seed=self.seed,
            rate_hz=rate_hz,
            band_low=self.band_low,
            band_high=self.band_high,
        )

    @property
    def tolerances(self) -> Tolerances:
        """How far model and sensors may be off."""
        return Tolerances(
            figures=self.figures,
            damping=self.damping,
            length=self.length,
            joint_zero=self.joint_zero,
            sensor_gain=self.sensor_gain,
            cross_axis=self.cross_axis,
            command_delay=self.command_delay,
            sensor_delay=self.sensor_delay,
        )
