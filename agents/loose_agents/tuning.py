"""Tuning of stopping thresholds, constant excitations and fixed sequences on training episodes.

An agent plays on without stopping. Its trail then says what every stopping probability would
have brought, since what it measures does not depend on when it would have stopped. So each
episode is played once, however many probabilities are weighed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import Agent, Problem
from loose_agents.belief import ESTIMATORS, BeliefAgent, Policy, Sure, make_estimator
from loose_agents.jobs import BackendSettings
from loose_agents.policies.choice import POLICIES, ConstantPolicy, FixedPolicy, Records
from loose_agents.registry import LEARNED
from loose_agents.sharded_play import EvaluationTask, play_task
from loose_agents.stored import setting_name, tuning_name, weights_path
from loose_env.envs import Prices
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.io import write_text
from loose_env.typing import Array

THRESHOLDS = 1 / (1 + np.exp(-np.arange(0.0, 7.65, 0.1)))
"""Stopping probabilities that are weighed, 0.5 to 0.9995, even in log-odds."""

SLACK = 0.005
"""Difference in mean return that is taken for none: a tenth of a record's price."""
RESAMPLES = 500
DIVERGED = np.inf  # the confidence at which every agent stops


@dataclass(frozen=True, kw_only=True, eq=False)
class Trails:
    """Outcomes of E episodes had the agent stopped after each of K records.

    Where the simulation diverged, the episode ends at that record whatever the threshold; the
    entries after it repeat.
    """

    confidence: Array
    """Probability of the most probable hypothesis (E, K)."""
    reward: Array
    """Return, the records' price subtracted (E, K)."""
    right: NDArray[np.bool_]
    """Correctness of the verdict (E, K)."""

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.confidence)

    def ends(self, threshold: float) -> NDArray[np.intp]:
        """Index of the record after which each episode ends (E,)."""
        sure = self.confidence >= threshold
        return np.where(sure.any(1), sure.argmax(1), self.confidence.shape[1] - 1)  # type: ignore[no-any-return]

    def returns(self, threshold: float) -> Array:
        """Return of each episode (E,)."""
        return np.asarray(self.reward[np.arange(len(self)), self.ends(threshold)])

    def success(self, threshold: float) -> NDArray[np.bool_]:
        """Correctness of each episode's verdict (E,)."""
        return np.asarray(self.right[np.arange(len(self)), self.ends(threshold)])

    def part(self, chosen: Any) -> Trails:
        """Return a subset of the episodes."""
        return Trails(**{name: values[chosen] for name, values in vars(self).items()})

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]], prices: Prices, records: int) -> Trails:
        """Outcomes of played episodes of so many records, fewer where the simulation diverged."""
        shape = (len(rows), records)
        confidence, right = np.full(shape, DIVERGED), np.zeros(shape, dtype=bool)
        reward = np.array([[-row["price"]] * records for row in rows], dtype=float)
        for k, row in enumerate(rows):
            named = row["trail_verdict"]
            worth = [prices.verdict(name, row["truth"]) for name in named]
            confidence[k, : len(named)] = row["trail_confidence"]
            reward[k, : len(named)] = np.subtract(worth, row["trail_price"])
            right[k, : len(named)] = [name == row["truth"] for name in named]
        return cls(confidence=confidence, reward=reward, right=right)


def best_threshold(trails: Trails, rng: np.random.Generator) -> float:
    """Find the stopping probability with the highest mean return.

    The return is flat about its top and noisy, so its highest point on the episodes at hand is
    a matter of luck. Taken instead is the median of the highest points over bootstrap resamples
    of the episodes; where several thresholds share one, the middle of these. And of two that are
    worth the same the surer verdict is better: from there the threshold is raised as long as the
    mean return stays within `SLACK` of what it was.

    References
    ----------
    Breiman, Bagging Predictors, Machine Learning 24 (1996).
    """
    returns = np.stack([trails.returns(t) for t in THRESHOLDS], axis=1)  # (E, T)
    count = len(trails)
    times = rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES)
    means = times @ returns / count
    top = means >= means.max(1, keepdims=True) - 1e-9
    last = len(THRESHOLDS) - 1 - top[:, ::-1].argmax(1)
    middle = int(np.median(top.argmax(1) + last)) // 2
    mean = returns.mean(0)
    equal = np.flatnonzero(mean >= mean[middle] - SLACK)
    return round(float(THRESHOLDS[max(middle, int(equal.max()))]), 4)


def unseen_return(trails: Trails, rng: np.random.Generator) -> float:
    """Cross-validated mean return: each half at the other half's threshold."""
    half = np.arange(len(trails)) % 2 == 0
    if half.all():
        raise InvalidSetting("two halves need two episodes or more, got 1")
    found = [
        trails.part(own).returns(best_threshold(trails.part(~own), rng)) for own in (half, ~half)
    ]
    return float(np.mean(np.concatenate(found)))


def single_joints(problem: Problem) -> list[tuple[int, ...]]:
    """Enumerate single-joint excitations, the highest level first; 0 is off."""
    alone = np.eye(problem.arm.n, dtype=int)
    levels = range(len(problem.arm.levels), 0, -1)
    return [tuple((level * one).tolist()) for level in levels for one in alone]


