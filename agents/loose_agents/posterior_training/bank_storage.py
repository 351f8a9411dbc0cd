"""Storage of record banks: shards of records with their precomputed features.

Options of the scripts that build and use banks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import loose_env
from loose_agents.benchmark.sharded import problem_of
from loose_agents.core.base import Problem
from loose_agents.core.seeds import BANK_SEED, check_training_seed
from loose_agents.evaluation.env_arguments import arguments_of
from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.command import option
from loose_agents.execution.shard_store import ArrayCodec, ShardStore
from loose_agents.execution.shards import Shard, run_shards, shard_of
from loose_agents.posterior_training.record_bank import (
    BankSettings,
    RecordBank,
    RecordFeatures,
    features_of_bank,
    play_episodes,
)
from loose_env.diagnosis import LOCATION_FEATURES, RECORD_FEATURES, SeatFeatures
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.io import Count, NonNegativeCount

__all__ = [
    "BankOptions",
    "BankPlan",
    "build_bank",
    "build_features",
    "read_bank",
    "read_features",
    "seat_features",
]

SHARD = 500
"""Episodes in one file."""
HELD_OUT = 0.1
"""Share of a bank's episodes that training does not see."""


@dataclass(frozen=True, kw_only=True)
class BankOptions:
    """The bank."""

    env: str = option("loose_env/Planar-v0", "environment id")
    arguments: str = option(
        '{"engine": "reduced"}',
        "its arguments, as JSON; the engine that simulates among them",
    )
    episodes: Count = option(12_000, "episodes of the bank")
    seed: int = option(BANK_SEED, "seed of the episodes")
    directions: NonNegativeCount = option(0, "sliding directions of a link, 0: as fits the arm")
    out: str = option("banks/bank", "folder of the bank")

    @property
    def plan(self) -> BankPlan:
        """Description of the bank.

        Raises
        ------
        InvalidSetting
            If the arguments are no JSON object, there are no episodes, or the seed is kept for
            evaluation.
        """
        return BankPlan(
            env_id=self.env,
            arguments=arguments_of(self.arguments),
            episodes=self.episodes,
            seed=check_training_seed(self.seed),
            directions=self.directions,
        )


@dataclass(frozen=True, kw_only=True)
class BankPlan:
    """Serialisable description of a record bank."""

    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    episodes: int = 12_000
    """Number of episodes."""
    seed: int = BANK_SEED
    """Seed of the episodes."""
    records: BankSettings = field(default_factory=BankSettings)
    """Sampling of the records."""
    directions: int = 0
    """Sliding directions of a link for which features are computed; 0: 24 in the plane, 100 in
    space."""

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
    def shards(self) -> tuple[Shard, ...]:
        """Shards of the bank."""
        return shard_of(self.episodes, SHARD)

    @property
    def split(self) -> tuple[tuple[Shard, ...], tuple[Shard, ...]]:
        """Shards held out from training, `HELD_OUT` of them, and those to train on.

        Raises
        ------
        InvalidSetting
            If there are too few to hold some out.
        """
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


def build_bank(plan: BankPlan, folder: Path, settings: BackendSettings | None = None) -> ShardStore:
    """Simulate the missing shards of a bank."""
    store = ShardStore(folder / "records", plan.configuration, ArrayCodec())
    run_shards(partial(_bank_shard, plan), plan.shards, store, settings=settings)
    return store


def build_features(
    plan: BankPlan, folder: Path, settings: BackendSettings | None = None
) -> ShardStore:
    """Compute the missing features of a bank, which must exist."""
    configuration = plan.configuration | {
        "directions": directions_of(plan),
        "place": LOCATION_FEATURES,
        "record": RECORD_FEATURES,
    }
    store = ShardStore(folder / "figures", configuration, ArrayCodec())
    run_shards(partial(_features_shard, plan, folder), plan.shards, store, settings=settings)
    return store


def read_bank(plan: BankPlan, folder: Path, shards: tuple[Shard, ...] | None = None) -> RecordBank:
    """Read a bank, or a subset of its shards."""
    store = ShardStore(folder / "records", plan.configuration, ArrayCodec())
    chosen = plan.shards if shards is None else shards
    return RecordBank.joined([RecordBank(**part) for part in store.read_all(chosen)])


def read_features(store: ShardStore, shards: tuple[Shard, ...]) -> RecordFeatures:
    """Read the features of some shards."""
    return RecordFeatures.joined([RecordFeatures(**part) for part in store.read_all(shards)])


def directions_of(plan: BankPlan) -> int:
    """Sliding directions of a link for which features are computed."""
    return plan.directions or (24 if len(_problem(plan).arm.axes) == 2 else 100)


def seat_features(problem: Problem, directions: int) -> SeatFeatures:
    """Build the feature extractor of a problem's records."""
    return SeatFeatures(
        problem.linear,
        problem.settings.sensors,
        difficulty_named(problem.settings.difficulty).mismatch,
        directions=directions,
    )


_PROBLEMS: dict[str, Problem] = {}


def _problem(plan: BankPlan) -> Problem:
    key = f"{plan.env_id} {sorted(plan.arguments.items())}"
    if key not in _PROBLEMS:
        _PROBLEMS[key] = plan.problem()
    return _PROBLEMS[key]


def _bank_shard(plan: BankPlan, shard: Shard) -> dict[str, np.ndarray]:
    bank = play_episodes(
        _problem(plan), plan.records, seed=plan.seed, start=shard.start, stop=shard.stop
    )
    return vars(bank)


def _features_shard(plan: BankPlan, folder: Path, shard: Shard) -> dict[str, np.ndarray]:
    problem = _problem(plan)
    store = ShardStore(folder / "records", plan.configuration, ArrayCodec())
    features = _features(problem, directions_of(plan))
    return vars(features_of_bank(problem, features, RecordBank(**store.read(shard))))


@lru_cache(maxsize=1)
def _features(problem: Problem, directions: int) -> SeatFeatures:
    return seat_features(problem, directions)
