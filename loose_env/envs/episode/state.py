"""Episodes: the rules of the diagnosis, for any number of arms at once.

The single and the vector environment are thin shells around `EpisodeBatch`, so that both
give the same episode bit for bit. Every random draw comes from a stream of its own, keyed by
(seed, episode, stream, record): what an agent does, how many arms run beside it and what ran
before change nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.faults import Fault
from loose_env.rig import Measurement
from loose_env.typing import Array

__all__ = ["Episode", "Outcome"]


@dataclass(kw_only=True, eq=False)
class Episode:
    """The state of one episode."""

    seed: int
    number: int
    fault: Fault
    pose: Array
    slots: NDArray[np.float32]
    steps: int = 0
    records: int = 0
    seconds: float = 0.0
    levels: int = 0
    visited: set[bytes] = field(default_factory=set)
    last: Measurement | None = None
    ended: bool = False
    verdict: str | None = None

    def stream(self, kind: int, index: int = 0) -> np.random.Generator:
        """Return the generator of one kind of draw."""
        key = (self.number, kind, index)
        return np.random.Generator(
            np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=key))
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one step gave."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
