"""Tolerances of the preflight that a user may set."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from loose_env.doctor.thresholds import (
    FASTEST_RAD_S,
    LARGE_DELAY_S,
    POSE_OFFSET,
    TURNED_DEG,
)
from loose_env.errors import InvalidSetting


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

    clock_s: float = LARGE_DELAY_S
    """Offset between the clocks of two recorders, from which it is a warning [s]."""
    turned_deg: float = TURNED_DEG
    """Angle between measured and predicted gravity at an accelerometer, from which it is a warning
    [deg]."""
    pose_offset: float = POSE_OFFSET
    """Distance of a measured from a noted joint position, from which it is a warning [rad or m]."""
    fastest: float = FASTEST_RAD_S
    """Joint speed above which the unit is doubted [rad/s or m/s]."""

    def __post_init__(self) -> None:
        """Check."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise InvalidSetting(f"{field.name} is a positive number, got {value!r}")
            if not (np.isfinite(value) and value > 0):
                raise InvalidSetting(f"{field.name} is a positive number, got {value!r}")
