"""Tune stopping thresholds of agents, and excitations of constant and fixed-sequence agents.

The constant policy is given its joint and the fixed one its sequences, all on training episodes.

Usage: python scripts/agents/tune_agents.py --env loose_env/Planar-v0 --arguments '{"engine":
"reduced"}'
           --agents amortised/together amortised/constant

Every agent plays the same episodes to the last record; from its trails follows what each stopping
probability would have brought at the environment's prices. Their seed is never one of the
evaluation's, nor that of the record banks. Results go to
agents/loose_agents/weights/<arm>-<difficulty>.json, with other rules than the usual ones in the
name; agents that were not tuned keep their entries.
Shards of episodes lie in --folder, so the same command goes on after an interruption; no result
depends on the backend.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# One thread each: the order in which threads add up changes the last digit of a figure.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.base import BANK_SEED, TUNING_SEED, check_training_seed
from loose_agents.belief import make_estimator
from loose_agents.evaluation import arguments_of, problem_of
from loose_agents.jobs import BackendSettings
from loose_agents.policies.choice import (
    FIXED_RECORDS,
    OpenLoopPolicy,
    Records,
    designed_sequences,
    drawn_sequences,
    make_policy,
)
from loose_agents.stored import WEIGHTS, tuning_name
from loose_agents.tuning import (
    Player,
    Trails,
    best_sequences,
    best_threshold,
    halved,
    names_of,
    play_player,
    single_joints,
    trained,
    unseen_return,
    write_tuned,
)

from loose_env.cli.command import command
from loose_env.errors import InvalidSetting
from loose_env.evaluation import bootstrap_mean
from loose_env.io import Count, NonNegativeCount

BOOTSTRAP_SEED = 0
"""Seed of all resamples."""
SEQUENCES = 12
"""Sequences of each kind for the fixed policy to choose from."""


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Options of the tuning."""

    env: str = "loose_env/Planar-v0"
    """Environment id."""
    arguments: str = '{"engine": "reduced"}'
    """Its arguments, as JSON."""
    agents: tuple[str, ...]
    """Estimator/policy, or a learned agent."""
    episodes: Count = 4000
    """Training episodes for each agent."""
    records: Count = 12
    """Records an episode, at most the rules' own."""
    seed: NonNegativeCount = TUNING_SEED
    """Seed of the training episodes."""
    folder: str = "runs/tuning"
    """Folder of the shards."""
    out: str = str(WEIGHTS)
    """Folder of the tuned settings; default: the shipped ones."""


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


def tune(options: Options) -> None:
    """Tune, print the table, write the settings."""
    begin = time.perf_counter()
    check_training_seed(options.seed)
    if options.seed == BANK_SEED:
        raise InvalidSetting(f"seed {BANK_SEED} is the record banks': tune with another")
    if options.episodes < 2:
        raise InvalidSetting(f"--episodes must be 2 or more; got {options.episodes}")
    agents = list(dict.fromkeys(options.agents))
    for agent in agents:  # whatever is wrong shows now, not after an hour of play
        names_of(agent)
    arguments = arguments_of(options.arguments)
    problem = problem_of(options.env, arguments)
    records = min(options.records, problem.settings.max_records)
    posterior = trained(problem)
    stop, lines = {}, []

    def play(
        agent: str, episodes: int, *, levels: Any = None, sequence: Records | None = None
    ) -> Trails:
        """Trails of the first episodes, with the levels or records of a policy."""
        player = Player(
            agent=agent,
            levels=levels,
            sequence=sequence,
            env_id=options.env,
            arguments=arguments,
            seed=options.seed,
            records=records,
            posterior=posterior,
        )
        words = agent if levels is None else f"{agent} {list(levels)}"
        print(f"{words}, {episodes} episodes", file=sys.stderr, flush=True)
        return play_player(
            player,
            problem.settings.prices,
            episodes=episodes,
            folder=Path(options.folder),
            settings=options,
        )

    def sequences(estimator: str) -> list[Records]:
        """Sequences to choose from: half of them drawn at random, half designed by the model."""
        made = make_estimator(estimator, problem)
        policy = make_policy("open_loop", problem, made)
        assert isinstance(policy, OpenLoopPolicy)
        drawn = drawn_sequences(problem, SEQUENCES, records, np.random.default_rng(0))
        return drawn + designed_sequences(policy, made, SEQUENCES, records, seed=options.seed)

    constant: tuple[int, ...] | None = None
    fixed: dict[str, Records] | None = None
    for agent in agents:
        estimator, policy = names_of(agent)
        own: dict[str, Any] = {}
        if policy == "constant":
            # The first estimator's best serves the others too.
            constant = constant or halved(
                single_joints(problem),
                lambda levels, count, name=agent: play(name, count, levels=levels),  # type: ignore[misc]
                episodes=options.episodes, keep=2, least=1,
            )[0][0]  # fmt: skip
            own = {"levels": constant}
        if policy == "fixed":
            fixed = fixed or best_sequences(
                sequences(estimator),
                lambda records, count, name=agent: play(name, count, sequence=records),  # type: ignore[misc]
                episodes=options.episodes,
                lengths=min(FIXED_RECORDS, records),
            )
            own = {"sequence": fixed["stopping"]}
        trails = play(agent, options.episodes, **own)
        stop[agent] = best_threshold(trails, np.random.default_rng(BOOTSTRAP_SEED))
        words = f"{agent} {list(constant)}" if constant and policy == "constant" else agent
        lines.append(line_of(words, trails, stop[agent]))
    print(
        f"\n{options.env}, {tuning_name(problem)}: {options.episodes} training episodes of "
        f"{records} records, seed {options.seed}\n"
    )
    print(
        f"{'agent':<34} {'stop at':>9} {'right %':>8} {'records':>8} {'return':>8} {'':7} "
        f"{'unseen':>8}"
    )
    print("\n".join(lines))
    print("\nreturn: with its 95 % interval; unseen: each half at the other half's threshold.")
    path = Path(options.out) / f"{tuning_name(problem)}.json"
    write_tuned(path, stop, constant=constant, fixed=fixed)
    print(f"Settings: {path}. Took {time.perf_counter() - begin:.0f} s.")


def main(arguments: Sequence[str] | None = None) -> None:
    """Tune, with errors in one line."""
    going_on = "the same command goes on from what was played"
    command("tune_agents", __doc__, Options, tune, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
