"""Tolerances of the preflight that a user may set."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from loose_env.errors import InvalidSetting

# Tolerances
POSE_OFFSET = 0.05
"""Distance of a measured from a noted position, above which it is a finding, and a diagnosis tells
that it uses the measured one [rad or m]: servos sag by less."""
POSE_SPREAD = 0.2
"""Rms motion of a joint in a run with a noted pose, above which it is a finding, and a diagnosis
refuses the run [rad or m]: shaking about a pose stays within 0.1."""


@dataclass(frozen=True, kw_only=True)
class DoctorSettings:
    """Tolerances of the preflight.

    Raises
    ------
    InvalidSetting
        If one is not a positive number.

    Examples
    --------
    >>> DoctorSettings(clock_s=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: clock_s is a positive number, got -1.0
    """

    clock_s: float = 1e-3
    """Offset between the clocks of two recorders, from which it is a warning [s]: 54 degrees of
    phase at 150 Hz."""
    turned_deg: float = 15.0
    """Angle between measured and predicted gravity at an accelerometer, from which it is a warning
    [deg]: mounting and pose are known to a few degrees."""
    pose_offset: float = POSE_OFFSET
    """Distance of a measured from a noted joint position, from which it is a warning [rad or m]."""
    fastest: float = 60.0
    """Joint speed above which the unit is doubted [rad/s or m/s]: fast arms reach 10 rad/s."""

    def __post_init__(self) -> None:
        """Check."""
        for field in fields(self):
            value = getattr(self, field.name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (number and np.isfinite(value) and value > 0):
                raise InvalidSetting(f"{field.name} is a positive number, got {value!r}")
