"""Band-limited Gaussian excitation of the joints.

Data flow: levels -> seat_drive -> signals.
"""

from loose_env.arms import CREST_FACTOR
from loose_env.excitation.levels import UNFELT_LEVER, Excitation, Shaping, all_at_levels, at_levels
from loose_env.excitation.seat_drive import SeatDrive, SeatReference
from loose_env.excitation.signals import torque_periods, torque_signals

__all__ = [
    "CREST_FACTOR",
    "UNFELT_LEVER",
    "Excitation",
    "SeatDrive",
    "SeatReference",
    "Shaping",
    "all_at_levels",
    "at_levels",
    "torque_periods",
    "torque_signals",
]
