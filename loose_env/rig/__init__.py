"""Rigs: sources of measurements, simulated or recorded."""

from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.reduced import ReducedRig
from loose_env.rig.simulated import (
    Job,
    Measurement,
    RecordedRig,
    Rig,
    SimulatedRig,
    decimation_filter,
    low_passed,
    read_accelerometer,
    read_encoder,
)

__all__ = [
    "Job",
    "Measurement",
    "Plant",
    "PlantShop",
    "RecordedRig",
    "ReducedRig",
    "Rig",
    "SimulatedRig",
    "decimation_filter",
    "low_passed",
    "read_accelerometer",
    "read_encoder",
]
