"""Trains maskable PPO on loose_env/Gap-v0, on the belief as observation.

Usage: python scripts/model_gap/train.py --steps 100000 --out out/gap_ppo
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.execution.command import add_options, new_parser, option, options_of
from loose_agents.execution.script_errors import errors_in_one_line

from loose_env.io import Count
from scripts.model_gap.play import made


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a training."""

    out: Path = option(Path("out/gap_ppo"), "folder of the weights")
    steps: Count = option(100_000, "motions and verdicts to train on")
    seed: int = option(1, "seed of the training")


def main() -> None:
    """Train by the options of the command line."""
    with errors_in_one_line("train"):
        parser = new_parser(__doc__)
        add_options(parser, Options)
        options = options_of(Options, parser.parse_args())
        train(options)


def train(options: Options) -> None:
    """Train and store the weights."""
    from sb3_contrib import MaskablePPO

    model = MaskablePPO(
        "MlpPolicy", made(), n_steps=256, batch_size=64, gamma=1.0, ent_coef=0.01,
        learning_rate=1e-3, seed=options.seed, verbose=1,
    )  # fmt: skip
    model.learn(options.steps)
    options.out.mkdir(parents=True, exist_ok=True)
    model.save(options.out / "model.zip")
    print(f"written: {options.out / 'model.zip'}")


if __name__ == "__main__":
    main()
