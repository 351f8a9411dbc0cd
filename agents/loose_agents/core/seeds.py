"""Seeds and random streams of the agents: one table, so that no two uses meet."""

from __future__ import annotations

from loose_env.errors import InvalidSetting

__all__ = [
    "BANK_ACTIONS",
    "BANK_SEED",
    "BENCHMARK_SEED",
    "CURVE_SEED",
    "EVALUATION_SEED",
    "EVALUATION_SEEDS",
    "TUNING_SEED",
    "check_training_seed",
]

EVALUATION_SEEDS = range(20_260_000, 20_260_100)
"""Seeds of episodes that no training, tuning or record bank may use."""
EVALUATION_SEED = EVALUATION_SEEDS[0]
"""Seed of the episodes that published comparisons are played on."""
CURVE_SEED = EVALUATION_SEEDS[50]
"""Seed of the episodes that learning curves are measured on, apart from the comparisons'."""
BENCHMARK_SEED = EVALUATION_SEEDS[60]
"""Seed of the benchmark's test set; those of its further sets follow."""
TUNING_SEED = 20_080_000
"""Seed of the episodes on which stopping thresholds are tuned."""
BANK_SEED = 19_950_000
"""Seed of the episodes of record banks."""

BANK_ACTIONS = 16
"""Stream of an episode for random actions, beyond those the environment uses."""


def check_training_seed(seed: int) -> int:
    """Return a seed for training; refuse evaluation seeds.

    Raises
    ------
    InvalidSetting
        If it is reserved for evaluation.

    Examples
    --------
    >>> check_training_seed(1)
    1
    """
    if seed in EVALUATION_SEEDS:
        raise InvalidSetting(
            f"seed {seed} is one of those kept for evaluation, {EVALUATION_SEEDS[0]} to "
            f"{EVALUATION_SEEDS[-1]}; train with another"
        )
    return seed
