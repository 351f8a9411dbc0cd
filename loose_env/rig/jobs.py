"""What a simulated rig is asked to do, and a chunk of it on its way through the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loose_env.excitation import Excitation
from loose_env.rig.engines import Engine

__all__ = ["Job", "Run"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One measurement to take."""

    slot: int
    """Which arm of the rig."""
    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What to play."""
    rng: np.random.Generator
    """Source of the excitation, the sensor noise and the seat's place in its gap."""


@dataclass(kw_only=True, eq=False)
class Run:
    """A chunk of jobs of one length and one model layout on its way through the engine."""

    jobs: Sequence[Job]
    engine: Engine
    """What simulates it."""
    control: Array
    """Commanded torques, gravity included (jobs, steps, n)."""
    delivered: Array
    """What the drives make of them (jobs, steps, n)."""
    recorded: Array
    """Sensor channels of every step (jobs, steps, channels)."""
    before: int
    """Steps of run-in."""
    count: int
    """Samples of the record."""
    failures: dict[int, str] = field(default_factory=dict)
