"""Train learners from scratch on the raw observation, several seeds, with learning curves.

Usage: python scripts/agents/learning_curves.py --learners ppo ppo_set --seeds 0 1 2 --out curves

Each run lies in OUT/ENV/LEARNER/seed_K: configuration.json, curve.csv and checkpoint.zip. The same
command resumes every run from its last evaluation. `--draw FIGURE` draws the curves of OUT when
all runs are through, mean over the seeds with its 95 % confidence interval (Student's t), and
prints the table of the last evaluations; `--seeds` without a number only draws.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from loose_agents.rl.hyperparameters import (
    HYPERPARAMETERS,
    algorithm_named,
    key_values,
    read_hyperparameters,
    whole,
)
from scipy.stats import t as student
from tyro.conf import arg

from loose_env.cli.command import command, one_of
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import Count, NonNegative, NonNegativeCount
from loose_env.report import AGENTS as PALETTE
from loose_env.typing import Array
from scripts.charts import Panel, chart, curve, save

LEARNERS = {
    "ppo": ("ppo", "ppo", "flat"),
    "maskable_ppo": ("maskable_ppo", "maskable_ppo", "flat"),
    "ppo_set": ("ppo", "ppo_set", "set"),
    "maskable_ppo_set": ("maskable_ppo", "maskable_ppo_set", "set"),
}
"""Learners: algorithm, hyperparameter file, and layers on the flat observation or a set network."""
SHOWN = {
    "mean_return": ("mean return", (-1.0, 1.0)),
    "right": ("share right", (0.0, 1.0)),
    "unsure": ("share unsure", (0.0, 1.0)),
    "records_per_episode": ("records an episode", (0.0, None)),
}
"""Columns of the curves, their words and the ends of their axis: bands of few seeds are wide."""

Curves = dict[str, dict[str, list[list[Any]]]]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the training."""

    env: tuple[str, ...] = ("loose_env/Vera-v0",)
    """Environment ids."""
    env_kwargs: tuple[str, ...] = ()
    """Their arguments, key:value."""
    learners: tuple[Annotated[str, one_of(tuple(LEARNERS))], ...] = ("ppo", "ppo_set")
    """Learners."""
    seeds: tuple[NonNegativeCount, ...] = (0, 1, 2, 3, 4)
    """Training seeds; none: only draw."""
    device: str = "cpu"
    """Device of torch, such as cuda."""
    steps: NonNegativeCount = 0
    """Steps of a run; 0: those of its hyperparameter file."""
    seconds: NonNegative = 0.0
    """Time of a run in all [s], last evaluation aside; 0: no limit."""
    hyperparams: Annotated[tuple[str, ...], arg(aliases=["-params"])] = ()
    """Hyperparameters, key:value."""
    evaluations: Count = 12
    """Evaluations of a run."""
    eval_episodes: Count = 200
    """Episodes of an evaluation, the same in all."""
    last_episodes: Count = 1000
    """Episodes of the last evaluation."""
    out: Path = Path("curves")
    """Folder of the results."""
    restart: bool = False
    """Forget what the folder holds."""
    draw: Path | None = None
    """Figure of the curves of OUT (.svg)."""


def train_one(env: str, learner: str, seed: int, options: Options) -> None:
    """Train or resume one run."""
    algorithm, file, network = LEARNERS[learner]
    algorithm_named(algorithm)  # says which extra is missing
    from loose_agents.rl import training

    given = read_hyperparameters(HYPERPARAMETERS / f"{file}.yml", env)
    given |= key_values(options.hyperparams, "--hyperparams")
    arguments = given.pop("env_kwargs", {}) | {"threads": 1}
    wrappers = [each.rpartition(".")[2] for each in given.pop("env_wrapper", [])]
    prices = given.pop("training_prices", {})
    steps = options.steps or whole(given.get("n_timesteps", 0), "n_timesteps")
    name = f"{env} {learner} seed {seed}"
    training.train(
        training.Training(
            algorithm=algorithm,
            estimator=None,
            network=network,  # type: ignore[arg-type]
            env=env,
            arguments=arguments | key_values(options.env_kwargs, "--env-kwargs"),
            hyperparameters=given,
            wrappers=tuple(wrappers),
            training_prices=prices,
            steps=steps,
            seconds=options.seconds or None,
            seed=seed,
            evaluations=options.evaluations,
            eval_episodes=options.eval_episodes,
            last_episodes=options.last_episodes,
            eval_width=128,
            save_freq=steps // options.evaluations,
            device=options.device,
            folder=options.out / env.replace("/", "-") / learner / f"seed_{seed}",
            restart=options.restart,
        ),
        say=lambda words: print(f"{name}: {words}", flush=True),
        show=lambda steps, words: print(f"{name}: {steps} steps, {words}", flush=True),
        learner=learner,
        command=" ".join(sys.argv),
    )


