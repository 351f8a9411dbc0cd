"""Fit the realised share of the expected information gain, on held-out records of a bank.

Usage: python scripts/agents/fit_information.py --env loose_env/Planar-v0 --out banks/planar4

The bank must be there (scripts/agents/build_bank.py), and a posterior trained on it
(scripts/agents/train_posterior.py). The factors go to
agents/loose_agents/weights/<arm>-<difficulty>.json, where the greedy policy reads them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.belief import WEIGHTS, make_estimator, tuning_name
from loose_agents.posterior_training import fit_factors, transitions_of
from loose_agents.record_bank import BankOptions, read_bank
from loose_agents.tuning import write_tuned

from loose_env.cli.command import command

SHARDS = 4
"""Shards of the bank that are read; the posterior was not trained on the first ones."""


def fit(options: BankOptions) -> None:
    """Fit, store, and print what was expected and what came true."""
    plan = options.plan
    problem = plan.problem()
    posterior: Any = make_estimator("amortised", problem).posterior
    bank = read_bank(plan, Path(options.out), plan.shards[:SHARDS])
    found = transitions_of(problem, posterior, bank, np.random.default_rng(0))
    factors = fit_factors(found)
    path = WEIGHTS / f"{tuning_name(problem)}.json"
    write_tuned(path, {}, information=asdict(factors))
    print(f"{'joints shaken':<16}{'records':>9}{'expected':>10}{'came true':>11}  [nat]")
    count = found.excited.sum(1)
    groups = [
        (name, found.excited[:, j] & (count == 1)) for j, name in enumerate(problem.arm.joints)
    ]
    for name, rows in [*groups, ("all", count == problem.arm.n)]:
        if rows.any():
            expected, gained = found.expected[rows].mean(), found.gained[rows].mean()
            print(f"{name:<16}{rows.sum():>9}{expected:>10.3f}{gained:>11.3f}")
    print(f"\n{factors}\nStored in {path}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, with errors in one line."""
    command("fit_information", __doc__, BankOptions, fit, arguments)


if __name__ == "__main__":
    main()