T = TypeVar("T")


def halved(
    candidates: Sequence[T],
    play: Callable[[T, int], Trails],
    *,
    episodes: int,
    keep: int,
    least: int,
) -> tuple[list[T], list[Trails]]:
    """Candidates of the last round of successive halving, best first, and their trails.

    All play a quarter of the episodes, the best ``1 / keep`` of them, ``least`` or more, half of
    these, and so on; those who are left play all. Each counts at the threshold that suits it best.
    """
    left, share = list(candidates), max(1, episodes // 4)
    while True:
        trails = [play(candidate, share) for candidate in left]
        values = [max(t.returns(threshold).mean() for threshold in THRESHOLDS) for t in trails]
        order = [int(k) for k in np.argsort(np.negative(values), kind="stable")]
        if share == episodes or len(left) == 1:
            return [left[k] for k in order], [trails[k] for k in order]
        left = [left[k] for k in order[: max(least, -(-len(left) // keep))]]
        share = min(2 * share, episodes)


def best_sequences(
    candidates: Sequence[Records],
    play: Callable[[Records, int], Trails],
    *,
    episodes: int,
    lengths: int,
) -> dict[str, Records]:
    """Find the best sequence with stopping, and the best of each number of records without."""
    left, trails = halved(candidates, play, episodes=episodes, keep=4, least=2)
    found = {"stopping": left[0]}
    for k in range(1, lengths + 1):
        best = int(np.argmax([t.reward[:, k - 1].mean() for t in trails]))
        found[str(k)] = left[best][:k]
    return found


def write_tuned(
    path: Path,
    stop: Mapping[str, float],
    *,
    constant: Sequence[int] | None = None,
    fixed: Mapping[str, Records] | None = None,
) -> None:
    """Write tuned values into a settings file, keeping its other entries."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    known["stop"] = dict(sorted({**known.get("stop", {}), **stop}.items()))
    if constant is not None:
        known["constant"] = [int(level) for level in constant]
    if fixed is not None:
        known["fixed"] = {name: [list(action) for action in own] for name, own in fixed.items()}
    write_text(path, json.dumps(known, indent=1, sort_keys=True) + "\n")


@dataclass(frozen=True, kw_only=True)
class Player(EvaluationTask):
    """Serialisable description of an agent that plays on, however sure it is."""

    levels: tuple[int, ...] | None = None
    """Levels of all joints, in place of those that the constant policy was tuned to."""
    sequence: tuple[tuple[int, ...], ...] | None = None
    """Records of the fixed policy, in place of those that it was tuned to."""
    count: int = 1
    posterior: str
    """Digest of the trained posterior, see `trained`: it must not change while episodes are
    played."""

    @property
    def configuration(self) -> dict[str, Any]:
        """Every setting that determines the rows; tuned settings, which tuning writes, do not."""
        found = super().configuration
        del found["content"]
        return found

    def make(self, problem: Problem) -> Agent:
        """Make the agent; not even a surprising episode ends before the last record."""
        if trained(problem) != self.posterior:
            raise InvalidData(
                f"the trained posterior of {setting_name(problem)} has changed since the tuning "
                "began: begin it again; episodes played with the other one are left alone"
            )
        if self.levels is None and self.sequence is None:
            agent = super().make(problem)
        else:
            given: Policy
            if self.sequence is not None:
                given = FixedPolicy(problem, self.sequence)
            else:
                given = ConstantPolicy(problem, self.levels or ())
            made = make_estimator(names_of(self.agent)[0], problem)
            agent = BeliefAgent(problem, made, given, Sure(), seed=self.agent_seed)
        if isinstance(agent, BeliefAgent):
            agent.surprising = 0.0
        return agent


def names_of(agent: str) -> tuple[str, str]:
    """Estimator and policy of an agent; the name alone of a learned one."""
    if agent in LEARNED:
        return agent, ""
    estimator, _, policy = agent.partition("/")
    if estimator not in ESTIMATORS or policy not in POLICIES:
        raise UnknownName(
            f"cannot tune {agent!r}: give an estimator of {list(ESTIMATORS)} and a policy of "
            f"{list(POLICIES)}, as in amortised/greedy, or one of {list(LEARNED)}"
        )
    return estimator, policy


def trained(problem: Problem) -> str:
    """Digest of the trained posteriors of a task, if there are any."""
    names = (f"posterior-{setting_name(problem)}", f"foresight-{tuning_name(problem)}")
    files = [file for name in names for file in sorted(weights_path(name).glob("*"))]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


def play_player(
    player: Player,
    prices: Prices,
    *,
    episodes: int,
    folder: Path,
    settings: BackendSettings | None = None,
    shard: int = 100,
) -> Trails:
    """Play the first episodes of a player's seed in shards.

    What lies in the folder is not played again, be it from an interrupted call or from one for
    fewer episodes.
    """
    task = replace(player, count=episodes)
    rows = play_task(task, folder, settings=settings, shard=shard, keep=True)
    return Trails.of(rows, prices, player.records or 0)
