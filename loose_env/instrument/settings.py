"""What a diagnosis can be told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
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
    band_low: float = 4.0
    """Lower end of the next band [Hz]."""
    band_high: float = 120.0
    """Upper end of the next band, at most a quarter of the sampling rate [Hz]."""
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
        if not 0 < self.band_low < self.band_high < np.inf:
            raise InvalidSetting(
                f"a band goes upwards from above 0 Hz, got {self.band_low!r} to {self.band_high!r}"
            )
        if self.poses < 1:
            raise InvalidSetting(f"poses is a number of one or more, got {self.poses!r}")
        self.tolerances  # noqa: B018  (checks them)

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
