"""Step environments a million times, watch the memory, count what diverges.

Arms take turns, both engines, in short rounds: make the environments, reset, step with random
actions, close. Each step of each environment counts. Memory is that of the process [MB]; its
growth is that of the last fifth of the rounds over the first fifth, after a warm-up of one round of
every arm. Whatever leaves its space, or is not finite, ends the run.

Usage: python -m scripts.suites.trust.soak_run --engine reduced [--steps 1000000] [--out out/trust]

The same command goes on where it was stopped; memory is compared within one process only.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import numpy as np

import loose_env  # noqa: F401  (registers the ids)
from loose_env.cli.command import errors_in_one_line

ROOT = Path(__file__).resolve().parents[3]
ARMS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("loose_env/Vera-v0", {}),
    ("loose_env/Planar-v0", {"n_links": 3, "hold": "servo"}),
    ("loose_env/SixAxis-v0", {"difficulty": "hard"}),
    ("loose_env/Scara-v0", {"difficulty": "easy"}),
    ("loose_env/Arm-v0", {"hold": "compliant"}),
)
"""Environments that take turns."""
SIDE_BY_SIDE = 32
"""Environments in one batch."""
STEPS = 50
"""Steps of a batch in one round."""
NAMED = 0.15
"""Share of steps that name a fault; the others measure."""
MOST_GROWTH = 0.05
"""Growth of memory that is allowed."""


@dataclass
class Soak:
    """What is known so far."""

    engine: str
    steps: int = 0
    """Steps taken."""
    records: int = 0
    """Of these, records measured."""
    episodes: int = 0
    """Episodes begun and ended."""
    rounds: int = 0
    """Rounds done."""
    seconds: float = 0.0
    """Time spent in rounds [s]."""
    processor_seconds: float = 0.0
    """Processor time of the same [s]: where others use the machine too, this is what counts."""
    diverged: dict[str, int] = field(default_factory=dict)
    """Diverged simulations by arm and kind of fault."""
    memory: list[list[float]] = field(default_factory=list)
    """Memory after every round, a list for each process [MB]."""

    @property
    def growth(self) -> float:
        """Growth of memory in the process that ran longest [1]; 0 where too few rounds ran."""
        run = max(self.memory, key=len, default=[])[len(ARMS) :]
        fifth = len(run) // 5
        if not fifth:
            return 0.0
        return float(np.median(run[-fifth:]) / np.median(run[:fifth]) - 1)


def memory() -> float:
    """Memory that the process holds, after what is free was given back [MB]."""
    gc.collect()
    with suppress(OSError):  # not the C library of GNU
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def play_round(soak: Soak, seed: int, *, steps: int = STEPS, width: int = SIDE_BY_SIDE) -> None:
    """One round of one arm, chosen by the number of the round."""
    env_id, arguments = ARMS[soak.rounds % len(ARMS)]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(soak.rounds,)))
    begin, worked = time.perf_counter(), time.process_time()
    envs: Any = gymnasium.make_vec(
        env_id, num_envs=width, engine=soak.engine, threads=1, **arguments
    )
    try:
        observation, _ = envs.reset(seed=int(rng.integers(2**31)))
        for _ in range(steps):
            actions = rng.integers(0, envs.actions.nvec, size=(width, len(envs.actions.nvec)))
            measures = rng.random(width) > NAMED
            actions[measures, -1] = 0
            observation, reward, terminated, truncated, _ = envs.step(actions)
            if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
                raise ValueError(f"{env_id}, round {soak.rounds}: a value is not finite")
            if not envs.observation_space.contains(observation):
                raise ValueError(f"{env_id}, round {soak.rounds}: an observation is out of bounds")
            soak.steps += width
            soak.records += int((actions[:, -1] == 0).sum())
            soak.episodes += int((terminated | truncated).sum())
        for kind, count in envs.divergences.items():
            name = f"{env_id.split('/')[1]} {kind}"
            soak.diverged[name] = soak.diverged.get(name, 0) + count
    finally:
        envs.close()
    del envs
    soak.seconds += time.perf_counter() - begin
    soak.processor_seconds += time.process_time() - worked
    soak.rounds += 1
    soak.memory[-1].append(round(memory(), 2))


def words(soak: Soak) -> str:
    """What is known, in a few lines."""
    diverged = sum(soak.diverged.values())
    run = max(soak.memory, key=len, default=[])
    lines = [
        f"{soak.engine}: {soak.steps} steps, {soak.records} records, {soak.episodes} episodes, "
        f"{soak.rounds} rounds; {soak.steps / max(soak.processor_seconds, 1e-9):.0f} steps a "
        "second of processor time",
        f"diverged: {diverged} of {soak.records} records"
        + "".join(f"; {name} {count}" for name, count in sorted(soak.diverged.items())),
    ]
    if run:
        lines.append(
            f"memory: {run[0]:.0f} MB after the first round, {run[-1]:.0f} MB after the last, most "
            f"{max(run):.0f} MB; growth {soak.growth:+.2%} (at most {MOST_GROWTH:.0%})"
        )
    return "\n".join(lines)


def main() -> None:
    """Read the options and step."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--engine", default="reduced", choices=("reduced", "mujoco"))
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps in all")
    parser.add_argument("--seed", type=int, default=1, help="of actions and episodes")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "trust")
    parser.add_argument("--show", action="store_true", help="print what is stored")
    options = parser.parse_args()
    with errors_in_one_line("trust_soak", interrupted="the same command goes on"):
        options.out.mkdir(parents=True, exist_ok=True)
        file = options.out / f"soak-{options.engine}-{options.seed}.json"
        soak = Soak(engine=options.engine)
        if file.is_file():
            soak = Soak(**json.loads(file.read_text()))
        if not options.show:
            soak.memory.append([])
            while soak.steps < options.steps:
                play_round(soak, options.seed)
                beside = file.with_suffix(".part")
                beside.write_text(json.dumps(asdict(soak)))
                beside.replace(file)
                if soak.rounds % 25 == 0:
                    print(words(soak), file=sys.stderr, flush=True)
        print(words(soak))
    if soak.growth > MOST_GROWTH:
        sys.exit(1)


if __name__ == "__main__":
    main()