def train(options: Options) -> None:
    """Train all runs, then draw."""
    runs = [(e, k, s) for e in options.env for k in options.learners for s in options.seeds]
    for run in runs:
        train_one(*run, options)
    if options.draw is not None:
        curves = read_curves(options.out)
        print(table(curves))
        draw(curves, options.draw)
        print(f"Figure: {options.draw}")
    elif not runs:
        raise InvalidSetting("no seeds and no --draw: nothing to do")


def read_curves(folder: Path) -> Curves:
    """Curves of each environment, learner and seed."""
    from loose_agents.rl.training import read_curve

    found: Curves = {}
    for path in sorted(folder.glob("*/*/seed_*/curve.csv")):
        if points := read_curve(path):
            env, learner = path.parts[-4:-2]
            # A folder's name cannot hold the id's stroke.
            found.setdefault(env.replace("-", "/", 1), {}).setdefault(learner, []).append(points)
    if not found:
        raise InvalidData(f"{folder} holds no curves ENV/LEARNER/seed_K/curve.csv")
    return found


def mean_and_half(values: Array) -> tuple[Array, Array]:
    """Mean over seeds (seeds, ...) and half width of its 95 % interval; NaN for a single seed."""
    count = len(values)
    if count == 1:
        return values[0], np.full(values.shape[1:], np.nan)
    error = values.std(axis=0, ddof=1) / np.sqrt(count)
    return values.mean(axis=0), student.ppf(0.975, count - 1) * error


def band(seeds: list[list[Any]], name: str) -> tuple[Array, Array, Array]:
    """Records taken, mean and half width, over the range that all seeds have reached."""
    places = [np.array([p.records for p in points], dtype=float) for points in seeds]
    grid = np.linspace(max(x[0] for x in places), min(x[-1] for x in places), 60)
    curves = zip(places, seeds, strict=True)
    values = [np.interp(grid, x, [getattr(p, name) for p in points]) for x, points in curves]
    return grid, *mean_and_half(np.array(values))


def table(curves: Curves) -> str:
    """The last evaluation of each learner, mean over the seeds with its 95 % interval."""
    columns = (
        ("mean_return", 1, "+.3f"), ("right", 100, ".1f"), ("unsure", 100, ".1f"),
        ("records_per_episode", 1, ".2f"),
    )  # fmt: skip
    lines = [
        "| environment | learner | seeds | records taken | return | right [%] | unsure [%] | "
        "records an episode |",
        "|---" * 8 + "|",
    ]
    for env, learners in curves.items():
        for learner, seeds in learners.items():
            last = [points[-1] for points in seeds]
            cells = [f"{np.mean([p.records for p in last]):.0f}"]
            for name, scale, form in columns:
                mean, half = mean_and_half(np.array([scale * getattr(p, name) for p in last]))
                shown = f" ± {half:{form.lstrip('+')}}" if len(last) > 1 else ""
                cells.append(f"{mean:{form}}{shown}")
            lines.append(f"| {env} | {learner} | {len(seeds)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(curves: Curves, path: Path) -> None:
    """Draw a column for each environment and a row for each quantity."""
    learners = sorted({learner for own in curves.values() for learner in own})
    panels = []
    for name, (words, ends) in SHOWN.items():
        for env, own in curves.items():
            lines = []
            for learner, seeds in own.items():
                grid, mean, half = band(seeds, name)
                values = np.array([mean, mean - half, mean + half])
                colour = PALETTE[learners.index(learner) % len(PALETTE)]
                lines.append(curve(grid / 1000, values, learner, color=colour, linewidth=1.6))
            panels.append(Panel(title=env, up=words, curves=lines, look={"ylim": ends}))
    size = {"columns": len(curves), "width": 4.2 * len(curves), "height": 2.1}
    path.parent.mkdir(parents=True, exist_ok=True)
    save(chart(panels, across="records taken [thousands]", **size), path)  # type: ignore[arg-type]


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, with errors in one line."""
    resumes = "the same command resumes every run from its last evaluation"
    command("learning_curves", __doc__, Options, train, arguments, interrupted=resumes)


if __name__ == "__main__":
    main()
