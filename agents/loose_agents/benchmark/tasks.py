"""Tasks of the benchmark, and the frozen sets of episodes that they are played on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from loose_agents.benchmark.out_of_distribution import UNLIKE, arguments_for
from loose_agents.benchmark.sharded import problem_of
from loose_agents.core.base import Problem
from loose_agents.core.seeds import BANK_SEED, BENCHMARK_SEED, TUNING_SEED
from loose_env.errors import UnknownName
from loose_env.registration import TIERS

__all__ = ["ENGINE", "SETS", "TASKS", "TRAINING_SEEDS", "EpisodeSet", "set_named", "task_problem"]

TASKS = (*TIERS, "loose_env/Planar-v0", "loose_env/SixAxis-v0")
"""Ids of the tasks, each with its version. The control tier is ``loose_env/Vera-v0`` as it is."""

ENGINE = "reduced"
"""Simulation engine of the episodes; two faults at once need MuJoCo."""

TRAINING_SEEDS = (BANK_SEED, TUNING_SEED)
"""Seeds of the frozen training set and of the frozen set for tuning."""


@dataclass(frozen=True, kw_only=True)
class EpisodeSet:
    """Frozen episodes: seed and number fix all that is hidden in each."""

    kind: str
    """Kind of the episodes, of `loose_agents.benchmark.out_of_distribution.UNLIKE`."""
    words: str
    """What they are."""
    seed: int
    """Their seed."""
    episodes: int
    """How many, from number 0."""


SETS: Mapping[str, EpisodeSet] = MappingProxyType(
    {
        "test": EpisodeSet(kind="trained", words="as trained", seed=BENCHMARK_SEED, episodes=320),
        **{
            kind: EpisodeSet(kind=kind, words=words, seed=BENCHMARK_SEED + 1, episodes=80)
            for kind, (words, _) in UNLIKE.items()
            if kind != "trained"
        },
    }
)
"""Sets by name: "test", then those out of distribution."""


def set_named(name: str) -> EpisodeSet:
    """Look up a set.

    Raises
    ------
    UnknownName
        If there is none of that name.

    Examples
    --------
    >>> set_named("test").episodes
    320
    """
    if name not in SETS:
        raise UnknownName(f"unknown set {name!r}; sets are {list(SETS)}")
    return SETS[name]


def task_problem(task: str, episodes: EpisodeSet) -> Problem:
    """The problem of a task, with the engine that a set needs.

    Raises
    ------
    UnknownName
        If it is no task of the benchmark.
    """
    if task not in TASKS:
        raise UnknownName(f"unknown task {task!r}; tasks are {list(TASKS)}")
    return problem_of(task, arguments_for(episodes.kind, {"engine": ENGINE}))
