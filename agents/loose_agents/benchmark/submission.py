"""Results files made by playing an agent, and checked by playing a sample again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

import loose_env
from loose_agents.benchmark.out_of_distribution import (
    UNLIKE,
    evaluate_kind,
    rig_for,
    settings_for,
)
from loose_agents.benchmark.results import OUTSIDE, Results, results_of
from loose_agents.benchmark.tasks import EpisodeSet, set_named, task_problem
from loose_agents.core.base import Agent, Problem
from loose_agents.execution.shard_store import RowCodec, ShardStore
from loose_agents.execution.shards import shard_of
from loose_agents.registry import content_of, make_agent
from loose_env.envs import EpisodeBatch
from loose_env.errors import InvalidAction, InvalidData, InvalidSetting

__all__ = ["check_results", "play_results"]

SHARD = 40
"""Episodes after which what was played is stored."""


def play_results(
    task: str,
    set_name: str,
    agent: str,
    *,
    told: dict[str, Any],
    folder: Path,
    count: int | None = None,
    agent_seed: int = 0,
    named: bool = True,
    say: Callable[[str], None] = lambda words: None,
) -> Results:
    """Play a set of episodes; episodes stored in the folder are not played again.

    Parameters
    ----------
    task, set_name : str
        What is played.
    agent : str
        Name for `loose_agents.registry.make_agent`.
    told : dict
        The entry's name, description and so on: fields of `Results`.
    folder : Path
        Where played episodes lie: the same call goes on from them.
    count : int, optional
        Play the first so many episodes; all by default.
    agent_seed : int
        Seed of what the agent draws.
    named : bool
        Whether the file names the agent, so that it can be played again elsewhere.
    say : callable
        Shows progress.

    Raises
    ------
    UnknownName, InvalidData
        If there is no such task, set or agent, or its weights are none.
    InvalidSetting
        If the set has not so many episodes.
    """
    episodes = set_named(set_name)
    played = episodes.episodes if count is None else count
    if not 1 <= played <= episodes.episodes:
        raise InvalidSetting(
            f"the set {set_name!r} has 1 to {episodes.episodes} episodes, got {played}"
        )
    problem = task_problem(task, episodes)
    player = make_agent(agent, problem, seed=agent_seed)
    kept = {
        "task": task, "set": asdict(episodes), "agent": agent, "agent_seed": agent_seed,
        "fingerprint": problem.fingerprint, "version": loose_env.__version__,
        "content": content_of(agent),
    }  # fmt: skip
    name = f"{task}-{set_name}-{agent}".replace("/", "_").replace(":", "_")
    store = ShardStore(folder / name, kept, RowCodec())
    shards = shard_of(played, SHARD)
    for shard in store.missing(shards):
        begin = time.process_time()
        rows = _play(player, agent, problem, episodes, range(shard.start, shard.stop))
        spent = (time.process_time() - begin) / len(rows)
        store.write(shard, [{**row, "cpu_seconds": spent} for row in rows])
        say(f"{task} {set_name} {agent}: {shard.stop} of {played} episodes")
    rows = [row for part in store.read_all(shards) for row in part]
    return results_of(
        rows,
        problem,
        cpu_seconds=sum(row["cpu_seconds"] for row in rows),
        task=task,
        set=set_name,
        agent=agent if named else None,
        agent_seed=agent_seed,
        versions={
            "loose_env": loose_env.__version__,
            "mujoco": mujoco.__version__,
            "numpy": np.__version__,
            "gymnasium": gymnasium.__version__,
        },
        **told,
    )


def check_results(
    results: Results,
    *,
    episodes: int,
    rng: np.random.Generator,
    by_agent: bool = True,
) -> str:
    """Play a sample of a file's episodes again and compare bit for bit.

    The recorded actions are played, and return, verdict, truth and number of records compared.
    Where the file names its agent, that plays too, and its actions and confidence are compared.

    Parameters
    ----------
    results : Results
        The file.
    episodes : int
        Episodes of the sample, at most those of the set.
    rng : numpy.random.Generator
        Draws the sample.
    by_agent : bool
        Whether the agent plays too.

    Returns
    -------
    str
        What was compared, in a sentence.

    Raises
    ------
    InvalidData
        If something differs, with the first episode that does.
    """
    problem = task_problem(results.task, results.episodes)
    if results.fingerprint != problem.fingerprint:
        raise InvalidData(
            f"fingerprint {results.fingerprint!r:.20} is not that of {results.task} here, "
            f"{problem.fingerprint!r}: the file was made by another version"
        )
    if results.verdicts != problem.verdicts:
        raise InvalidData(f"verdicts of {results.task} are {list(problem.verdicts)}")
    whole = len(results.reward)
    count = min(episodes, whole)
    numbers = sorted(rng.choice(whole, size=count, replace=False).tolist())
    _replay(results, problem, numbers)
    words = f"{count} of {whole} episodes replayed from their actions"
    if results.agent is None or not by_agent:
        return f"{words}; returns equal bit for bit"
    player = make_agent(results.agent, problem, seed=results.agent_seed)
    for number in numbers:
        row = _play(player, results.agent, problem, results.episodes, range(number, number + 1))[0]
        _same(number, "actions", results.actions[number], row["actions"])
        _same(number, "return", results.reward[number], row["reward"])
        told = None if row["confidence"] is None else round(row["confidence"], 5)
        _same(number, "confidence", results.confidence[number], told)
    return f"{words} and by the agent {results.agent!r}; returns equal bit for bit"


def _play(
    player: Agent, name: str, problem: Problem, episodes: EpisodeSet, numbers: range
) -> list[dict[str, Any]]:
    rows = evaluate_kind(
        player, name, problem, episodes.kind,
        episodes=len(numbers), first=numbers.start, seed=episodes.seed,
    )  # fmt: skip
    return [asdict(row) for row in rows]


def _replay(results: Results, problem: Problem, numbers: Sequence[int]) -> None:
    """Play recorded actions, all episodes side by side."""
    episodes = results.episodes
    batch = EpisodeBatch(
        problem.arm,
        settings_for(episodes.kind, problem),
        num=len(numbers),
        threads=1,
        rig=rig_for(episodes.kind, problem, len(numbers)),
    )
    options = UNLIKE[episodes.kind][1]
    actions = []
    for slot, number in enumerate(numbers):
        batch.start(slot, seed=episodes.seed, number=number, options=options)
        try:
            found = [batch.actions.from_code(code) for code in results.actions[number].split()]
        except InvalidAction as error:
            raise InvalidData(f"episode {number}: {error}") from error
        if not 0 < len(found) <= problem.settings.max_records + 1:
            raise InvalidData(
                f"episode {number}: 1 to {problem.settings.max_records + 1} actions, the last one "
                f"a verdict, are needed, got {len(found)}"
            )
        actions.append(found)
    prices = np.zeros(len(numbers))
    going = list(range(len(numbers)))
    for taken in range(max(map(len, actions))):
        slots = [slot for slot in going if taken < len(actions[slot])]
        for slot, outcome in zip(
            slots, batch.step(slots, [actions[slot][taken] for slot in slots]), strict=True
        ):
            number = numbers[slot]
            if not outcome.terminated:
                prices[slot] -= outcome.reward
            if not (outcome.terminated or outcome.truncated):
                continue
            going.remove(slot)
            ended = outcome.reward if outcome.terminated else 0.0
            info = outcome.info
            _same(number, "number of actions", len(actions[slot]), taken + 1)
            _same(number, "return", results.reward[number], float(ended - prices[slot]))
            _same(number, "records", results.records[number], info["records"])
            for name, told in (("truth", info["fault"]), ("verdict", info["verdict"])):
                here = problem.verdicts
                index = here.index(told) if told in here else OUTSIDE
                _same(number, name, getattr(results, name)[number], index)
    if going:
        raise InvalidData(f"episode {numbers[going[0]]}: its actions end without a verdict")


def _same(number: int, name: str, given: Any, found: Any) -> None:
    if given != found:
        raise InvalidData(f"episode {number}: the file says {name} {given!r}, replayed {found!r}")
