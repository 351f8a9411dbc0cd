"""What can be wrong with an arm, and how a fault is seated in a MuJoCo spec."""

from loose_env.faults.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    StructuralLooseness,
    is_fault,
)
from loose_env.faults.kinds import (
    DEFAULT_KINDS,
    KINDS,
    FaultKind,
    checked_kinds,
    hypotheses,
    place_of,
)
from loose_env.faults.seat import (
    SEAT,
    SeatKind,
    gaps_of,
    parts_of,
    seat_names,
    seat_of,
    seats_of,
    twist_of,
)
from loose_env.faults.seating import FASTEST_STOP, seated_spec, set_seat

__all__ = [
    "DEFAULT_KINDS",
    "FASTEST_STOP",
    "KINDS",
    "SEAT",
    "Backlash",
    "CompoundLooseness",
    "Fault",
    "FaultKind",
    "Healthy",
    "Preload",
    "RotationalLooseness",
    "SeatKind",
    "StructuralLooseness",
    "checked_kinds",
    "gaps_of",
    "hypotheses",
    "is_fault",
    "parts_of",
    "place_of",
    "seat_names",
    "seat_of",
    "seated_spec",
    "seats_of",
    "set_seat",
    "twist_of",
]
