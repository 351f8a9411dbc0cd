"""Play one agent's episodes in stored shards, and bound the mean number of records from below.

The bounds of `loose_env.diagnosis.least_records` need the most that a record says and the most arms
that k records allow to get right. Neither is known. Both are taken from whoever plays:

- Information: for each player and each record, the mean rise of the log probability of the truth
  over the arms still measured; the largest, at the upper end of its interval.
- Success: the largest share of right best guesses after k records, at the upper end of its
  interval.

So the bound holds for whoever gets no more out of a record than the best player counted; a better
posterior or better records can beat it.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import loose_env
from loose_agents.base import Agent, Problem, hypothesis_prior
from loose_agents.evaluation import diagnosis_env, evaluate
from loose_agents.jobs import BackendSettings, ProgressLine, Store, canonical, run_stored, spans
from loose_agents.registry import content_of, make_agent
from loose_env.arms import Arm
from loose_env.diagnosis import least_records
from loose_env.envs import difficulty_named
from loose_env.evaluation import Row, by_agent, configuration_hash, standings, wilson
from loose_env.typing import Array
from loose_env.wrappers import PROBABILITY_FLOOR

_THREAD = threading.local()  # the agent already made, in each thread of a worker


@dataclass(frozen=True, kw_only=True)
class EvaluationTask:
    """Serialisable description of the episodes that one agent plays."""

    agent: str
    """Name of the agent, as `loose_agents.registry.make_agent` knows it."""
    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    count: int
    """Number of episodes, from number 0."""
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
        """Every setting that determines the rows."""
        named = asdict(self)
        for name in ("count", "width", "threads"):
            del named[name]
        content = content_of(self.agent)  # what it is made of counts, not its name alone
        return {**named, "version": loose_env.__version__, "content": content}

    def make(self, problem: Problem) -> Agent:
        """Make the agent."""
        return make_agent(self.agent, problem, seed=self.agent_seed)


def evaluate_shard(
    task: EvaluationTask, span: range, progress: Callable[[int], None] | None = None
) -> list[dict[str, Any]]:
    """Play some episodes of a task; return their rows as dictionaries, in order."""
    problem, agent, true_arm = _ready(task)
    rows = evaluate(
        agent,
        task.agent,
        problem.arm,
        problem.settings,
        episodes=len(span),
        first=span.start,
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
    """
    parts = spans(task.count, shard)
    where = folder / configuration_hash(canonical(task.configuration))[:16]
    gone = where.with_name(f"{where.name}.gone")
    shutil.rmtree(gone, ignore_errors=True)  # left by a run that was killed while it tidied up
    store = Store(where, task.configuration)
    if settings is None or (settings.backend == "loky" and settings.workers == 1):
        missing = store.missing(parts)
        with ProgressLine(task.count, done=task.count - sum(map(len, missing))) as line:
            for span in missing:
                store.write(span, evaluate_shard(task, span, lambda _: line.advance(1)))
    else:
        run_stored(partial(evaluate_shard, replace(task, threads=1)), parts, store, settings)
    rows = [row for part in parts for row in store.read(part)]
    if not keep:
        # Renamed first: half a folder of shards would be taken for somebody else's.
        where.rename(gone)
        shutil.rmtree(gone)
    return rows


def _ready(task: EvaluationTask) -> tuple[Problem, Agent, Arm]:
    """Problem, agent and true arm of a task, kept for its further shards in each thread."""
    made = _THREAD.__dict__
    key = replace(task, count=1, threads=1)
    if made.get("task") != key:
        env = diagnosis_env(task.env_id, task.arguments)
        problem = Problem.of(env.arm, env.settings)
        made.update(task=key, made=(problem, task.make(problem), env.batch.true_arm))
    found: tuple[Problem, Agent, Arm] = made["made"]
    return found


FEWEST = 30
"""Episodes that a mean is taken of, at least."""

_LEVEL = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordBound:
    """Lower bound on the mean number of records at one difficulty."""

    prior: Array
    """Probability of each hypothesis beforehand (K,)."""
    information: float
    """Most that a record says about the hypothesis, on average [nat]."""
    teller: str
    """Who took the record that says most."""
    record: int
    """Number of that record in its episode, from 1."""
    success: Array
    """Highest share of right verdicts after 1, 2, ... records."""

    def records(self, error: float) -> float:
        """Larger of the bounds by the information per record and by the success after k records."""
        found = least_records(error, self.prior, information=self.information)
        return float(max(found, least_records(error, self.prior, success=self.success)))


