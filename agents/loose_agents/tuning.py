"""Tuning of stopping thresholds, constant excitations and fixed sequences on training episodes.

An agent plays on without stopping. Its trail then says what every stopping probability would
have brought, since what it measures does not depend on when it would have stopped. So each
episode is played once, however many probabilities are weighed.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import loose_env
from loose_agents.base import Agent, EpisodeAgent, Problem
from loose_agents.belief import (
    ESTIMATORS,
    BeliefAgent,
    Policy,
    Sure,
    best_verdict,
    goes_on,
    make_estimator,
    setting_name,
    weights_path,
)
from loose_agents.evaluation import problem_of
from loose_agents.jobs import BackendSettings, Store, canonical, run_stored, spans
from loose_agents.policies.choice import POLICIES, ConstantPolicy, FixedPolicy, Records
from loose_agents.policies.oracle import oracle_agent
from loose_agents.registry import LEARNED, belief_agent, make_agent
from loose_env.envs import EpisodeBatch
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.evaluation import configuration_hash
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
    def joined(cls, parts: Sequence[dict[str, Any]]) -> Trails:
        """Concatenate the outcomes of several ranges of episodes."""
        return cls(**{name: np.concatenate([p[name] for p in parts]) for name in parts[0]})


def play_trails(
    agent: Agent,
    problem: Problem,
    *,
    episodes: int,
    seed: int,
    records: int,
    first: int = 0,
    width: int = 32,
) -> Trails:
    """Play episodes to the last record and store the outcome of each earlier stop."""
    most = problem.settings.max_records
    if episodes < 1 or not 1 <= records <= most:
        raise InvalidSetting(
            f"trails need 1 or more episodes of 1 to {most} records (the settings' max_records), "
            f"got {episodes} of {records}"
        )
    player = goes_on(agent, records)
    if isinstance(player, BeliefAgent):
        player.surprising = 0.0  # nor does a surprising episode end before the last record
    batch = EpisodeBatch(problem.arm, problem.settings, num=min(width, episodes), threads=1)
    stop = first + episodes
    parts = [
        _group(player, problem, batch, range(k, min(k + batch.num, stop)), seed, records)
        for k in range(first, stop, batch.num)
    ]
    return Trails.joined(parts)


def _group(
    agent: Any, problem: Problem, batch: EpisodeBatch, numbers: range, seed: int, records: int
) -> dict[str, Any]:
    """Play one batch of episodes, one per arm."""
    confidence = np.full((len(numbers), records), DIVERGED)
    reward = np.zeros((len(numbers), records))
    right = np.zeros((len(numbers), records), dtype=bool)
    price = np.zeros(len(numbers))
    states: list[Any] = [None] * len(numbers)
    for slot, number in enumerate(numbers):
        batch.start(slot, seed=seed, number=number)
        if hasattr(agent, "informed"):
            states[slot] = agent.informed(batch.episode(slot).fault, batch.observe(slot))
    going = list(range(len(numbers)))
    for taken in range(records + 1):
        if not going:
            break
        actions, after = agent.predict(
            np.stack([batch.observe(slot) for slot in going]),
            [states[slot] for slot in going],
            np.array([states[slot] is None for slot in going]),
            deterministic=True,
        )
        for slot, state in zip(going, after, strict=True):
            states[slot] = state
            if taken > 0:
                p = state.probabilities
                episode = batch.episode(slot)
                unsure = problem.actions.allows_unsure(episode.records, episode.measured)
                named = best_verdict(problem, p, unsure=unsure)
                truth = episode.fault.hypothesis
                worth = problem.settings.prices.verdict(named, truth)
                confidence[slot, taken - 1] = p.max()
                reward[slot, taken - 1 :] = worth - price[slot]
                right[slot, taken - 1 :] = named == truth
        if taken == records:
            break
        outcomes = batch.step(going, list(actions))
        for slot, outcome in zip(going, outcomes, strict=True):
            price[slot] -= outcome.reward
            reward[slot, taken:] = -price[slot]  # stays so where the simulation diverged
            right[slot, taken:] = False
        going = [slot for slot, o in zip(going, outcomes, strict=True) if not o.truncated]
    return {"confidence": confidence, "reward": reward, "right": right}


def best_threshold(
    trails: Trails, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> float:
    """Find the stopping probability with the highest mean return.

    The return is flat about its top and noisy, so its highest point on the episodes at hand is
    a matter of luck. Taken instead is the median of the highest points over bootstrap resamples
    of the episodes; where several thresholds share one, the middle of these. And of two that are
    worth the same the surer verdict is better: from there the threshold is raised as long as the
    mean return stays within `SLACK` of what it was.

    References
    ----------
    Breiman, Bagging Predictors, Machine Learning 24 (1996).

    Examples
    --------
    >>> sure = np.array([[0.6, 0.99], [0.95, 0.99], [0.97, 0.99]] * 30)
    >>> right = np.array([[False, True], [True, True], [True, True]] * 30)
    >>> reward = np.where(right, 1.0, -1.0) - [0.1, 0.2]
    >>> trails = Trails(confidence=sure, reward=reward, right=right)
    >>> 0.6 < best_threshold(trails, np.random.default_rng(0)) < 0.95
    True
    """
    returns = np.stack([trails.returns(t) for t in THRESHOLDS], axis=1)  # (E, T)
    count = len(trails)
    times = rng.multinomial(count, np.full(count, 1 / count), size=resamples)
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


def single_joints(problem: Problem, levels: Sequence[int] | None = None) -> list[tuple[int, ...]]:
    """Enumerate single-joint excitations at every level; 0 is off.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings
    >>> single_joints(Problem.of(planar(2), DiagnosisSettings()), [3])
    [(3, 0), (0, 3)]
    """
    n, top = problem.arm.n, len(problem.arm.levels)
    tried = range(top, 0, -1) if levels is None else levels
    if not len(tried) or not all(1 <= level <= top for level in tried):
        raise InvalidSetting(
            f"levels of arm {problem.arm.name!r} are 1 to {top}, got {list(tried)}"
        )
    return [
        tuple(level if k == joint else 0 for k in range(n)) for level in tried for joint in range(n)
    ]


def best_constant(
    candidates: Sequence[tuple[int, ...]],
    play: Callable[[tuple[int, ...], int], Trails],
    *,
    episodes: int,
) -> tuple[int, ...]:
    """Find the constant excitation with the highest return by successive halving.

    All candidates play a quarter of the episodes, the better half of them half of these, and so
    on; whoever is left plays all. Each is judged at the threshold that suits it best.
    """
    left = list(candidates)
    share = max(1, episodes // 4)
    while True:
        values = [_top_return(play(candidate, share)) for candidate in left]
        order = np.argsort(values, kind="stable")[::-1]
        if share == episodes or len(left) == 1:
            return left[int(order[0])]
        left = [left[int(k)] for k in order[: max(1, (len(left) + 1) // 2)]]
        share = min(2 * share, episodes)


def best_sequences(
    candidates: Sequence[Records],
    play: Callable[[Records, int], Trails],
    *,
    episodes: int,
    lengths: int,
) -> dict[str, Records]:
    """Choose fixed sequences by successive halving, as `best_constant` does.

    Those of the last round, four or fewer, give the best for each number of records without
    stopping, and the best with a stopping probability that suits it.
    """
    left, share = list(candidates), max(1, episodes // 4)
    found: dict[str, Records] = {}
    while True:
        trails = [play(candidate, share) for candidate in left]
        by_stop = np.array([_top_return(t) for t in trails])
        order = np.argsort(-by_stop, kind="stable")
        if share == episodes:
            break
        left = [left[int(k)] for k in order[: max(2, (len(left) + 3) // 4)]]
        share = min(2 * share, episodes)
    found["stopping"] = left[int(order[0])]
    for k in range(1, lengths + 1):
        best = int(np.argmax([t.reward[:, k - 1].mean() for t in trails]))
        found[str(k)] = left[best][:k]
    return found


def _top_return(trails: Trails) -> float:
    return max(float(trails.returns(threshold).mean()) for threshold in THRESHOLDS)


def write_tuned(
    path: Path,
    stop: Mapping[str, float],
    *,
    constant: Sequence[int] | None = None,
    information: Mapping[str, object] | None = None,
    fixed: Mapping[str, Records] | None = None,
) -> None:
    """Write tuned values into a settings file, keeping its other entries."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    known["stop"] = dict(sorted({**known.get("stop", {}), **stop}.items()))
    if constant is not None:
        known["constant"] = [int(level) for level in constant]
    if information is not None:
        known["information"] = dict(information)
    if fixed is not None:
        known["fixed"] = {name: [list(action) for action in own] for name, own in fixed.items()}
    write_text(path, json.dumps(known, indent=1, sort_keys=True) + "\n")


