"""Faults of an arm, and their seats in a MuJoCo spec.

Data flow: kinds -> faults -> seat -> preload -> seating.
"""

from loose_env.faults.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    LooseFault,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    is_fault,
)
from loose_env.faults.kinds import (
    DEFAULT_KINDS,
    KINDS,
    SEVERAL_FAULTS,
    UNSURE,
    FaultKind,
    checked_kinds,
    hypotheses,
    place_of,
    places_of_kind,
)
from loose_env.faults.preload import preloaded, seat_weight
from loose_env.faults.seat import (
    SEAT,
    SeatKind,
    SinglePart,
    gaps_of,
    part_seats,
    parts_of,
    seat_names,
    seat_of,
    seats_of,
    twist_of,
)
from loose_env.faults.seating import SeatIndices, seat_indices, seated_spec, set_seat

__all__ = [
    "DEFAULT_KINDS",
    "KINDS",
    "SEAT",
    "SEVERAL_FAULTS",
    "UNSURE",
    "Backlash",
    "CompoundLooseness",
    "Fault",
    "FaultKind",
    "Healthy",
    "LooseFault",
    "Preload",
    "RotationalLooseness",
    "SeatIndices",
    "SeatKind",
    "SeveralFaults",
    "SinglePart",
    "StructuralLooseness",
    "checked_kinds",
    "gaps_of",
    "hypotheses",
    "is_fault",
    "part_seats",
    "parts_of",
    "place_of",
    "places_of_kind",
    "preloaded",
    "seat_indices",
    "seat_names",
    "seat_of",
    "seat_weight",
    "seated_spec",
    "seats_of",
    "set_seat",
    "twist_of",
]
