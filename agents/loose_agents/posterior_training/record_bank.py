"""Bank of simulated records: episodes of random actions shared by all agents.

What limits a learned diagnosis is the number of records it has seen. A bank holds, for each of
its episodes, the observation slots of a few records taken at random and the truth behind them.
Episodes are numbered; number k of a seed is the same wherever and whenever it is made.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.seeds import BANK_ACTIONS
from loose_env.diagnosis import LOCATION_FEATURES, RECORD_FEATURES, RecordStatistics, SeatFeatures
from loose_env.envs import EpisodeBatch, ObservationLayout
from loose_env.evaluation import drive_over_friction
from loose_env.faults import Fault, StructuralLooseness
from loose_env.typing import Array
from loose_env.wrappers import record_from

__all__ = ["BankSettings", "RecordBank", "RecordFeatures", "features_of_bank", "play_episodes"]


@dataclass(frozen=True, kw_only=True)
class BankSettings:
    """Sampling settings of the records of a bank."""

    records: int = 4
    """Records an episode."""
    long_every: int = 8
    """Every so manieth episode goes on to the most records the environment allows; 0: none."""
    alone: float = 0.4
    """Share of records that excite one joint; the others excite several."""
    together: float = 0.35
    """Share of records that excite all joints; the rest excite some at random."""
    levels: tuple[float, ...] = (0.1, 0.25, 0.65)
    """Shares of the levels, lowest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordBank:
    """Episodes of records with their ground truth; E episodes of up to R records."""

    slots: NDArray[np.float32]
    """Observation slots, zero where no record was taken (E, R, elements)."""
    truth: NDArray[np.int64]
    """Index of the true hypothesis (E,)."""
    direction: Array
    """Sliding direction in the frame of the loose link, zero for other faults (E, 3)."""
    gap: Array
    """Travel [m or rad], zero on healthy arms (E,)."""
    friction: Array
    """Guide friction [N or N·m], zero on healthy arms (E,)."""
    ratio: Array
    """Rms seat drive of the top level over friction [1], infinite on healthy arms (E,)."""

    def __len__(self) -> int:
        return len(self.truth)

    def records(self, layout: ObservationLayout) -> Iterator[list[RecordStatistics | None]]:
        """Iterate over the episodes: statistics of each record, None for an empty slot."""
        observation = np.zeros(layout.size, dtype=np.float32)
        slots, count = layout.slots_of(observation), self.slots.shape[1]
        for episode in self.slots:
            slots[:count] = episode
            yield [record_from(layout, observation, slot) for slot in range(count)]

    def part(self, chosen: Any) -> RecordBank:
        """Return a subset of the episodes."""
        return RecordBank(**{name: values[chosen] for name, values in vars(self).items()})

    @classmethod
    def joined(cls, parts: list[RecordBank]) -> RecordBank:
        """Concatenate banks of one problem."""
        most = max(part.slots.shape[1] for part in parts)

        def padded(values: NDArray[np.float32]) -> NDArray[np.float32]:
            return np.pad(values, ((0, 0), (0, most - values.shape[1]), (0, 0)))

        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in vars(parts[0])
            if name != "slots"
        }
        return cls(slots=np.concatenate([padded(part.slots) for part in parts]), **columns)


