"""Sharded computation of tuning outcomes, for any backend."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import loose_env
from loose_agents.benchmark.sharded import problem_of
from loose_agents.benchmark.tuning import Trails, play_trails
from loose_agents.core.base import EpisodeAgent, Problem
from loose_agents.core.belief_agent import BeliefAgent, Policy, Sure
from loose_agents.core.estimators import ESTIMATORS, make_estimator, setting_name, weights_path
from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.configuration_hash import configuration_hash
from loose_agents.execution.shard_store import ArrayCodec, ShardStore
from loose_agents.execution.shards import Shard, run_shards, shard_of
from loose_agents.policies.non_adaptive import FixedPolicy
from loose_agents.policies.oracle import oracle_agent
from loose_agents.policies.policies import POLICIES, ConstantPolicy
from loose_agents.registry import LEARNED, belief_agent, make_agent
from loose_agents.rl.learned_policy import LearnedAgent
from loose_env.errors import InvalidData, UnknownName

__all__ = ["ORACLE", "Player", "agent_of", "names_of", "play_player", "trained"]

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

    Raises
    ------
    UnknownName
        If there is no such estimator or policy.

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
        learned = make_agent(estimator, problem, seed=player.agent_seed)
        assert isinstance(learned, LearnedAgent)
        learned.stopping = Sure()
        return learned
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

    Parameters
    ----------
    player : Player
        Who plays.
    problem : Problem
        The problem of the player's environment.
    episodes : int
        Number of episodes.
    folder : Path
        Where shards lie.
    settings : BackendSettings, optional
        Where shards run.
    shard : int
        Episodes a shard; no trail depends on it.

    Raises
    ------
    ShardFailed
        If the trained posterior is not, or no longer, the player's.
    """
    kept = {**asdict(player), "settings": problem.settings, "version": loose_env.__version__}
    store = ShardStore(folder / configuration_hash(kept)[:16], kept, ArrayCodec())
    shards = shard_of(episodes, shard)
    run_shards(partial(_play, player), shards, store, settings=settings)
    return Trails.joined(list(store.read_all(shards)))


def _play(player: Player, shard: Shard) -> dict[str, Any]:
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
        episodes=len(shard),
        first=shard.start,
        seed=player.seed,
        records=player.records,
    )
    return vars(trails)