ORACLE = "oracle"
"""Stands for the estimator in the name of an oracle."""
_THREAD = threading.local()  # the agent already made, in each thread of a worker


@dataclass(frozen=True, kw_only=True)
class Player:
    """Serialisable description of an agent and the problem that it plays."""

    agent: str
    """Estimator and policy, or ``oracle/policy``."""
    levels: tuple[int, ...] | None = None
    """Levels of all joints, in place of those that the constant policy was tuned to."""
    sequence: tuple[tuple[int, ...], ...] | None = None
    """Records of the fixed policy, in place of those that it was tuned to."""
    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    seed: int
    """Seed of the episodes."""
    records: int
    """Records an episode."""
    agent_seed: int = 0
    """Seed of what the agent draws."""
    posterior: str
    """Digest of the trained posterior, see `trained`: it must not change while episodes are
    played."""


def names_of(agent: str) -> tuple[str, str]:
    """Estimator and policy of an agent; the name alone of a learned one.

    Examples
    --------
    >>> names_of("oracle/together")
    ('oracle', 'together')
    """
    if agent in LEARNED:
        return agent, ""
    estimator, _, policy = agent.partition("/")
    if estimator not in (*ESTIMATORS, ORACLE) or policy not in POLICIES:
        raise UnknownName(
            f"cannot tune {agent!r}: give an estimator of {[*ESTIMATORS, ORACLE]} and a policy of "
            f"{list(POLICIES)}, as in amortised/greedy, or one of {list(LEARNED)}"
        )
    return estimator, policy


