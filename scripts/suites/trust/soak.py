"""Step environments a million times, watch the memory, count what diverges.

    python -m scripts.suites.trust.soak --engine reduced

Arms take turns in short rounds: make 32 environments, reset, step with random actions, close.
Growth of memory is that of the last fifth of the rounds over the first fifth, after a warm-up of
one round of every arm. Whatever leaves its space, or is not finite, ends the run.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np

import loose_env  # noqa: F401  (registers the ids)
from loose_env.cli.command import command

ARMS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("loose_env/Vera-v0", {}),
    ("loose_env/Planar-v0", {"n_links": 3, "hold": "servo"}),
    ("loose_env/SixAxis-v1", {"difficulty": "hard"}),
    ("loose_env/Scara-v1", {"difficulty": "easy"}),
    ("loose_env/Arm-v1", {"hold": "compliant"}),
)
"""Environments that take turns."""
NAMED = 0.15
"""Share of steps that name a fault; the others measure."""
MOST_GROWTH = 0.05
"""Growth of memory that is allowed."""


@dataclass
class Soak:
    """What is known so far."""

    steps: int = 0
    episodes: int = 0
    diverged: Counter[str] = field(default_factory=Counter)
    """Diverged simulations by arm and kind of fault."""
    memory: list[float] = field(default_factory=list)
    """Memory after every round [MB]."""

    @property
    def growth(self) -> float:
        """Growth of memory [1]; 0 where too few rounds ran."""
        run = self.memory[len(ARMS) :]
        fifth = len(run) // 5
        return float(np.median(run[-fifth:]) / np.median(run[:fifth]) - 1) if fifth else 0.0

    def __str__(self) -> str:
        diverged = ", ".join(f"{name} {count}" for name, count in sorted(self.diverged.items()))
        return (
            f"{self.steps} steps, {self.episodes} episodes, {len(self.memory)} rounds; diverged: "
            f"{diverged or 'none'}; growth {self.growth:+.2%} (at most {MOST_GROWTH:.0%})"
        )


def memory() -> float:
    """Memory that the process holds, after what is free was given back [MB]."""
    gc.collect()
    with suppress(OSError):  # not the C library of GNU
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def play_round(soak: Soak, engine: str, seed: int, *, steps: int = 50, width: int = 32) -> None:
    """One round of one arm, chosen by the number of the round."""
    number = len(soak.memory)
    env_id, arguments = ARMS[number % len(ARMS)]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    envs: Any = gymnasium.make_vec(env_id, num_envs=width, engine=engine, threads=1, **arguments)
    observation, _ = envs.reset(seed=int(rng.integers(2**31)))
    for _ in range(steps):
        actions = rng.integers(0, envs.actions.nvec, size=(width, len(envs.actions.nvec)))
        actions[rng.random(width) > NAMED, -1] = 0
        observation, reward, terminated, truncated, _ = envs.step(actions)
        if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
            raise AssertionError(f"{env_id}, round {number}: a value is not finite")
        if not envs.observation_space.contains(observation):
            raise AssertionError(f"{env_id}, round {number}: an observation is out of bounds")
        soak.steps += width
        soak.episodes += int((terminated | truncated).sum())
    for kind, count in envs.divergences.items():
        soak.diverged[f"{env_id.split('/')[1]} {kind}"] += count
    envs.close()
    del envs
    soak.memory.append(memory())


@dataclass(frozen=True, kw_only=True)
class SoakSettings:
    """How long."""

    engine: Literal["reduced", "mujoco"] = "reduced"
    """Simulation engine."""
    steps: int = 1_000_000
    """Steps in all."""
    seed: int = 1
    """Seed of actions and episodes."""


def run(given: SoakSettings) -> None:
    """Step and print what is known."""
    soak = Soak()
    while soak.steps < given.steps:
        play_round(soak, given.engine, given.seed)
        if len(soak.memory) % 25 == 0:
            print(soak, file=sys.stderr, flush=True)
    print(soak)
    if soak.growth > MOST_GROWTH:
        sys.exit(1)


if __name__ == "__main__":
    command("soak", __doc__, SoakSettings, run)
