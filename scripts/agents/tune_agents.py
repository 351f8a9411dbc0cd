"""Tune when agents stop, and which joint the constant policy shakes, on training episodes.

Usage: python scripts/agents/tune_agents.py --env loose_env/Planar-v0 --arguments '{"engine":
"reduced"}'
           --agents amortised/together amortised/constant

Every agent plays the same episodes to the last record; from its trails follows what each stopping
probability would have brought at the environment's prices. Their seed is never one of the
evaluation's, nor that of the record banks. Results go to
agents/loose_agents/weights/<arm>-<difficulty>.json; agents that were not tuned keep their entries.
Shards of episodes lie in --folder, so the same command goes on after an interruption; no result
depends on the backend.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

# One thread each: the order in which threads add up changes the last digit of a figure.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.benchmark.sharded import problem_of
from loose_agents.benchmark.tuning import (
    Trails,
    best_constant,
    best_threshold,
    single_joints,
    unseen_return,
    write_tuned,
)
from loose_agents.benchmark.tuning_sharded import ORACLE, Player, names_of, play_player, trained
from loose_agents.core.estimators import WEIGHTS, setting_name
from loose_agents.core.seeds import BANK_SEED, TUNING_SEED, check_training_seed
from loose_agents.evaluation.env_arguments import arguments_of
from loose_agents.execution.backends import BackendSettings, add_backend_options
from loose_agents.execution.script_errors import errors_in_one_line

from loose_env.errors import InvalidSetting
from loose_env.evaluation import bootstrap_mean

BOOTSTRAP_SEED = 0
"""Seed of all resamples."""


def line_of(agent: str, trails: Trails, threshold: float) -> str:
    """One line of the table."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    worth = bootstrap_mean(trails.returns(threshold), rng=rng)
    unseen = unseen_return(trails, rng)
    return (
        f"{agent:<34} {threshold:9.4f} {100 * trails.success(threshold).mean():8.1f} "
        f"{1 + trails.ends(threshold).mean():8.2f} {worth.estimate:8.3f} ± {worth.half:.3f} "
        f"{unseen:8.3f}"
    )


def tune(options: argparse.Namespace) -> None:
    """Tune, print the table, write the settings."""
    begin = time.perf_counter()
    check_training_seed(options.seed)
    if options.seed == BANK_SEED:
        raise InvalidSetting(f"seed {BANK_SEED} is the record banks': tune with another")
    if options.episodes < 2 or options.records < 1 or options.shard < 1:
        raise InvalidSetting(
            "give 2 episodes or more, and records and shards of 1 or more; got "
            f"--episodes {options.episodes} --records {options.records} --shard {options.shard}"
        )
    agents = list(dict.fromkeys(options.agents))
    for agent in agents:  # whatever is wrong shows now, not after an hour of play
        names_of(agent)
    arguments = arguments_of(options.arguments)
    problem = problem_of(options.env, arguments)
    candidates = single_joints(problem, options.levels)
    records = min(options.records, problem.settings.max_records)
    posterior = trained(problem)
    stop, lines = {}, []

    def play(agent: str, levels: tuple[int, ...] | None, episodes: int) -> Trails:
        """Trails of the first episodes."""
        player = Player(
            agent=agent,
            levels=levels,
            env_id=options.env,
            arguments=arguments,
            seed=options.seed,
            records=records,
            agent_seed=options.agent_seed,
            posterior=posterior,
        )
        words = agent if levels is None else f"{agent} {list(levels)}"
        print(f"{words}, {episodes} episodes", file=sys.stderr, flush=True)
        return play_player(
            player,
            problem,
            episodes=episodes,
            folder=Path(options.folder),
            settings=BackendSettings.of(options),
            shard=options.shard,
        )

    constant: tuple[int, ...] | None = None
    for agent in agents:
        estimator, policy = names_of(agent)
        levels = None
        if policy == "constant" and estimator != ORACLE:
            if constant is None:  # the first estimator's best serves the others too
                constant = best_constant(
                    candidates, partial(play, agent), episodes=options.episodes
                )
            levels = constant
        trails = play(agent, levels, options.episodes)
        stop[agent] = best_threshold(trails, np.random.default_rng(BOOTSTRAP_SEED))
        words = agent if levels is None else f"{agent} {list(levels)}"
        lines.append(line_of(words, trails, stop[agent]))
    print(
        f"\n{options.env}, {setting_name(problem)}: {options.episodes} training episodes of "
        f"{records} records, seed {options.seed}\n"
    )
    print(
        f"{'agent':<34} {'stop at':>9} {'right %':>8} {'records':>8} {'return':>8} {'':7} "
        f"{'unseen':>8}"
    )
    print("\n".join(lines))
    print("\nreturn: with its 95 % interval; unseen: each half at the other half's threshold.")
    path = Path(options.out) / f"{setting_name(problem)}.json"
    write_tuned(path, stop, constant=constant)
    print(f"Settings: {path}. Took {time.perf_counter() - begin:.0f} s.")


def parser() -> argparse.ArgumentParser:
    """Options of the tuning."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = options.add_argument
    add("--env", default="loose_env/Planar-v0", help="environment id")
    add("--arguments", default='{"engine": "reduced"}', help="its arguments, as JSON")
    add("--agents", nargs="+", required=True, help="estimator/policy, or oracle/policy")
    add("--episodes", type=int, default=4000, help="training episodes for each agent")
    add("--records", type=int, default=12, help="records an episode, at most the rules' own")
    add("--levels", type=int, nargs="+", help="levels tried for the constant policy; default: all")
    add("--seed", type=int, default=TUNING_SEED, help="seed of the training episodes")
    add("--agent-seed", type=int, default=0, help="seed of what agents draw")
    add("--shard", type=int, default=100, help="episodes that a worker plays at a time")
    add("--folder", default="runs/tuning", help="where shards lie")
    add("--out", default=str(WEIGHTS), help="folder of the tuned settings")
    add_backend_options(options)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Tune, with errors in one line."""
    options = parser().parse_args(arguments)
    going_on = "the same command goes on from what was played"
    with errors_in_one_line("tune_agents", interrupted=going_on):
        tune(options)


if __name__ == "__main__":
    main()
