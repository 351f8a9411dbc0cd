"""Standard deviations of the errors of a nominal model and its sensors, as settings."""

from __future__ import annotations

from dataclasses import dataclass, fields

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.validation import check_types


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of the errors of the nominal model and the sensors.

    Examples
    --------
    >>> Tolerances(inertial_parameters=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: inertial_parameters is a standard deviation above 0, got -1.0
    """

    inertial_parameters: float = 0.02
    """Masses, inertias and rotor inertias, relative."""
    servo_gain: float = 0.1
    """Gains of servos and torque constants of motors, relative."""
    damping: float = 0.1
    """Damping of joints, relative."""
    length: float = 0.002
    """Lengths of links, relative."""
    motor_side: float = 0.05
    """Share of a link's mass that is on the motor's side of its seat."""
    joint_zero: float = 0.003
    """Zeros of joints [rad or m]."""
    sensor_gain: float = 0.01
    """Gain of each accelerometer axis, relative."""
    cross_axis: float = 0.03
    """Leakage of each accelerometer axis into each other one, mounting included, relative."""
    sensor_offset: float = 0.002
    """Place of each accelerometer, along each axis [m]."""
    command_delay: float = 0.0005
    """Delay of the commands and torques against the readings, beside half a sample; in every run
    another [s]."""
    sensor_delay: float = 0.0001
    """Delay of the accelerometers against the joints' sensors; in every run another [s]."""
    sensor_clock: float = 0.001
    """The same delay in all runs: recorders with clocks of their own [s]."""
    sensor_lag: float = 0.00003
    """Time constant of the accelerometers' low-pass of second order, median [s]: a bandwidth of
    5 kHz."""
    sensor_lag_sd: float = 1.5
    """Standard deviation of its logarithm [1]."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0:
                raise InvalidSetting(f"{field.name} is a standard deviation above 0, got {value!r}")
