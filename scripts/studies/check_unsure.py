"""Check whether an agent says "unsure" where nothing it was trained on looks like what it sees.

Plays episodes as trained, with two faults at once, with three times the mismatch, on arms whose
lengths and masses are 15 % off, and with 1 g of preload on the loose seat. Prints how often it
named the right hypothesis, a wrong one, a loose place, or said that it is unsure.

Usage: python scripts/studies/check_unsure.py --env loose_env/Planar-v0 --episodes 300

Rows are stored shard by shard; the same command goes on from where it was stopped. Delete the
folder after training anew: rows are known by the agent's name, not by its weights.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import numpy as np
from loose_agents.benchmark.out_of_distribution import UNLIKE, UnlikeTask, play_unlike
from loose_agents.evaluation.env_arguments import arguments_of
from loose_agents.evaluation.evaluate import EVALUATION_SEED
from loose_agents.execution.backends import BackendSettings, add_backend_options
from loose_agents.execution.shard_store import RowCodec, ShardStore
from loose_agents.execution.shards import run_shards, shard_of

from loose_env.errors import LooseEnvError
from loose_env.evaluation import wilson
from loose_env.faults import UNSURE


def parser() -> argparse.ArgumentParser:
    """Options of the check."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = options.add_argument
    add("--env", default="loose_env/Planar-v0", help="environment id")
    add("--arguments", default='{"engine": "reduced"}', help="its arguments, as JSON")
    add("--agent", default="amortised/together", help="name of the agent")
    add("--kinds", nargs="+", choices=list(UNLIKE), default=list(UNLIKE), help="what to play")
    add("--episodes", type=int, default=300, help="episodes of each kind")
    add("--seed", type=int, default=EVALUATION_SEED + 7, help="seed of the episodes")
    add("--shard", type=int, default=50, help="episodes that a worker plays at a time")
    add("--out", default="out/unsure", help="folder of the rows")
    add_backend_options(options)
    return options


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


def check(options: argparse.Namespace) -> None:
    """Play what is missing, print the table."""
    arguments = arguments_of(options.arguments)
    heads = (f"{name} %, 95 %" for name in ("right", "wrong", "place", "unsure"))
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
        run_shards(partial(play_unlike, task), shards, store, settings=BackendSettings.of(options))
        lines.append(line_of(kind, [row for part in store.read_all(shards) for row in part]))
    print(f"\n{options.agent} in {options.env}\n")
    print(
        "  ".join([f"{'episodes':<28}{'':>5}", *(f"{h:>19}" for h in heads), "records", " reward"])
    )
    print("\n".join(lines))


def main(arguments: Sequence[str] | None = None) -> None:
    """Check, with errors in one line."""
    options = parser().parse_args(arguments)
    try:
        check(options)
    except KeyboardInterrupt:
        sys.exit("check_unsure: interrupted; the same command goes on from there")
    except (LooseEnvError, gymnasium.error.Error, ValueError, OSError) as error:
        sys.exit(f"check_unsure: {error}")


if __name__ == "__main__":
    main()
