"""Rigs: sources of measurements, simulated or recorded."""

from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.records import Measurement, Records, Trials
from loose_env.rig.reduced import ReducedRig
from loose_env.rig.simulated import (
    SimulatedRig,
    SlotRig,
    decimation_filter,
    low_passed,
    read_accelerometer,
    read_encoder,
)

__all__ = [
    "Measurement",
    "Plant",
    "PlantShop",
    "Records",
    "ReducedRig",
    "SimulatedRig",
    "SlotRig",
    "Trials",
    "decimation_filter",
    "low_passed",
    "read_accelerometer",
    "read_encoder",
]
