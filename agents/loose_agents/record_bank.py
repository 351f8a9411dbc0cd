"""Banks of simulated records and their features: random episodes with ground truth, in shards.

What limits a learned diagnosis is the number of records it has seen. A bank holds, for each of its
episodes, the observation slots of a few records taken at random and what was hidden. Episode k of a
seed is the same wherever and whenever it is made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import loose_env
from loose_agents.base import BANK_ACTIONS, BANK_SEED, Problem, check_training_seed
from loose_agents.evaluation import arguments_of, problem_of
from loose_agents.jobs import BackendSettings, Store, run_stored, spans
from loose_env.diagnosis import LOCATION_FEATURES, RECORD_FEATURES, RecordStatistics, SeatFeatures
from loose_env.envs import EnvBatch, ObservationLayout, difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.evaluation import drive_over_friction
from loose_env.faults import Fault, StructuralLooseness
from loose_env.io import Count, NonNegativeCount
from loose_env.typing import Array
from loose_env.wrappers import record_from


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


def play_episodes(
    problem: Problem, settings: BankSettings, *, seed: int, start: int, stop: int, width: int = 32
) -> RecordBank:
    """Simulate the episodes ``start`` to ``stop - 1`` of a seed."""
    batch = EnvBatch(problem.arm, problem.settings, num=min(width, stop - start), threads=1)
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
        ratio=np.array([_ratio(batch, f) for f in faults]),
    )


def _ratio(batch: EnvBatch, fault: Fault) -> float:
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
    batch: EnvBatch,
    slot: int,
    settings: BankSettings,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Sample a record: random moves, excited joints and levels, and duration."""
    n = problem.arm.n
    moves = problem.random_moves(batch.episode(slot).pose, rng)
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

    def rows(self, episodes: NDArray[np.intp], records: int) -> NDArray[np.intp]:
        """Indices of the first records of episodes (episodes * records,)."""
        first = (np.cumsum(self.count) - self.count)[episodes]
        return np.asarray((first[:, None] + np.arange(records)).ravel())


def features_of_bank(problem: Problem, features: SeatFeatures, bank: RecordBank) -> RecordFeatures:
    """Compute the features of all records of a bank."""
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


SHARD = 500
"""Episodes in one file."""
HELD_OUT = 0.1
"""Share of a bank's episodes that training does not see."""


@dataclass(frozen=True, kw_only=True)
class BankOptions:
    """The bank."""

    env: str = "loose_env/Planar-v0"
    """Environment id."""
    arguments: str = '{"engine": "reduced"}'
    """Its arguments, as JSON; the engine that simulates among them."""
    episodes: Count = 12_000
    """Episodes of the bank."""
    seed: int = BANK_SEED
    """Seed of the episodes."""
    directions: NonNegativeCount = 0
    """Sliding directions of a link, 0: as fits the arm."""
    out: str = "banks/bank"
    """Folder of the bank."""

    @property
    def plan(self) -> BankPlan:
        """Description of the bank."""
        arguments = arguments_of(self.arguments)
        axes = len(problem_of(self.env, arguments).arm.axes)
        return BankPlan(
            env_id=self.env,
            arguments=arguments,
            episodes=self.episodes,
            seed=check_training_seed(self.seed),
            directions=self.directions or (24 if axes == 2 else 100),
        )


@dataclass(frozen=True, kw_only=True)
class BankPlan:
    """Serialisable description of a record bank."""

    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    episodes: int
    """Number of episodes."""
    seed: int = BANK_SEED
    """Seed of the episodes."""
    records: BankSettings = field(default_factory=BankSettings)
    """Sampling of the records."""
    directions: int
    """Sliding directions of a link for which features are computed."""

    @property
    def configuration(self) -> dict[str, Any]:
        """Return every setting that determines one episode of the bank."""
        return {
            "env": self.env_id,
            "arguments": dict(self.arguments),
            "seed": self.seed,
            "records": self.records,
            "version": loose_env.__version__,
        }

    @property
    def shards(self) -> list[range]:
        """Shards of the bank."""
        return spans(self.episodes, SHARD)

    @property
    def split(self) -> tuple[list[range], list[range]]:
        """Shards held out from training, `HELD_OUT` of them, and those to train on."""
        held = max(1, round(HELD_OUT * len(self.shards)))
        if len(self.shards) <= held:
            raise InvalidSetting(
                f"a bank of {self.episodes} episodes is too small to hold some out; take at least "
                f"{2 * SHARD}"
            )
        return self.shards[:held], self.shards[held:]

    def problem(self) -> Problem:
        """Build the problem."""
        return problem_of(self.env_id, self.arguments)


def build_bank(plan: BankPlan, folder: Path, settings: BackendSettings | None = None) -> Store:
    """Simulate the missing shards of a bank."""
    store = Store(folder / "records", plan.configuration, arrays=True)
    run_stored(partial(_bank_shard, plan), plan.shards, store, settings)
    return store


def build_features(plan: BankPlan, folder: Path, settings: BackendSettings | None = None) -> Store:
    """Compute the missing features of a bank, which must exist."""
    configuration = plan.configuration | {
        "directions": plan.directions,
        "place": LOCATION_FEATURES,
        "record": RECORD_FEATURES,
    }
    store = Store(folder / "figures", configuration, arrays=True)
    run_stored(partial(_features_shard, plan, folder), plan.shards, store, settings)
    return store


def read_bank(plan: BankPlan, folder: Path, shards: list[range] | None = None) -> RecordBank:
    """Read a bank, or a subset of its shards."""
    store = Store(folder / "records", plan.configuration, arrays=True)
    chosen = plan.shards if shards is None else shards
    return RecordBank(**_joined(RecordBank, [store.read(span) for span in chosen]))


def read_features(store: Store, shards: list[range]) -> RecordFeatures:
    """Read the features of some shards."""
    return RecordFeatures(**_joined(RecordFeatures, [store.read(span) for span in shards]))


def _joined(kind: type[Any], parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Arrays of several shards, one after the other."""
    return {f.name: np.concatenate([part[f.name] for part in parts]) for f in fields(kind)}


def seat_features(problem: Problem, directions: int) -> SeatFeatures:
    """Build the feature extractor of a problem's records."""
    return SeatFeatures(
        problem.linear,
        problem.settings.sensors,
        difficulty_named(problem.settings.difficulty).mismatch,
        directions=directions,
    )


_MADE: dict[str, Any] = {}  # in each worker: problem and features of the bank at hand


def _problem(plan: BankPlan) -> Problem:
    if _MADE.get("plan") != plan:
        _MADE.clear()
        _MADE.update(plan=plan, problem=plan.problem())
    found: Problem = _MADE["problem"]
    return found


def _bank_shard(plan: BankPlan, span: range) -> dict[str, np.ndarray]:
    bank = play_episodes(
        _problem(plan), plan.records, seed=plan.seed, start=span.start, stop=span.stop
    )
    return vars(bank)


def _features_shard(plan: BankPlan, folder: Path, span: range) -> dict[str, np.ndarray]:
    problem = _problem(plan)
    if "features" not in _MADE:
        _MADE["features"] = seat_features(problem, plan.directions)
    bank = read_bank(plan, folder, [span])
    return vars(features_of_bank(problem, _MADE["features"], bank))
