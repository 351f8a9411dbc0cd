"""Check the detection rate of out-of-distribution arms: an agent's verdict "unsure".

Plays episodes as trained, with two faults at once, with three times the mismatch, on arms whose
lengths and masses are 15 % off, and with 1 g of preload on the loose seat. Prints the shares of
right verdicts, of wrong ones, of right locations, and of "unsure".

Usage: python scripts/studies/checks/unsure.py --env loose_env/Planar-v0 --episodes 300

Rows are stored shard by shard; the same command goes on from where it was stopped. Delete the
folder after training anew: rows are known by the agent's name, not by its weights.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.base import EVALUATION_SEED
from loose_agents.benchmark.episodes import UNLIKE, UnlikeTask, play_unlike
from loose_agents.evaluation import arguments_of
from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.command import command, option
from loose_agents.execution.shard_store import RowCodec, ShardStore
from loose_agents.execution.shards import run_shards, shard_of

from loose_env.evaluation import wilson
from loose_env.faults import UNSURE
from loose_env.io import Count


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Settings of the check."""

    env: str = option("loose_env/Planar-v0", "environment id")
    arguments: str = option('{"engine": "reduced"}', "its arguments, as JSON")
    agent: str = option("amortised/together", "name of the agent")
    kinds: tuple[str, ...] = option(tuple(UNLIKE), "what to play", choices=tuple(UNLIKE))
    episodes: Count = option(300, "episodes of each kind")
    seed: int = option(EVALUATION_SEED + 7, "seed of the episodes")
    shard: Count = option(50, "episodes that a worker plays at a time")
    out: str = option("out/unsure", "folder of the rows")


def line_of(kind: str, rows: Sequence[dict[str, Any]]) -> str:
    """One line of the table."""
    unsure = [row["verdict"] == UNSURE for row in rows]
    right = [row["success"] for row in rows]
    wrong = [not (a or b) for a, b in zip(unsure, right, strict=True)]
    cells = [f"{UNLIKE[kind][0]:<28}{len(rows):>5}"]
    for counted in (right, wrong, [row["link_success"] for row in rows], unsure):
        low, high = wilson(sum(counted), len(rows))
        cells.append(f"{100 * np.mean(counted):6.1f} ({100 * low:4.1f}-{100 * high:5.1f})")
    records, reward = (np.mean([row[name] for row in rows]) for name in ("records", "reward"))
    return "  ".join([*cells, f"{records:7.2f}", f"{reward:+7.3f}"])


def check(options: Options) -> None:
    """Play what is missing, print the table."""
    arguments = arguments_of(options.arguments)
    heads = (f"{name} %, 95 %" for name in ("accuracy", "wrong", "location", "unsure"))
    lines = []
    for kind in options.kinds:
        task = UnlikeTask(
            kind=kind,
            agent=options.agent,
            env_id=options.env,
            arguments=arguments,
            seed=options.seed,
        )
        print(UNLIKE[kind][0], file=sys.stderr, flush=True)
        shards = shard_of(options.episodes, options.shard)
        store = ShardStore(Path(options.out) / kind, task.configuration, RowCodec())
        run_shards(partial(play_unlike, task), shards, store, settings=options)
        lines.append(line_of(kind, [row for part in store.read_all(shards) for row in part]))
    print(f"\n{options.agent} in {options.env}\n")
    print(
        "  ".join([f"{'episodes':<28}{'':>5}", *(f"{h:>19}" for h in heads), "records", " reward"])
    )
    print("\n".join(lines))


def main(arguments: Sequence[str] | None = None) -> None:
    """Check, with errors in one line."""
    command(
        "check_unsure", __doc__, Options, check, arguments, interrupted="the same command goes on"
    )


if __name__ == "__main__":
    main()
