"""Rigs: sources of measurements, simulated or recorded."""

from loose_env.rig.measurement import Job, Measurement, RecordedRig, Rig
from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.reduced import ReducedRig
from loose_env.rig.simulated import SimulatedRig

__all__ = [
    "Job",
    "Measurement",
    "Plant",
    "PlantShop",
    "RecordedRig",
    "ReducedRig",
    "Rig",
    "SimulatedRig",
]
