"""Build a bank of simulated records, and compute the features a posterior is trained on.

Usage: python scripts/agents/build_bank.py --env loose_env/Planar-v0 --episodes 20000 --out
banks/planar4

A bank holds episodes of random records and the truth behind them (see
agents/loose_agents/record_bank.py). It is a folder with a file for every
500 episodes; stopped at any moment, the same command goes on. Every episode has its own seed, so a
bank is the same for any backend and number of workers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# One thread each: the order in which threads add up changes the last digit of a figure.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.jobs import BackendSettings, Store
from loose_agents.record_bank import BankOptions, BankPlan, build_bank, build_features

from loose_env.cli.command import command


@dataclass(frozen=True, kw_only=True)
class Options(BankOptions, BackendSettings):
    """Options of the script."""

    records_only: bool = False
    """Work out no features."""


def build(options: Options) -> None:
    """Build, and say how large it is and how long it took."""
    plan, folder = options.plan, Path(options.out)
    begin = time.perf_counter()
    store = build_bank(plan, folder, options)
    made = time.perf_counter() - begin
    records = sum(
        int((part["slots"][:, :, 0] > 0.5).sum()) for part in map(store.read, plan.shards)
    )
    print(
        f"{plan.episodes} episodes, {records} records, {megabytes(store, plan):.1f} MB in "
        f"{store.folder}; this run took {made:.1f} s"
    )
    if not options.records_only:
        begin = time.perf_counter()
        store = build_features(plan, folder, options)
        made = time.perf_counter() - begin
        print(
            f"Figures of {records} records, {megabytes(store, plan):.1f} MB in {store.folder}; "
            f"this run took {made:.1f} s"
        )


def megabytes(store: Store, plan: BankPlan) -> float:
    """Size of a bank's files in a folder [MB]; other episodes may lie there too."""
    return sum(store.path(shard).stat().st_size for shard in plan.shards) / 1e6


def main(arguments: Sequence[str] | None = None) -> None:
    """Build, with errors in one line."""
    going_on = "run the same command again to go on"
    command("build_bank", __doc__, Options, build, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
