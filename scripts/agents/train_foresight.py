"""Train the learned choice of records of a task with one exciter.

Usage: python scripts/agents/train_foresight.py --env loose_env/SearchTier-v0 --out runs/search

Records of simulated arms lie in --out; stopped at any moment, the same command goes on with the
part that was begun. The weights go to agents/loose_agents/weights, or to --weights. Then
scripts/agents/tune_agents.py --agents calibrated/foresight tunes when it stops.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.base import Problem, check_training_seed
from loose_agents.jobs import ProgressLine, Store
from loose_agents.rl.foresight_training import ForesightTraining
from loose_agents.rl.hyperparameters import key_values

from loose_env.cli.command import command
from loose_env.io import Count


@dataclass(frozen=True, kw_only=True)
class Options(ForesightTraining):
    """Options of the training."""

    env: str = "loose_env/SearchTier-v0"
    """Environment id; on the reduced engine."""
    env_kwargs: tuple[str, ...] = ()
    """Its arguments, key:value."""
    arms: Count = 128
    """Arms that are played at once."""
    out: Path = Path("runs/foresight")
    """Folder of the records."""
    weights: Path | None = None
    """Folder of the weights."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    going_on = "run the same command again to go on"
    command("train_foresight", __doc__, Options, run, arguments, interrupted=going_on)


def run(options: Options) -> None:
    """Train, write the weights, print what they are worth."""
    import torch
    from loose_agents.evaluation import make_environments
    from loose_agents.rl.foresight import folder_of
    from loose_agents.rl.foresight_training import train

    torch.set_num_threads(1)
    check_training_seed(options.seed)
    given = {"engine": "reduced", "threads": 1} | key_values(options.env_kwargs, "--env-kwargs")
    envs = make_environments(options.env, options.arms, given)
    problem = Problem.of(envs.arm, envs.settings)
    bar = ProgressLine(options.records, unit="records")
    trained = {f.name: getattr(options, f.name) for f in fields(ForesightTraining)}
    told = {"task": problem.fingerprint, "arms": options.arms, **trained}
    store = Store(options.out, told, arrays=True)
    found, worth = train(problem, envs, options, store, lambda done: bar.advance(done - bar.n))
    bar.close()
    folder = folder_of(problem) if options.weights is None else options.weights
    found.save(folder, {"env": options.env, "arguments": given, **told})
    print("\n".join(["", *worth, f"Weights in {folder}"]))


if __name__ == "__main__":
    main()
