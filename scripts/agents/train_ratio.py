"""Train a posterior by neural ratio estimation with the library sbi, on a bank of records.

Usage: python scripts/agents/train_ratio.py --env loose_env/ControlTier-v0 --out banks/vera

What a general library gives on the same simulator, as estimator "ratio": `compare.py --agents
ratio/together`. The bank is built first where it is missing, and a stopped bank goes on; the
training itself takes minutes. A tenth of the episodes is held out; the table at the end is of
these. Needs the extra sbi.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.belief import WEIGHTS, tuning_name
from loose_agents.core.ratio_posterior import FORMAT, RatioPosterior, RatioSettings, ratio_network
from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.command import command, option
from loose_agents.posterior_training.ratio_training import (
    RatioTraining,
    episode_parts,
    train_ratio,
)
from loose_agents.record_bank import BankOptions, RecordBank, build_bank, read_bank

from loose_env.diagnosis import write_network
from loose_env.io import Count


@dataclass(frozen=True, kw_only=True)
class Options(BankOptions, BackendSettings):
    """Options of the training."""

    hidden: Count = option(RatioSettings.hidden, "hidden units of each layer")
    epochs: Count = option(RatioTraining.epochs, "most passes over the records")
    training_seed: int = option(RatioTraining.seed, "its seed")
    weights: str | None = option(None, "folder of the trained weights")


def train(options: Options) -> None:
    """Build what is missing, train, write the weights, print how well they do."""
    import torch

    torch.set_num_threads(1)
    plan, folder = options.plan, Path(options.out)
    problem = plan.problem()
    held_shards, training_shards = plan.split
    settings = RatioSettings(hidden=options.hidden)
    ratio_network(problem, settings)  # what is missing is said before the bank is simulated
    build_bank(plan, folder, options)
    training = RatioTraining(epochs=options.epochs, seed=options.training_seed)
    begin = time.perf_counter()
    seen = read_bank(plan, folder, training_shards)
    network = train_ratio(problem, seen, settings, training)
    seconds = time.perf_counter() - begin
    rows = scores(RatioPosterior(problem, network), read_bank(plan, folder, held_shards))
    out = Path(options.weights or WEIGHTS / f"ratio-{tuning_name(problem)}")
    configuration = {
        "format": FORMAT,
        "fingerprint": problem.fingerprint,
        "network": asdict(settings),
        "training": asdict(training),
        "bank": {**plan.configuration, "records": asdict(plan.records), "episodes": plan.episodes},
        "held_out": rows,
    }
    tensors = {name: value.numpy() for name, value in network.state_dict().items()}
    write_network(out, configuration, tensors)
    print(f"trained in {seconds:.0f} s; written: {out}")
    for row in rows:
        print(
            f"{row['records']:2d} records: {100 * row['success']:.1f} % right, log score "
            f"{row['score']:.3f} nat, {row['episodes']} episodes held out"
        )


def scores(posterior: RatioPosterior, bank: RecordBank) -> list[dict[str, Any]]:
    """Accuracy and mean log score of the truth on held-out episodes, by number of records."""
    slots, truth = episode_parts(bank, posterior.problem.layout.slots)
    lengths = (slots[:, :, 0] > 0.5).sum(axis=1)
    found = []
    for length in np.unique(lengths).tolist():
        own = lengths == length
        p = posterior.probabilities(slots[own])
        right = p.argmax(axis=1) == truth[own]
        score = np.log(np.maximum(p[np.arange(len(p)), truth[own]], 1e-6))
        found.append(
            {
                "records": int(length),
                "episodes": int(own.sum()),
                "success": float(right.mean()),
                "score": float(score.mean()),
            }
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    going_on = "run the same command again to go on"
    command("train_ratio", __doc__, Options, train, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
