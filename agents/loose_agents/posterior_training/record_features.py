"""Features of every record of a bank, precomputed for training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_tracker import record_from
from loose_agents.posterior_training.simulated_records import RecordBank
from loose_env.diagnosis import PLACE_FEATURES, RECORD_FEATURES, SeatFeatures

__all__ = ["PlaceFigures", "figures_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceFigures:
    """Features of N records of E episodes, grouped by episode."""

    place: NDArray[np.float16]
    """By place, `PLACE_FEATURES` (N, P, C)."""
    record: NDArray[np.float32]
    """Of the record, `RECORD_FEATURES` (N, Q)."""
    count: NDArray[np.int64]
    """Records of each episode (E,)."""
    truth: NDArray[np.int64]
    """Index of the true hypothesis: healthy, slides, plays (E,)."""
    direction: NDArray[np.float32]
    """Sliding direction, zero for other faults (E, 3)."""
    ratio: NDArray[np.float32]
    """Drive of the top level over friction; infinite on healthy arms (E,)."""

    @classmethod
    def joined(cls, parts: list[PlaceFigures]) -> PlaceFigures:
        """Concatenate the features of several shards."""
        return cls(
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in vars(parts[0])
            }
        )

    @property
    def first(self) -> NDArray[np.int64]:
        """Index of the first record of each episode (E,)."""
        return np.asarray(np.cumsum(self.count) - self.count)


def figures_of(problem: Problem, features: SeatFeatures, bank: RecordBank) -> PlaceFigures:
    """Compute the features of all records of a bank.

    Parameters
    ----------
    problem : Problem
        Arm and rules of the bank.
    features : SeatFeatures
        What works them out.
    bank : RecordBank
        The episodes.
    """
    layout = problem.layout
    taken = bank.slots[:, :, 0] > 0.5
    total = int(taken.sum())
    place = np.zeros((total, features.places, len(PLACE_FEATURES)), dtype=np.float16)
    record = np.zeros((total, len(RECORD_FEATURES)), dtype=np.float32)
    observation = np.zeros(layout.size, dtype=np.float32)
    slots = layout.slots_of(observation)
    k = 0
    for episode in range(len(bank)):
        slots[: bank.slots.shape[1]] = bank.slots[episode]
        for slot in np.flatnonzero(taken[episode]):
            found = record_from(layout, observation, int(slot))
            assert found is not None
            place[k], record[k] = features.of(found)
            k += 1
    return PlaceFigures(
        place=place,
        record=record,
        count=taken.sum(1),
        truth=bank.truth,
        direction=bank.direction.astype(np.float32),
        ratio=bank.ratio.astype(np.float32),
    )
