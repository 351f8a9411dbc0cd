"""Settings of the motion that a controller will play: limits, kind of command, files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.validation import check_types

CommandKind = Literal["model", "torque", "velocity", "position"]
"""Kind of command: that of the model's actuators, or one for all joints."""

_LISTS = ("max_speed_rad_s", "max_acceleration_rad_s2", "max_jerk_rad_s3", "max_torque_rate_nm_s")
_FORMATS = ("csv", "parquet", "ros2")


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """Limits of the machine's controller, and the commands that it takes.

    A limit is one value for all joints, or one for each joint, base first. Where none is given,
    the model's own counts; a speed that is stated nowhere is assumed.

    Examples
    --------
    >>> MotionSettings(max_speed_rad_s=(0.0,))
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: max_speed_rad_s is one positive number for all joints, or ...
    """

    max_speed_rad_s: tuple[float, ...] = ()
    """Largest speed of each joint and of its command [rad/s; m/s where it slides]; by default as
    the model states, else 3.14 rad/s or 1 m/s."""
    max_acceleration_rad_s2: tuple[float, ...] = ()
    """Largest acceleration of each joint and of its command [rad/s²; m/s² where it slides]; by
    default as the model states, else none."""
    max_jerk_rad_s3: tuple[float, ...] = ()
    """Largest jerk of each joint and of its command [rad/s³; m/s³ where it slides]; by default as
    the model states, else none."""
    max_torque_rate_nm_s: tuple[float, ...] = ()
    """Largest rate of each joint's torque [N·m/s; N/s where it slides]; by default as the model
    states, else none."""
    command_bandwidth_hz: float | None = None
    """Frequency up to which the controller follows its commands [Hz]; the band ends there. By
    default the band is that of the arm."""
    command_rate_hz: float | None = None
    """Rate at which the controller takes commands, and the rate of the signal's files [Hz]; by
    default rate_hz."""
    commands: CommandKind = "model"
    """Kind of command: 'model', those of the model's actuators; 'torque', to be added to what the
    controller gives; 'position' or 'velocity', the motion that the joints are to follow."""
    signal_format: tuple[str, ...] = ("csv", "parquet")
    """Files of the signal: csv, parquet, ros2 (a trajectory_msgs/JointTrajectory as YAML)."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        for name in _LISTS:
            values = getattr(self, name)
            if not all(np.isfinite(v) and v > 0 for v in values):
                raise InvalidSetting(
                    f"{name} is one positive number for all joints, or one for each, got {values}"
                )
        for name in ("command_bandwidth_hz", "command_rate_hz"):
            value = getattr(self, name)
            if value is not None and not 0 < value <= 1e6:
                raise InvalidSetting(f"{name} is above 0 and at most 1e6 Hz, got {value!r}")
        wrong = [one for one in self.signal_format if one not in _FORMATS]
        if wrong or not self.signal_format:
            raise InvalidSetting(
                f"signal_format is one or more of {', '.join(_FORMATS)}, got "
                f"{' '.join(self.signal_format) or 'none'}"
            )