def record_bound(problem: Problem, rows: Sequence[Row]) -> RecordBound | None:
    """Compute the bound from episodes of one difficulty."""
    players = {
        name: (information_limits(problem, own), success_limits(own))
        for name, own in by_agent(rows).items()
    }
    return bound_of(_prior(problem, str(rows[0].get("difficulty", "own"))), players)


def bound_of(
    prior: Array, players: Mapping[str, tuple[Sequence[float], Sequence[float]]]
) -> RecordBound | None:
    """Compute the bound from each player's limits, `information_limits` and `success_limits`."""
    most: tuple[float, str, int] | None = None
    success: list[float] = []
    for name, (information, guesses) in players.items():
        for k, end in enumerate(information, 1):
            if most is None or end > most[0]:
                most = (end, name, k)
        for k, end in enumerate(guesses):
            success[k : k + 1] = [max(end, *success[k : k + 1])] if k < len(success) else [end]
    if most is None or most[0] <= 0:
        return None
    return RecordBound(
        prior=prior,
        information=most[0],
        teller=most[1],
        record=most[2],
        success=np.maximum.accumulate(success),
    )


def bound_line(problem: Problem, rows: Sequence[Row]) -> str:
    """Format the lower bounds at the error rate of the best agent by return."""
    best, bound = standings(rows)[0], record_bound(problem, rows)
    if bound is None:
        return (
            "Bound on records: 1; more cannot be said, for no agent here keeps probabilities on "
            f"{FEWEST} arms or more."
        )
    error = 1 - best.success
    by_information = float(least_records(error, bound.prior, information=bound.information))
    by_success = float(least_records(error, bound.prior, success=bound.success))
    return (
        f"Bound on records: {max(by_information, by_success):.2f} on average at the error of "
        f"{best.agent}, {100 * error:.1f} %, which took {best.records:.2f}. By information (Fano) "
        f"{by_information:.2f}, if no record says more than {bound.information:.2f} nat, the most "
        f"that one says to an agent here ({bound.teller}, record {bound.record}); by success "
        f"{by_success:.2f}, if k records allow no more right verdicts than the agents here "
        "reached. Both with the upper ends of 95 % intervals."
    )


def _prior(problem: Problem, level: str) -> Array:
    difficulty = difficulty_named(problem.settings.difficulty if level == "own" else level)
    return hypothesis_prior(problem.hypotheses, difficulty.probabilities(problem.settings.kinds))


def information_limits(problem: Problem, rows: Sequence[Row]) -> list[float]:
    """Upper 95 % limits of a player's mean gain in log score [nat], by record."""
    prior = _prior(problem, str(rows[0].get("difficulty", "own")))
    chance = dict(zip(problem.hypotheses, prior, strict=True))
    trails: list[list[float]] = []
    for row in rows:
        told: Sequence[Any] = row.get("trail_truth")  # type: ignore[assignment]
        if told is not None and len(told) and chance.get(row["truth"], 0.0) > 0:
            trails.append([chance[row["truth"]], *told])
    logs = [
        np.log(np.maximum(np.asarray(trail, dtype=float), PROBABILITY_FLOOR)) for trail in trails
    ]
    found = []
    for k in range(1, max(map(len, logs), default=0)):
        gains = np.array([log[k] - log[k - 1] for log in logs if len(log) > k])
        if len(gains) < FEWEST:  # fewer still go on after this
            break
        beyond = stats.norm.ppf(_LEVEL) * gains.std(ddof=1) / np.sqrt(len(gains))
        found.append(float(gains.mean() + beyond))
    return found


def success_limits(rows: Sequence[Row]) -> list[float]:
    """Upper 95 % limits of a player's best-guess accuracy after 1, 2, ... records.

    Who has stopped keeps the last guess.
    """
    trails = [(row["truth"], list(row.get("trail_best") or ())) for row in rows]
    trails = [trail for trail in trails if trail[1]]
    if len(trails) < FEWEST:
        return []
    longest = max(len(best) for _, best in trails)
    return [
        wilson(sum(best[min(k, len(best) - 1)] == truth for truth, best in trails), len(trails))[1]
        for k in range(longest)
    ]
