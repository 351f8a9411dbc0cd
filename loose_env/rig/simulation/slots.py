"""Base class of simulated rigs: arms in slots, measured singly or in batches."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.rig.jobs import Job
from loose_env.rig.measurement import Measurement
from loose_env.rig.plant import Plant
from loose_env.typing import Array

__all__ = ["SlotRig", "checked_slots", "checked_threads"]


def checked_slots(slots: int) -> int:
    """Return a number of arms, or raise `InvalidSetting`."""
    if isinstance(slots, bool) or not isinstance(slots, (int, np.integer)) or slots < 1:
        raise InvalidSetting(f"a rig needs at least one slot, got {slots!r}")
    return int(slots)


def checked_threads(threads: int) -> int:
    """Return a number of threads, 0 for all, or raise `InvalidSetting`."""
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 0:
        raise InvalidSetting(f"threads is a whole number, 0 for all, got {threads!r}")
    return threads


class SlotRig(ABC):
    """A rig with one true arm in each slot; subclasses say how several are measured."""

    plants: list[Plant]
    """The arm of every slot."""

    @property
    def slots(self) -> int:
        """Number of arms."""
        return len(self.plants)

    @abstractmethod
    def measure_each(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Measurement]]:
        """Take measurements; yield the index of each job with its measurement."""

    def measure(
        self,
        pose: Array,
        excitation: Excitation,
        *,
        rng: np.random.Generator | None = None,
        slot: int = 0,
    ) -> Measurement:
        """Measure one arm (the first seam: any rig answers this call)."""
        generator = np.random.default_rng(0) if rng is None else rng
        job = Job(
            slot=slot, pose=np.asarray(pose, dtype=float), excitation=excitation, rng=generator
        )
        return self.measure_many([job])[0]

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Take measurements on different slots at once; results in the order of the jobs.

        Raises
        ------
        InvalidSetting
            If a slot is named twice, or a pose or excitation does not fit the arm.
        """
        results = dict(self.measure_each(jobs))
        return [results[k] for k in range(len(jobs))]
