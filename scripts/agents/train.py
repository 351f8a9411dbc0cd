"""Train a policy on an environment, with the options of the rl-zoo.

Usage: python scripts/agents/train.py --algo ppo --env loose_env/Vera-v0 -P

The run lies in LOG_FOLDER/ALGO/ENV_SEED. The same command run again goes on from the last
checkpoint, also after a kill; scripts/agents/enjoy.py plays what it learned. `--export FOLDER`
puts the best policy elsewhere, such as agents/loose_agents/weights/vera.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from loose_agents.belief import ESTIMATORS
from loose_agents.jobs import ProgressLine
from loose_agents.rl.hyperparameters import (
    ALGORITHMS,
    HYPERPARAMETERS,
    algorithm_named,
    key_values,
    read_hyperparameters,
    whole,
)
from tyro.conf import arg

from loose_env.cli.command import command, one_of
from loose_env.errors import InvalidSetting
from loose_env.io import Count, NonNegativeCount


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the training."""

    algo: Annotated[str, one_of(ALGORITHMS)] = "ppo"
    """Algorithm."""
    env: str = "loose_env/Vera-v0"
    """Environment id."""
    env_kwargs: tuple[str, ...] = ()
    """Its arguments, key:value."""
    estimator: Annotated[str, one_of(tuple(ESTIMATORS))] = "posterior"
    """What it learns on."""
    seed: NonNegativeCount = 1
    """Seed of the run."""
    n_timesteps: Annotated[int, arg(aliases=["-n"])] = -1
    """Steps in all; -1: as the file says."""
    conf_file: Annotated[Path | None, arg(aliases=["-conf"])] = None
    """Hyperparameters, YAML; agents/loose_agents/hyperparams by default."""
    hyperparams: Annotated[tuple[str, ...], arg(aliases=["-params"])] = ()
    """Hyperparameters that override the file's, key:value."""
    eval_freq: int = 10_000
    """Steps between evaluations; -1: none."""
    eval_episodes: Count = 200
    """Episodes of an evaluation."""
    save_freq: int = -1
    """Steps between checkpoints; -1: every update."""
    log_folder: Annotated[Path, arg(aliases=["-f"])] = Path("runs")
    """Folder of the runs."""
    tensorboard_log: Annotated[str, arg(aliases=["-tb"])] = ""
    """Folder of the tensorboard log."""
    restart: bool = False
    """Forget what the run's folder holds."""
    export: Path | None = None
    """Folder for the best policy at the end."""
    shaping: float = 0.1
    """Reward for a nat of log-posterior gained."""
    forced_records: Count = 3
    """Records before a stop, at the start."""
    forced_share: float = 0.4
    """Share of the steps with forced records, 0 to 1."""
    device: str = "cpu"
    """Torch device."""
    progress: Annotated[bool, arg(aliases=["-P"])] = False
    """Show a progress bar."""

    def __post_init__(self) -> None:
        if self.seed >= 2**32:
            raise InvalidSetting(f"--seed must be below 2^32, got {self.seed}")
        if self.n_timesteps == 0 or self.n_timesteps < -1:
            raise InvalidSetting(
                f"-n must be 1 or more, or -1 for the file's; got {self.n_timesteps}"
            )
        if not 0.0 <= self.forced_share <= 1.0:
            raise InvalidSetting(f"--forced-share must be 0 to 1, got {self.forced_share}")


def train(options: Options) -> Path:
    """Train, keep the run on disk, and return its folder."""
    file = options.conf_file or HYPERPARAMETERS / f"{options.algo}.yml"
    hyperparameters = read_hyperparameters(file, options.env)
    hyperparameters |= key_values(options.hyperparams, "--hyperparams")
    own = hyperparameters.pop("env_kwargs", {})
    if not isinstance(own, dict):
        raise InvalidSetting(f"env_kwargs in a hyperparameter file is a mapping, got {own!r}")
    steps = whole(hyperparameters.get("n_timesteps", 0), "n_timesteps")
    if options.n_timesteps > 0:
        steps = options.n_timesteps
    if steps < 1:
        raise InvalidSetting("the hyperparameters have no n_timesteps: give -n")
    algorithm_named(options.algo)  # says which extra is missing
    from loose_agents.rl import training

    name, log = options.env.replace("/", "-"), options.tensorboard_log
    run = training.Training(
        algorithm=options.algo,
        estimator=options.estimator,
        env=options.env,
        arguments=own | key_values(options.env_kwargs, "--env-kwargs"),
        hyperparameters=hyperparameters,
        steps=steps,
        seed=options.seed,
        evaluations=steps / options.eval_freq if options.eval_freq > 0 else 0.0,
        eval_episodes=options.eval_episodes,
        save_freq=options.save_freq,
        shaping=options.shaping,
        forced_records=options.forced_records,
        forced_share=options.forced_share,
        device=options.device,
        tensorboard=str(Path(log) / name) if log else "",
        folder=options.log_folder / options.algo / f"{name}_{options.seed}",
        restart=options.restart,
    )

    begin = time.perf_counter()
    bar = ProgressLine(steps, unit="steps") if options.progress else None

    def show(done: int, words: str) -> None:
        if bar is None:
            seconds = time.perf_counter() - begin
            print(f"{done:7d} of {steps} steps  {seconds:5.0f} s  {words}", flush=True)
        else:
            bar.advance(done - bar.n, words)

    told: dict[str, Any] = {"options": asdict(options), "command": " ".join(sys.argv)}
    try:
        folder = training.train(run, show=show, **told)
    finally:
        if bar is not None:
            bar.close()
    print(f"policy: {folder.root}")
    if options.export:
        folder.export(options.export)
        print(f"exported to {options.export}")
    return folder.root


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options and train, with errors in one line."""
    going_on = "the same command goes on from the last checkpoint"
    command("train", __doc__, Options, train, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
