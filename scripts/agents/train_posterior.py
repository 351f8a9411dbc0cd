"""Train the posterior on a bank of simulated records: likelihood, novelty reference.

Usage: python scripts/agents/train_posterior.py --env loose_env/Planar-v0 --episodes 20000 --out
banks/planar4

The bank holds episodes of random records and the truth behind them
(agents/loose_agents/record_bank.py); it is built first where it is missing, the same for any
backend and number of workers, and --bank-only stops there. A tenth of the episodes is held out:
half of them set the tempers, the table is of the others. Stopped at any moment, the same command
goes on. Weights go to agents/loose_agents/weights, or to --weights. With them goes what arms of the
trained kind leave unexplained, by which an agent knows an arm of another kind.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.jobs import BackendSettings
from loose_agents.posterior_training import (
    PosteriorTraining,
    TrainingSettings,
    fit_reference,
    seen_episodes,
    with_reference,
)
from loose_agents.record_bank import (
    BankOptions,
    BankPlan,
    build_bank,
    build_features,
    read_bank,
    read_features,
    seat_features,
)
from loose_agents.stored import WEIGHTS, setting_name
from numpy.typing import NDArray

from loose_env.cli.command import command
from loose_env.diagnosis import NoveltyReference, Seen, trained_for, write_network
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.faults import KINDS, hypotheses
from loose_env.io import Count
from loose_env.statistics import axes_grid

HELD_OUT = 4
"""Shards of the bank from which information is fitted: the first, not trained on."""


@dataclass(frozen=True, kw_only=True)
class Options(BankOptions, BackendSettings):
    """Options of the training."""

    steps: Count = TrainingSettings.steps
    """Optimiser steps."""
    hidden: Count = TrainingSettings.hidden
    """Hidden units."""
    training_seed: int = TrainingSettings.seed
    """Its seed."""
    weights: str | None = None
    """Folder of the trained weights."""
    bank_only: bool = False
    """Build the bank alone."""


def train(options: Options) -> None:
    """Build what is missing, train, write the weights, print how well they do."""
    plan, folder = options.plan, Path(options.out)
    problem = plan.problem()
    if options.bank_only:
        print(f"{plan.episodes} episodes in {build_bank(plan, folder, options).folder}")
        return
    import torch

    torch.set_num_threads(1)
    if problem.hypotheses != hypotheses(problem.arm):
        raise InvalidSetting(
            f"the posterior learns the kinds {list(KINDS)}; leave the environment's kinds "
            "as they are by default"
        )
    held_shards, training_shards = plan.split
    build_bank(plan, folder, options)
    store = build_features(plan, folder, options)
    out = Path(options.weights or WEIGHTS / f"posterior-{setting_name(problem)}")
    directions = axes_grid(plan.directions, len(problem.arm.axes))
    difficulty = difficulty_named(problem.settings.difficulty)
    seen = read_features(store, training_shards)
    training = PosteriorTraining(
        seen,
        joints=problem.arm.n,
        directions=directions,
        friction=difficulty.friction,
        settings=TrainingSettings(
            steps=options.steps, hidden=options.hidden, seed=options.training_seed
        ),
    )
    begin = time.perf_counter()
    training.train(folder / f"training-{options.training_seed}")
    seconds = time.perf_counter() - begin
    half = len(held_shards) // 2  # one part sets the tempers, the other judges
    if half:
        training.calibrate(read_features(store, held_shards[:half]))
    found = training.scores(read_features(store, held_shards[half:]))
    tensors = training.tensors()
    reference = reference_of(tensors, plan, folder)
    write_network(
        out,
        {
            **trained_for(problem.arm, problem.settings.durations),
            "difficulty": str(problem.settings.difficulty),
            "directions": plan.directions,
            "friction": list(difficulty.friction),
            "bank": {**asdict(plan), "held_out": len(held_shards), "hash": store.hash},
            "training": asdict(training.settings),
            "held_out": found,
        },
        with_reference(tensors, reference),
    )
    print(f"Trained in {seconds:.0f} s; weights in {out}\n")
    print(f"{'records':>8}{'episodes':>10}{'success':>10}{'log score':>11}{'ECE':>8}")
    for row in found:
        print(
            f"{row['records']:>8}{row['episodes']:>10}{100 * row['success']:>8.1f} %"
            f"{row['score']:>11.3f}{row['ece']:>8.3f}"
        )


def reference_of(
    tensors: Mapping[str, NDArray[Any]], plan: BankPlan, folder: Path
) -> NoveltyReference:
    """Work the reference out from the bank's records."""
    held_shards, training_shards = plan.split
    problem, directions = plan.problem(), plan.directions
    features = seat_features(problem, directions)

    def episodes(shards: list[range]) -> Iterator[list[Seen]]:
        for shard in shards:  # one after the other: what all of them show is large
            yield from seen_episodes(problem, features, read_bank(plan, folder, [shard]))

    return fit_reference(
        tensors,
        episodes(training_shards),
        episodes(held_shards),
        directions=axes_grid(directions, len(problem.arm.axes)),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    going_on = "run the same command again to go on"
    command("train_posterior", __doc__, Options, train, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
