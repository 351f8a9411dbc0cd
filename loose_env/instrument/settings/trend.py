"""Settings of the comparison with earlier sessions: false-alarm rate and sensitivity."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.validation import check_types

_HIGHEST_RATE = 0.2
"""Largest false-alarm rate."""
_SHIFTS = (0.25, 4.0)
"""Smallest and largest shift [standard deviations]."""


@dataclass(frozen=True, kw_only=True)
class TrendSettings:
    """False-alarm rate and sensitivity of the comparison with earlier sessions.

    Examples
    --------
    >>> TrendSettings(false_alarm_rate=0.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: false_alarm_rate is above 0 and at most 0.2 ..., got 0.0
    """

    false_alarm_rate: float = 0.01
    """Alarms per session of a healthy machine, all series together; 0.01: one false alarm in two
    years of weekly sessions."""
    shift: float = 1.0
    """Lasting change that is to be found soonest, in standard deviations between sessions; smaller
    finds slow wear, larger sudden changes."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        if not 0 < self.false_alarm_rate <= _HIGHEST_RATE:
            raise InvalidSetting(
                f"false_alarm_rate is above 0 and at most {_HIGHEST_RATE:g} alarms per session, "
                f"got {self.false_alarm_rate!r}"
            )
        if not _SHIFTS[0] <= self.shift <= _SHIFTS[1]:
            raise InvalidSetting(
                f"shift is {_SHIFTS[0]:g} to {_SHIFTS[1]:g} standard deviations, got {self.shift!r}"
            )
