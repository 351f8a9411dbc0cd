"""Measure only as long as the wanted angle needs (8.1.1).

Records of a pose are pooled until the confidence region of the direction is as narrow as wanted.
Scatter falls with the root of time, so the first short records say how much more is needed; what
sensors and model get wrong does not fall at all, so they also say when to give up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.research.sequential.transmission_change import (
    Instrument,
    MeasuredChange,
    change_of_transmission,
)
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation
from loose_env.rig import Measurement
from loose_env.statistics import ChangeDirection, TransmissionEstimate, change_direction

__all__ = ["Ending", "StoppingRule", "TimedDirection", "measure_direction"]

_SILENT = 1e-4
"""Share of the records' scatter that is kept to see what is left without it."""


class Ending(Enum):
    """Reasons for the end of a measurement of a direction."""

    REACHED = "the direction is known as closely as wanted"
    FLOOR = "longer records would not help: sensors and model leave more than the angle wanted"
    SPENT = "the time allowed is spent"


@dataclass(frozen=True, kw_only=True)
class StoppingRule:
    """Wanted precision of a direction, and its budget."""

    half_angle: float = float(np.radians(5.0))
    """Half angle of the confidence region that is wanted [rad]."""
    level: float = 0.95
    """Confidence level of the region."""
    first: float = 0.2
    """Length of the first record of each excitation [s]."""
    longest: float = 4.8
    """Most seconds of records for each excitation [s]."""

    def __post_init__(self) -> None:
        if not 0 < self.half_angle < np.pi / 2:
            raise InvalidSetting(
                f"half_angle must lie between 0 and pi/2 rad, got {self.half_angle!r}"
            )
        if not 0 < self.level < 1:
            raise InvalidSetting(f"level must lie between 0 and 1, got {self.level!r}")
        if not 0 < self.first <= self.longest < np.inf:
            raise InvalidSetting(
                f"lengths must be 0 < first <= longest, got {self.first!r} and {self.longest!r} s"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedDirection:
    """A direction, and the time it took."""

    direction: ChangeDirection
    """Direction of the change and its region."""
    change: MeasuredChange
    """The change itself."""
    seconds: float
    """Seconds of records for each excitation [s]."""
    ending: Ending
    """Reason for its end."""
    floor: float
    """Half angle that would be left without any scatter of the records [rad]."""
    records: tuple[Measurement, ...]
    """All that was measured."""


def measure_direction(
    measure: Callable[[Excitation], Measurement],
    linear: LinearArm,
    excitations: Sequence[Excitation],
    *,
    rule: StoppingRule | None = None,
    healthy: Sequence[Measurement] | None = None,
    mismatch: Mismatch | None = None,
    instrument: Instrument = "command",
) -> TimedDirection:
    """Measure in one pose until the direction of looseness is known closely enough.

    Parameters
    ----------
    measure : callable
        Takes an excitation, returns its record; a rig's ``measure`` with the pose filled in.
    linear : LinearArm
        The nominal arm.
    excitations : sequence of Excitation
        Excitations, each in turn; their own durations are ignored.
    rule : StoppingRule, optional
        Wanted angle and allowed time.
    healthy, mismatch, instrument
        As in `loose_env.diagnosis.research.sequential.transmission_change.change_of_transmission`.

    Returns
    -------
    TimedDirection
        The direction from all records together.

    Raises
    ------
    InvalidData
        If nothing is to be played, or the records cannot be used.

    Notes
    -----
    Looking several times and stopping at the first narrow region makes the regions a little too
    narrow; there are seldom more than three looks.
    """
    if not excitations:
        raise InvalidData("no excitation is given; one or more are needed")
    wanted = StoppingRule() if rule is None else rule
    records: list[Measurement] = []
    seconds, length = 0.0, wanted.first
    while True:
        records += [measure(replace(shake, duration=length)) for shake in excitations]
        seconds += length
        change = change_of_transmission(
            linear, records, healthy=healthy, mismatch=mismatch, instrument=instrument
        )
        found = change_direction(change.estimate, wanted.level)
        floor = change_direction(_without_scatter(change), wanted.level).half_angle
        ending = None
        if found.half_angle <= wanted.half_angle:
            ending = Ending.REACHED
        elif floor > wanted.half_angle and found.half_angle < np.radians(60.0):
            # A region that is nearly everything says nothing yet about where the floor will be.
            ending = Ending.FLOOR
        elif seconds >= wanted.longest - 1e-9:
            ending = Ending.SPENT
        if ending is not None:
            return TimedDirection(
                direction=found,
                change=change,
                seconds=seconds,
                ending=ending,
                floor=floor,
                records=tuple(records),
            )
        length = _next_length(seconds, found.half_angle, floor, wanted)


def _without_scatter(change: MeasuredChange) -> TransmissionEstimate:
    own = change.sampling.covariance
    return TransmissionEstimate(
        change.estimate.b, change.estimate.covariance - (1 - _SILENT) * own, np.inf
    )


def _next_length(seconds: float, angle: float, floor: float, wanted: StoppingRule) -> float:
    """Seconds still missing if the scatter falls with the root of time."""
    left = wanted.longest - seconds
    room = wanted.half_angle**2 - floor**2
    times = (angle**2 - floor**2) / room if room > 0 else 2.0
    # A little more than the forecast, so that it need not be made again; at most four times as
    # long as so far, because a forecast from little is a poor one.
    more = seconds * (np.clip(1.1 * times, 1.5, 5.0) - 1.0)
    more = max(more, wanted.first)
    return float(left if left - more < wanted.first else more)
