"""Speed of environments, wrappers and policies beside a C loop of `mj_step`, in one run.

Usage: python scripts/dev/benchmark.py [--arms 1 64 256] [--episodes 2] [--ids ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import quiet
from loose_env.cli.command import command
from loose_env.io import Count
from loose_env.rig import SimulatedRig
from loose_env.wrappers import vector

_RECORDS = 5
"""Records of an episode; every action takes one."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the timing."""

    ids: tuple[str, ...] = (
        "loose_env/Planar-v0",
        "loose_env/WeakDriveTier-v1",
        "loose_env/Vera-v0",
    )
    """Environments to time."""
    arms: tuple[int, ...] = (1, 64, 256)
    """Sizes of the batch."""
    episodes: Count = 2
    """Timed rounds of 5 records on all arms; small batches play more."""
    agents: tuple[str, ...] = ("greedy", "open_loop", "look_ahead", "random")
    """Agents to time, on the second id."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Processor seconds of records."""

    record: float
    """Of one record, all included [s]."""
    integration: float
    """Share of them in the engine's integration."""


def make(env_id: str, arms: int, engine: str = "reduced") -> Any:
    """Make a batch on one thread."""
    return gymnasium.make_vec(env_id, num_envs=arms, engine=engine, threads=1)


def actions_of(envs: Any, duration: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """One joint at a random level, and random moves, for every arm."""
    batch, n, rows = envs.batch, envs.arm.n, []
    for _ in range(envs.num_envs):
        levels = np.zeros(n, dtype=np.intp)
        levels[rng.integers(n)] = rng.integers(1, 1 + len(envs.arm.levels))
        moves = rng.integers(0, len(batch.settings.moves), (1, n)).astype(np.intp)
        (moves,) = batch.actions.few_moves(moves, rng)
        rows.append(batch.actions.encode(moves=moves, levels=levels, duration=duration))
    return np.array(rows)


@contextmanager
def integration(rig: Any) -> Iterator[list[float]]:
    """Processor seconds that a rig on one thread spends in integration."""
    name = "_simulate" if isinstance(rig, SimulatedRig) else "_integrate"
    inner, spent = getattr(rig, name), [0.0]

    def timed(*given: Any) -> None:
        begin = time.thread_time()
        inner(*given)
        spent[0] += time.thread_time() - begin

    setattr(rig, name, timed)
    yield spent
    setattr(rig, name, inner)


@quiet()  # the same for every rival: no timers in the engine
def timed_env(env_id: str, arms: int, engine: str, duration: int, episodes: int) -> Timing:
    """Time whole episodes without verdicts, reset included."""
    envs, rng = make(env_id, arms, engine), np.random.default_rng(0)
    rounds = episodes * (8 if arms < 8 else 1)
    actions = [[actions_of(envs, duration, rng) for _ in range(_RECORDS)] for _ in range(rounds)]
    envs.reset(seed=0)
    envs.step(actions[0][0])  # compiles and warms up
    with integration(envs.batch.rig) as spent:
        begin = time.process_time()
        for each in actions:
            envs.reset()
            for action in each:
                envs.step(action)
        total = time.process_time() - begin
    records = rounds * _RECORDS * arms
    return Timing(record=total / records, integration=spent[0] / total)


def bare(env_id: str, duration: int) -> float:
    """Processor seconds of a record's steps of the same models in a C loop of `mj_step`."""
    envs = make(env_id, 8, "mujoco")
    envs.reset(seed=0)
    rig, settings = envs.batch.rig, envs.settings
    length = settings.durations[duration] + rig.arm.settling
    steps, total = round(length / rig.timestep), 0.0
    for slot, plant in enumerate(rig.plants):
        data = mujoco.MjData(plant.model)
        data.qpos[plant.indices.position] = plant.hold_at(envs.batch.episode(slot).pose)
        joint = slot % envs.arm.n
        data.eq_active[plant.indices.brakes[joint]] = 0
        data.ctrl[joint] = 0.2 * envs.arm.torque_limits[joint]
        mujoco.mj_step(plant.model, data, nstep=20)
        begin = time.process_time()
        mujoco.mj_step(plant.model, data, nstep=steps)
        total += time.process_time() - begin
    return total / len(rig.plants)


@quiet()
def timed_wrappers(env_id: str, arms: int, episodes: int) -> float:
    """Processor seconds of a record through the posterior and macro actions, chosen at random."""
    envs: Any = vector.MacroActions(vector.PosteriorObservation(make(env_id, arms)))
    rng, offered, records = np.random.default_rng(0), len(envs.macros), 0
    envs.reset(seed=0)
    begin = 0.0
    for step in range(2 + episodes * _RECORDS):
        if step == 2:
            begin, records = time.process_time(), 0
        allowed = envs.action_masks()[:, :offered]
        actions = np.where(allowed.any(1), (rng.random(allowed.shape) * allowed).argmax(1), offered)
        envs.step(actions)
        records += int((actions < offered).sum())
    return (time.process_time() - begin) / records


@quiet()
def timed_agent(name: str, env_id: str, arms: int, episodes: int) -> float:
    """Processor seconds of an agent for a record, without the environment."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "agents"))
    from loose_agents.base import Problem
    from loose_agents.registry import make_agent

    envs = make(env_id, arms)
    agent: Any = make_agent(name, Problem.of(envs.arm, envs.settings))
    state, spent, records = None, 0.0, 0
    observations, start = envs.reset(seed=0)[0], np.ones(arms, dtype=bool)
    for step in range(1 + episodes * _RECORDS):
        begin = time.process_time()
        actions, state = agent.predict(observations, state, start)
        if step:  # the first one loads and compiles
            spent += time.process_time() - begin
            records += int((actions[:, -1] == 0).sum())
        observations, _, terminated, truncated, _ = envs.step(actions)
        start = terminated | truncated
    return spent / max(records, 1)


def measure(options: Options) -> None:
    """Print the tables."""
    print("Processor time, one thread; loop: a record's steps by mj_step in C, same models.\n")
    print(
        f"{'environment':26}{'record':>7}{'arms':>6}{'engine':>9}{'records/s':>11}{'loop':>9}",
        end="",
    )
    print(f"{'ratio':>8}{'integration':>13}")

    def row(env_id: str, duration: int, arms: int, engine: str, loop: float) -> None:
        found = timed_env(env_id, arms, engine, duration, options.episodes)
        length = make(env_id, 1).settings.durations[duration]
        print(f"{env_id:26}{length:>5} s{arms:>6}{engine:>9}{1 / found.record:>11.0f}", end="")
        print(f"{1 / loop:>9.0f}{loop / found.record:>8.2f}{found.integration:>12.0%}", flush=True)

    loops = {env_id: bare(env_id, 0) for env_id in options.ids}
    for env_id in options.ids:
        for arms in options.arms:
            row(env_id, 0, arms, "reduced", loops[env_id])
    for env_id in options.ids:
        last = len(make(env_id, 1).settings.durations) - 1
        for duration in sorted({0, last}):
            row(env_id, duration, 64, "mujoco", bare(env_id, duration))
    few = options.episodes
    rows: list[tuple[str, str, int, Callable[[str, int, int], float]]] = [
        ("posterior, macros", env_id, 16, timed_wrappers) for env_id in options.ids
    ]
    chosen = options.ids[1:2] or options.ids
    rows += [
        (name, env_id, 8, partial(timed_agent, name))
        for env_id in chosen
        for name in options.agents
    ]
    print(f"\n{'what':20}{'environment':26}{'arms':>6}{'ms a record':>13}{'records/s':>11}", end="")
    print(f"{'loops':>8}")
    for what, env_id, arms, timed in rows:
        seconds = timed(env_id, arms, few)
        print(f"{what:20}{env_id:26}{arms:>6}{1e3 * seconds:>13.2f}{1 / seconds:>11.0f}", end="")
        print(f"{seconds / loops[env_id]:>8.2f}", flush=True)


if __name__ == "__main__":
    command("benchmark", __doc__, Options, measure)
