"""Settings of a diagnosis: prior, model errors, and the next measurement."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import HIGHEST_CERTAINTY, RATE_SHARE, UNEXPLAINED
from loose_env.instrument.settings.tolerances import Tolerances


@dataclass(frozen=True, kw_only=True)
class DiagnoseSettings(NextSettings):
    """Prior and model errors of a diagnosis, and settings of the next measurement.

    Examples
    --------
    >>> DiagnoseSettings(healthy_prior=1.5)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: healthy_prior is a probability between 0 and 1, got 1.5
    """

    healthy_prior: float = 0.5
    """Probability, before any data, that nothing is loose."""
    sure: float = 0.98
    """Probability from which, after two runs, nothing more is to be measured; at most 0.995, for
    something else than all explanations stays possible."""
    inertial_parameters: float = Tolerances.inertial_parameters
    """Standard deviation of masses, inertias and rotor inertias of the model, relative."""
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
    sensor_offset: float = Tolerances.sensor_offset
    """Standard deviation of the place of an accelerometer, along each axis [m]."""
    command_delay: float = Tolerances.command_delay
    """Standard deviation of the time by which commands and torques are noted too late or too early
    against the readings, in every run anew [s]."""
    sensor_delay: float = Tolerances.sensor_delay
    """Standard deviation of the time by which accelerometers lag the joints' sensors, in every run
    anew [s]."""

    def __post_init__(self) -> None:
        """Check."""
        super().__post_init__()
        for name in ("healthy_prior", "sure"):
            value = getattr(self, name)
            if not (np.isfinite(value) and 0 < value < 1):
                raise InvalidSetting(f"{name} is a probability between 0 and 1, got {value!r}")
        if self.sure > HIGHEST_CERTAINTY:
            raise InvalidSetting(
                f"sure is at most {HIGHEST_CERTAINTY:g}, for a probability of {UNEXPLAINED:g} is "
                f"kept for causes outside the hypotheses, got {self.sure!r}"
            )
        _ = self.tolerances  # they check themselves

    def choice(self, recorded_hz: float | None = None) -> NextSettings:
        """Settings of the next measurement.

        Parameters
        ----------
        recorded_hz : float, optional
            Rate of the last run [Hz]. A recorder that is slower than asked for will be so again;
            one that is faster gives more than is needed.
        """
        own = NextSettings(**{each.name: getattr(self, each.name) for each in fields(NextSettings)})
        if recorded_hz is not None and recorded_hz < RATE_SHARE * self.rate_hz:
            return own.at_rate(recorded_hz)
        return own

    @property
    def tolerances(self) -> Tolerances:
        """Standard deviations of the errors of model and sensors."""
        return Tolerances(
            inertial_parameters=self.inertial_parameters,
            damping=self.damping,
            length=self.length,
            joint_zero=self.joint_zero,
            sensor_gain=self.sensor_gain,
            cross_axis=self.cross_axis,
            sensor_offset=self.sensor_offset,
            command_delay=self.command_delay,
            sensor_delay=self.sensor_delay,
        )
