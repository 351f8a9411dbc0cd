"""Speed and memory of the vector environment, each as a ratio within one run.

Usage: python scripts/dev/benchmark.py [--arms 64] [--rounds 4] [--ids ...]
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import quiet
from loose_env.cli.command import command
from loose_env.envs import EpisodeBatch
from loose_env.io import Count


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the timing."""

    arms: Count = 64
    """Arms side by side."""
    rounds: Count = 4
    """Timed steps of the whole batch."""
    ids: tuple[str, ...] = ("loose_env/Vera-v0", "loose_env/Planar-v0", "loose_env/SixAxis-v0")
    """Environments to time."""


def actions_of(batch: EpisodeBatch, rng: np.random.Generator, duration: int | None) -> list[Any]:
    """Draw one joint at a random level and random moves for every arm; None: random lengths."""
    n, chosen = batch.arm.n, []
    for _ in range(batch.num):
        levels = np.zeros(n, dtype=np.intp)
        levels[rng.integers(n)] = rng.integers(1, 4)
        moves = rng.integers(0, len(batch.settings.moves), n)
        length = int(rng.integers(len(batch.settings.durations))) if duration is None else duration
        chosen.append(batch.actions.encode(moves=moves, levels=levels, duration=length))
    return chosen


def new_batch(env_id: str, arms: int, *, engine: str = "mujoco", threads: int = 0) -> EpisodeBatch:
    """Make the episodes behind an id."""
    env: Any = gymnasium.make(env_id, engine=engine).unwrapped
    batch = EpisodeBatch(env.arm, env.settings, num=arms, threads=threads)
    for slot in range(arms):
        batch.start(slot, seed=slot, number=0)
    return batch


@quiet()  # the same for every rival: no timers in the engine
def seconds_per_record(
    batch: EpisodeBatch, rounds: int, duration: int | None, *, of_processor: bool = False
) -> float:
    """Time the steps of a batch; every third round starts new episodes, as agents do.

    Seconds of processor time, of all threads together, do not depend on what else runs.
    """
    clock = time.process_time if of_processor else time.perf_counter
    rng = np.random.default_rng(0)
    batch.step(range(batch.num), actions_of(batch, rng, duration))  # warm up
    begin = clock()
    for k in range(rounds):
        if k % 3 == 0:
            for slot in range(batch.num):
                batch.start(slot, seed=slot, number=1 + k)
        batch.step(range(batch.num), actions_of(batch, rng, duration))
    return (clock() - begin) / (rounds * batch.num)


def subprocess_seconds_per_record(env_id: str, records: int, duration: int | None) -> float:
    """Time single environments as Gymnasium runs them in two subprocesses."""
    batch = new_batch(env_id, 2)
    rivals = AsyncVectorEnv([partial(gymnasium.make, env_id)] * 2, context="spawn")
    rivals.reset(seed=0)
    rng = np.random.default_rng(0)
    rivals.step(np.array(actions_of(batch, rng, duration)))  # warm up
    begin = time.perf_counter()
    for _ in range(records // 2):
        rivals.step(np.array(actions_of(batch, rng, duration)))
    spent = time.perf_counter() - begin
    rivals.close()
    return spent / (2 * (records // 2))


def child(code: str) -> list[str]:
    """Run code in a fresh interpreter and return the words that it prints."""
    run = [sys.executable, "-c", code]
    return subprocess.run(run, check=True, capture_output=True, text=True).stdout.split()


def memory_of(env_id: str, arms: int) -> float:
    """Peak memory of a vector environment through three steps of full records [GiB]."""
    code = (
        "import resource, numpy as np, gymnasium, loose_env\n"
        f"v = gymnasium.make_vec({env_id!r}, num_envs={arms}); v.reset(seed=0)\n"
        f"a = np.array([v.actions.encode(levels=np.full(v.arm.n, 3))] * {arms})\n"
        "for _ in range(3): v.step(a)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)"
    )
    return float(child(code)[0])


def measure(options: Options) -> None:
    """Print the table of ratios."""
    arms, rounds = options.arms, options.rounds
    print(f"{os.cpu_count()} processors, {arms} arms, times per record; the reduced engine over")
    print("MuJoCo by processor time on one thread\n")
    head = f"{'environment':22}{'record':>8}{'MuJoCo':>10}{'records/s':>11}"
    print(head + f"{'vs 2 processes':>16}{'reduced/s':>11}{'reduced':>9}")
    for env_id in options.ids:
        durations = new_batch(env_id, 1).settings.durations
        for duration in (len(durations) - 1, None):
            name = "mixed" if duration is None else f"{durations[duration]} s"
            mine = seconds_per_record(new_batch(env_id, arms), rounds, duration)
            loop = subprocess_seconds_per_record(env_id, max(arms, 16), duration)
            other = new_batch(env_id, arms, engine="reduced")
            reduced = seconds_per_record(other, rounds, duration)
            pair = (new_batch(env_id, 16, engine=e, threads=1) for e in ("mujoco", "reduced"))
            spent = [seconds_per_record(b, 1, duration, of_processor=True) for b in pair]
            print(
                f"{env_id:22}{name:>8}{1e3 * mine:>7.1f} ms{1 / mine:>11.1f}{loop / mine:>16.2f}"
                f"{1 / reduced:>11.1f}{spent[0] / spent[1]:>8.1f}x",
                flush=True,
            )
    for env_id in options.ids:
        print(f"peak memory of {4 * arms} arms of {env_id}: {memory_of(env_id, 4 * arms):.2f} GiB")
    code = (
        "import sys, time; t = time.perf_counter(); import loose_env\n"
        "print(time.perf_counter() - t, 'torch' in sys.modules)"
    )
    seconds, torch = child(code)
    print(f"import loose_env: {float(seconds):.2f} s, {'with' if torch == 'True' else 'no'} torch")


if __name__ == "__main__":
    command("benchmark", __doc__, Options, measure)
