"""Rigs: where measurements come from."""

from loose_env.rig.measurement import Measurement, Rig
from loose_env.rig.simulated import Job, SimulatedRig

__all__ = ["Job", "Measurement", "Rig", "SimulatedRig"]
