"""Rigs: sources of measurements, simulated or recorded.

Data flow: jobs -> measurement -> plant -> recorded -> simulation -> reduced -> simulated.
"""

from loose_env.rig.jobs import (
    Job,
    Run,
)
from loose_env.rig.measurement import (
    Measurement,
    Rig,
)
from loose_env.rig.plant import (
    PlantShop,
)
from loose_env.rig.reduced import (
    ReducedRig,
)
from loose_env.rig.simulated import (
    SimulatedRig,
)

__all__ = [
    "Job",
    "Measurement",
    "PlantShop",
    "ReducedRig",
    "Rig",
    "Run",
    "SimulatedRig",
]