def play_episodes(
    problem: Problem, settings: BankSettings, *, seed: int, start: int, stop: int, width: int = 32
) -> RecordBank:
    """Simulate the episodes ``start`` to ``stop - 1`` of a seed.

    Parameters
    ----------
    problem : Problem
        Arm and rules; the engine of its settings simulates.
    settings : BankSettings
        Sampling of the records.
    seed : int
        Seed of the bank.
    start, stop : int
        Numbers of the episodes.
    width : int
        Arms side by side; it changes nothing in the result.
    """
    batch = EpisodeBatch(problem.arm, problem.settings, num=min(width, stop - start), threads=1)
    most = problem.settings.max_records
    longest = most if settings.long_every else settings.records
    count = stop - start
    slots = np.zeros((count, longest, len(problem.layout.slot_elements)), dtype=np.float32)
    faults: list[Fault] = []
    for first in range(start, stop, batch.num):
        numbers = range(first, min(first + batch.num, stop))
        draws = [np.random.default_rng(_stream(seed, number)) for number in numbers]
        for slot, number in enumerate(numbers):
            batch.start(slot, seed=seed, number=number)
        for taken in range(longest):
            going = [
                slot
                for slot, number in enumerate(numbers)
                if taken < _records(settings, number, most) and not batch.episode(slot).ended
            ]
            if not going:
                break
            batch.step(going, [_action(problem, batch, s, settings, draws[s]) for s in going])
        for slot, number in enumerate(numbers):
            slots[number - start] = batch.episode(slot).slots[:longest]
            faults.append(batch.episode(slot).fault)
    return RecordBank(
        slots=slots,
        truth=np.array([problem.hypotheses.index(f.hypothesis) for f in faults]),
        direction=np.array([_direction(f) for f in faults]),
        gap=np.array([getattr(f, "gap", 0.0) for f in faults]),
        friction=np.array([getattr(f, "friction", 0.0) for f in faults]),
        ratio=np.array([_ratio(batch, f) for f in faults]),
    )


def _ratio(batch: EpisodeBatch, fault: Fault) -> float:
    ratio = drive_over_friction(batch.sampler, fault)
    return np.inf if ratio is None else ratio


def _stream(seed: int, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(number, BANK_ACTIONS))


def _records(settings: BankSettings, number: int, most: int) -> int:
    long = settings.long_every and number % settings.long_every == 0
    return most if long else min(settings.records, most)


def _direction(fault: Fault) -> tuple[float, ...]:
    if not isinstance(fault, StructuralLooseness):
        return (0.0, 0.0, 0.0)
    length = float(np.linalg.norm(fault.direction))
    return tuple(float(x) / length for x in fault.direction)


def _action(
    problem: Problem,
    batch: EpisodeBatch,
    slot: int,
    settings: BankSettings,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Sample a record: random moves, excited joints and levels, and duration."""
    n = problem.arm.n
    allowed = problem.actions.allowed_moves(batch.episode(slot).pose)
    moves = np.array([rng.choice(np.flatnonzero(row)) for row in allowed])
    kind = rng.random()
    on = np.ones(n, dtype=bool)
    if kind < settings.alone:
        on = np.arange(n) == rng.integers(n)
    elif kind >= settings.alone + settings.together:
        on = rng.random(n) < 0.5
        on[rng.integers(n)] = True
    shares = np.resize(settings.levels, len(problem.arm.levels))
    level = 1 + rng.choice(len(shares), p=shares / shares.sum())
    duration = int(rng.integers(len(problem.settings.durations)))
    if rng.random() < 0.5:  # the longest is the one most often worth its price
        duration = int(np.argmax(problem.settings.durations))
    return problem.actions.encode(moves=moves, levels=level * on, duration=duration)


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordFeatures:
    """Features of N records of E episodes, grouped by episode."""

    place: NDArray[np.float16]
    """By place, `LOCATION_FEATURES` (N, P, C)."""
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
    def joined(cls, parts: list[RecordFeatures]) -> RecordFeatures:
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


def features_of_bank(problem: Problem, features: SeatFeatures, bank: RecordBank) -> RecordFeatures:
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
    taken = bank.slots[:, :, 0] > 0.5
    total = int(taken.sum())
    place = np.zeros((total, features.locations, len(LOCATION_FEATURES)), dtype=np.float16)
    record = np.zeros((total, len(RECORD_FEATURES)), dtype=np.float32)
    every = (found for episode in bank.records(problem.layout) for found in episode)
    for k, found in enumerate(found for found in every if found is not None):
        place[k], record[k] = features.of(found)
    return RecordFeatures(
        place=place,
        record=record,
        count=taken.sum(1),
        truth=bank.truth,
        direction=bank.direction.astype(np.float32),
        ratio=bank.ratio.astype(np.float32),
    )
