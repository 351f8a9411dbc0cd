"""Check the size of the classical method's test: what errors make of records of healthy arms.

Takes records of healthy arms in random poses, all joints shaken at the top level, or random ones
where the rules allow fewer. Prints the squared change of single records over its expectation by the
error model, and the share of arms that stand out at a probability after each further record. Both
columns of a right test read 1.00 and its probability.

Usage: python scripts/studies/checks/healthy_change.py --env loose_env/StoppingTier-v0 --arms 60
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.base import check_training_seed
from loose_agents.comparison import problem_of
from loose_agents.evaluation import arguments_of
from loose_agents.execution.command import command, option

from loose_env.diagnosis import PlaceDirections, PooledScatter, RecordScatter
from loose_env.envs import EpisodeBatch, difficulty_named
from loose_env.io import Count
from loose_env.wrappers import record_from

LEVELS = (0.1, 0.05, 0.01)
"""Probabilities at which arms are tested [1]."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the check."""

    env: tuple[str, ...] = option(("loose_env/StoppingTier-v0",), "environment ids")
    arguments: str = option('{"engine": "reduced"}', "their arguments, as JSON")
    arms: Count = option(60, "healthy arms of each")
    records: Count = option(3, "records of each arm")
    seed: int = option(11, "seed of the arms and of the records")


def size_of(record: RecordScatter) -> float:
    """Squared change of a record over its expectation by the error model [1]."""
    covariance = np.linalg.inv(record.precision) + record.shared.T @ record.shared
    change = record.measured
    return float(change @ np.linalg.solve(covariance, change)) / len(change)


def check(options: Options) -> None:
    """Measure and print a line for each number of records."""
    check_training_seed(options.seed)
    shares = "".join(f"{f'p < {level}':>10}" for level in LEVELS)
    print(f"{'env':28}{'records':>8}{'change':>8}{shares}")
    for env in options.env:
        problem = problem_of(env, arguments_of(options.arguments))
        arm, rules, rng = problem.arm, problem.settings, np.random.default_rng(options.seed)
        mismatch = difficulty_named(rules.difficulty).mismatch
        places = PlaceDirections(problem.linear, rules.sensors, mismatch)
        batch = EpisodeBatch(arm, rules, num=options.arms, threads=1)
        pools = [PooledScatter.none(places, outlier=1.0) for _ in range(options.arms)]
        for k in range(options.arms):
            batch.start(k, seed=options.seed, number=k, options={"fault": "healthy"})
        for taken in range(options.records):
            actions = []
            for k in range(options.arms):
                pose = problem.layout.pose_of(batch.observe(k))
                allowed = problem.actions.allowed_moves(pose)
                moves = np.array([rng.choice(np.flatnonzero(row)) for row in allowed])
                on = rng.permutation(arm.n) < problem.actions.most_excited
                levels = np.where(on, len(arm.levels), 0)
                actions.append(problem.actions.encode(moves=moves, levels=levels))
            batch.step(list(range(options.arms)), actions)
            sizes = []
            for k in range(options.arms):
                record = record_from(problem.layout, batch.observe(k), taken)
                if record is not None:
                    seen = places.of(record)
                    sizes.append(size_of(seen))
                    pools[k] = pools[k].after(seen)
            chances = np.array([pool.chance(rng) for pool in pools])
            cells = "".join(f"{np.mean(chances < level):10.3f}" for level in LEVELS)
            print(f"{env:28}{taken + 1:>8}{np.mean(sizes):8.2f}{cells}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Check, with errors in one line."""
    command("healthy_change", __doc__, Options, check, arguments)


if __name__ == "__main__":
    main()
