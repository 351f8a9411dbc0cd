"""Sharded evaluation: the same rows for any backend and number of workers."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import loose_env
from loose_agents.core.base import Agent, Problem
from loose_agents.evaluation.env_arguments import diagnosis_env
from loose_agents.evaluation.evaluate import evaluate
from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.configuration_hash import configuration_hash
from loose_agents.execution.progress import ProgressLine
from loose_agents.execution.shard_store import RowCodec, ShardStore
from loose_agents.execution.shards import Shard, run_shards, shard_of
from loose_agents.registry import content_of, make_agent
from loose_env.arms import Arm

__all__ = ["EvaluationTask", "evaluate_shard", "play_task", "problem_of"]

_THREAD = threading.local()  # agents and problems already made, in each thread of a worker


@dataclass(frozen=True, kw_only=True)
class EvaluationTask:
    """Serialisable description of the episodes that one agent plays."""

    agent: str
    """Name of the agent, as `loose_agents.registry.make_agent` knows it."""
    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    first: int = 0
    """First episode."""
    count: int
    """Number of episodes."""
    seed: int
    """Seed of the episodes."""
    agent_seed: int = 0
    """Seed of what the agent draws."""
    records: int | None = None
    """Records that the agent is made to take; None lets it stop."""
    width: int = 64
    """Arms side by side; no row depends on it."""
    threads: int = 1
    """Simulation threads; no row depends on it."""

    @property
    def configuration(self) -> dict[str, Any]:
        """Return every setting that determines the rows."""
        named = asdict(self)
        for name in ("width", "threads"):
            del named[name]
        content = content_of(self.agent)  # what it is made of counts, not its name alone
        return {**named, "version": loose_env.__version__, "content": content}


def problem_of(env_id: str, arguments: Mapping[str, Any]) -> Problem:
    """Return the problem that an environment poses, by constructing it once.

    Raises
    ------
    UnknownName, InvalidSetting, gymnasium.error.Error
        As `diagnosis_env` does.
    """
    env = diagnosis_env(env_id, arguments)
    return Problem.of(env.arm, env.settings)


def evaluate_shard(
    task: EvaluationTask, progress: Callable[[int], None] | None = None
) -> list[dict[str, Any]]:
    """Play the episodes of a task; return their rows as dictionaries, in order."""
    problem, agent, true_arm = _ready(task)
    rows = evaluate(
        agent,
        task.agent,
        problem.arm,
        problem.settings,
        episodes=task.count,
        first=task.first,
        seed=task.seed,
        records=task.records,
        width=task.width,
        threads=task.threads,
        true_arm=true_arm,
        progress=progress,
    )
    return [asdict(row) for row in rows]


def play_task(
    task: EvaluationTask,
    folder: Path,
    *,
    settings: BackendSettings | None = None,
    shard: int = 200,
    keep: bool = False,
) -> list[dict[str, Any]]:
    """Play a task in shards, resuming from the shards already stored.

    With one worker it is played in this process, ``task.width`` arms side by side.

    Parameters
    ----------
    task : EvaluationTask
        All episodes of one agent.
    folder : Path
        Where shards lie until the task is done; then they are removed, unless kept.
    settings : BackendSettings, optional
        Where shards run; in this process if None.
    shard : int
        Episodes a shard; no row depends on it.
    keep : bool
        Whether shards stay, so that a later call finds them.
    """
    shards = shard_of(task.count, shard)
    where = folder / configuration_hash(task.configuration)[:16]
    gone = where.with_name(f"{where.name}.gone")
    shutil.rmtree(gone, ignore_errors=True)  # left by a run that was killed while it tidied up
    store = ShardStore(where, task.configuration, RowCodec())
    if settings is None or (settings.backend == "loky" and settings.workers == 1):
        _play_here(task, shards, store)
    else:
        run_shards(partial(_part, replace(task, threads=1)), shards, store, settings=settings)
    rows = [row for part in store.read_all(shards) for row in part]
    if not keep:
        # Renamed first: half a folder of shards would be taken for somebody else's.
        where.rename(gone)
        shutil.rmtree(gone)
    return rows


def _part(task: EvaluationTask, shard: Shard) -> list[dict[str, Any]]:
    return evaluate_shard(replace(task, first=task.first + shard.start, count=len(shard)))


def _play_here(task: EvaluationTask, shards: Sequence[Shard], store: ShardStore) -> None:
    missing = store.missing(shards)
    with ProgressLine(task.count, done=task.count - sum(map(len, missing))) as line:
        for shard in missing:
            part = replace(task, first=task.first + shard.start, count=len(shard))
            store.write(shard, evaluate_shard(part, progress=lambda _: line.advance(1)))


def _ready(task: EvaluationTask) -> tuple[Problem, Agent, Arm]:
    """Problem, agent and true arm of a task, cached per thread."""
    made: dict[str, tuple[Problem, Agent, Arm]] = _THREAD.__dict__.setdefault("made", {})
    key = json.dumps([task.env_id, task.arguments, task.agent, task.agent_seed], sort_keys=True)
    if key not in made:
        env = diagnosis_env(task.env_id, task.arguments)
        problem = Problem.of(env.arm, env.settings)
        made.clear()  # one at a time: a task's shards follow each other
        agent = make_agent(task.agent, problem, seed=task.agent_seed)
        made[key] = problem, agent, env.batch.true_arm
    return made[key]
