"""Command-line options of training: rl-zoo's and extensions, with validation."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from loose_agents.core.estimators import ESTIMATORS
from loose_agents.execution.command import OneLineParser
from loose_agents.rl.hyperparameters import ALGORITHMS
from loose_env.errors import InvalidSetting

__all__ = ["check_training", "training_parser"]


def training_parser(description: str | None = None) -> OneLineParser:
    """Build the parser of the training options."""
    options = OneLineParser(
        prog="train", description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = options.add_argument
    add("--algo", default="ppo", choices=list(ALGORITHMS), help="algorithm")
    add("--env", default="loose_env/Vera-v0", help="environment id")
    add("--env-kwargs", nargs="+", default=[], metavar="KEY:VALUE", help="its arguments")
    add("--gym-packages", nargs="+", default=[], help="packages to import for their ids")
    add("--estimator", default="posterior", choices=list(ESTIMATORS), help="what it learns on")
    add("--seed", type=int, default=1, help="seed of the run; below 0: drawn at random")
    add("-n", "--n-timesteps", type=int, default=-1, help="steps in all; -1: as the file says")
    add(
        "-conf",
        "--conf-file",
        help="hyperparameters, YAML; agents/loose_agents/hyperparams by default",
    )
    add("-params", "--hyperparams", nargs="+", default=[], metavar="KEY:VALUE",
        help="hyperparameters that override the file's")  # fmt: skip
    add("--eval-freq", type=int, default=10_000, help="steps between evaluations; -1: none")
    add("--eval-episodes", type=int, default=200, help="episodes of an evaluation")
    add("--n-eval-envs", type=int, default=64, help="arms side by side in an evaluation")
    add("--save-freq", type=int, default=-1, help="steps between checkpoints; -1: every update")
    add("-f", "--log-folder", default="runs", help="folder of the runs")
    add("-tb", "--tensorboard-log", default="", help="folder of the tensorboard log")
    add("-i", "--trained-agent", default="", help="model (.zip) to continue in a new run")
    add("--restart", action="store_true", help="forget what the run's folder holds")
    add("--export", default="", help="folder for the best policy at the end")
    add("--shaping", type=float, default=0.1, help="reward for a nat of log-posterior gained")
    add("--forced-records", type=int, default=3, help="records before a stop, at the start")
    add("--forced-share", type=float, default=0.4, help="share of the steps with forced records")
    add("--num-threads", type=int, default=-1, help="threads of torch; -1: one")
    add("--device", default="cpu", help="torch device")
    add("--verbose", type=int, default=1, choices=(0, 1, 2), help="0: print nothing")
    add("-P", "--progress", action="store_true", help="show a progress bar")
    return options


def check_training(options: argparse.Namespace) -> None:
    """Validate the options and fill in defaults.

    Raises
    ------
    InvalidSetting
        With what was given and what is allowed.
    """
    if options.seed < 0:
        options.seed = int(np.random.default_rng().integers(2**32))
        print(f"train: seed {options.seed}; give it as --seed to go on from a checkpoint")
    if options.seed >= 2**32:
        raise InvalidSetting(f"--seed must be below 2^32, got {options.seed}")
    if options.n_timesteps == 0 or options.n_timesteps < -1:
        raise InvalidSetting(
            f"-n must be 1 or more, or -1 for the file's; got {options.n_timesteps}"
        )
    for name in ("eval_episodes", "n_eval_envs", "forced_records"):
        if getattr(options, name) < 1:
            raise InvalidSetting(
                f"--{name.replace('_', '-')} must be 1 or more, got {getattr(options, name)}"
            )
    if not 0.0 <= options.forced_share <= 1.0:
        raise InvalidSetting(f"--forced-share must be 0 to 1, got {options.forced_share}")
    if options.trained_agent and not Path(options.trained_agent).is_file():
        raise InvalidSetting(f"no model at {options.trained_agent} to continue")
