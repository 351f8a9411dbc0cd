"""Train learners from scratch on the raw observation, several seeds, with learning curves.

Usage: python scripts/agents/learning_curves.py --learners ppo ppo_set --seeds 0 1 2 --out curves

Each run lies in OUT/ENV/LEARNER/seed_K: configuration.json, curve.csv and checkpoint.zip. The same
command resumes every run from its last evaluation. scripts/dev/draw_curves.py draws the curves.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

from loose_agents.execution.command import command, option
from loose_agents.execution.local_pools import ONE_THREAD, cores
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.rl.end_to_end.training import LEARNERS, Job, train_end_to_end
from loose_agents.rl.hyperparameters import key_values

from loose_env.errors import InvalidSetting
from loose_env.io import Checked, Count, NonNegativeCount


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    """Options of the training."""

    env: tuple[str, ...] = option(("loose_env/Vera-v0",), "environment ids")
    env_kwargs: tuple[str, ...] = option((), "their arguments, key:value")
    learners: tuple[str, ...] = option(("ppo", "ppo_set"), f"of {list(LEARNERS)}")
    seeds: tuple[NonNegativeCount, ...] = option((0, 1, 2, 3, 4), "training seeds")
    processes: Count = option(1, "runs side by side, a process each")
    threads: Count = option(1, "threads of a run's own process")
    workers: Count = option(1, "processes that simulate the arms of a run; 1: its own alone")
    device: str = option("cpu", "device of torch, such as cuda")
    steps: NonNegativeCount = option(0, "steps of a run; 0: those of its hyperparameter file")
    seconds: float = option(0.0, "time of a run in all [s], last evaluation aside; 0: no limit")
    hyperparams: tuple[str, ...] = option(
        (), "hyperparameters, key:value", "--hyperparams", "-params"
    )
    evaluations: Count = option(12, "evaluations of a run")
    eval_episodes: Count = option(200, "episodes of an evaluation, the same in all")
    last_episodes: Count = option(1000, "episodes of the last evaluation")
    out: str = option("curves", "folder of the results")
    restart: bool = option(False, "forget what the folder holds")


def jobs_of(options: Options) -> list[Job]:
    """One job for each environment, learner and seed, seeds innermost."""
    if options.seconds < 0:
        raise InvalidSetting(f"--seconds must be 0 or more, got {options.seconds}")
    unknown = sorted(set(options.learners) - set(LEARNERS))
    if unknown:
        raise InvalidSetting(f"unknown learners {unknown}; learners are {list(LEARNERS)}")
    return [
        Job(
            learner=learner,
            env=env,
            env_kwargs=key_values(options.env_kwargs, "--env-kwargs"),
            hyperparams=key_values(options.hyperparams, "--hyperparams"),
            seed=seed,
            steps=options.steps,
            seconds=options.seconds or None,
            out=options.out,
            device=options.device,
            threads=options.threads,
            workers=options.workers,
            evaluations=options.evaluations,
            eval_episodes=options.eval_episodes,
            last_episodes=options.last_episodes,
            restart=options.restart,
            command=" ".join(sys.argv),
        )
        for env in options.env
        for learner in options.learners
        for seed in options.seeds
    ]


def _say(words: str) -> None:
    print(words, flush=True)


def _work(job: Job) -> str:
    """Run a job in a worker; return the error's line, if there is one."""
    try:
        with errors_in_one_line(f"{job.env} {job.learner} seed {job.seed}"):
            train_end_to_end(job, _say)
    except SystemExit as error:
        return str(error.code)
    return ""


def run(options: Options) -> None:
    """Train all runs, ``processes`` at a time."""
    jobs = jobs_of(options)
    workers = min(options.processes, len(jobs))
    if workers == 1:
        for job in jobs:
            train_end_to_end(job, _say)
        return
    if workers * options.threads > cores():
        print(
            f"learning_curves: note: {workers} processes of {options.threads} threads on "
            f"{cores()} cores",
            file=sys.stderr,
        )
    threads = dict.fromkeys(ONE_THREAD, str(options.threads))
    os.environ.update(threads)  # read by the libraries when a worker imports them
    context: Any = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        errors = [words for words in pool.map(_work, jobs) if words]
    if errors:
        raise InvalidSetting("; ".join(errors))


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    resumes = "the same command resumes every run from its last evaluation"
    command("learning_curves", __doc__, Options, run, arguments, interrupted=resumes)


if __name__ == "__main__":
    main()