def agent_of(player: Player, problem: Problem) -> EpisodeAgent:
    """Make the agent."""
    estimator, policy = names_of(player.agent)
    if estimator in LEARNED:
        learned: Any = make_agent(estimator, problem, seed=player.agent_seed)
        learned.stopping = Sure()
        stopped: EpisodeAgent = learned
        return stopped
    if estimator == ORACLE:
        return oracle_agent(problem, policy=policy, seed=player.agent_seed)
    if player.levels is None and player.sequence is None:
        return belief_agent(estimator, policy, problem, seed=player.agent_seed)
    made = make_estimator(estimator, problem)
    given: Policy
    if player.sequence is not None:
        given = FixedPolicy(problem, player.sequence)
    else:
        given = ConstantPolicy(problem, player.levels or ())
    return BeliefAgent(problem, made, given, Sure(), seed=player.agent_seed)


def trained(problem: Problem) -> str:
    """Digest of the trained posterior of an arm and difficulty, if there is one."""
    folder = weights_path(f"posterior-{setting_name(problem)}")
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


def play_player(
    player: Player,
    problem: Problem,
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
    kept = {**asdict(player), "settings": problem.settings, "version": loose_env.__version__}
    where = folder / configuration_hash(canonical(kept))[:16]
    store, parts = Store(where, kept, arrays=True), spans(episodes, shard)
    run_stored(partial(_play, player), parts, store, settings)
    return Trails.joined([store.read(part) for part in parts])


def _play(player: Player, span: range) -> dict[str, Any]:
    """Play the episodes of a shard; the agent is cached per thread."""
    made = _THREAD.__dict__
    if made.get("player") != player:
        problem = problem_of(player.env_id, player.arguments)
        if trained(problem) != player.posterior:
            raise InvalidData(
                f"the trained posterior of {setting_name(problem)} has changed since the tuning "
                "began: begin it again; episodes played with the other one are left alone"
            )
        made.update(problem=problem, agent=agent_of(player, problem), player=player)
    trails = play_trails(
        made["agent"],
        made["problem"],
        episodes=len(span),
        first=span.start,
        seed=player.seed,
        records=player.records,
    )
    return vars(trails)
