"""Options of the scripts that build and use banks."""

from __future__ import annotations

import argparse

from agents.banks import BankPlan
from agents.env_arguments import arguments_of
from agents.record_bank import BANK_SEED
from loose_env.errors import InvalidSetting

__all__ = ["add_bank_options", "plan_of"]


def add_bank_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which bank is meant."""
    parser.add_argument("--env", default="loose_env/Planar-v0", help="environment id")
    parser.add_argument(
        "--arguments",
        default='{"engine": "reduced"}',
        help="its arguments, as JSON; the engine that simulates among them",
    )
    parser.add_argument("--episodes", type=int, default=12_000, help="episodes of the bank")
    parser.add_argument("--seed", type=int, default=BANK_SEED, help="seed of the episodes")
    parser.add_argument(
        "--directions", type=int, default=0, help="sliding directions of a link, 0: as fits the arm"
    )
    parser.add_argument("--out", default="banks/bank", help="folder of the bank")


def plan_of(options: argparse.Namespace) -> BankPlan:
    """Read the options.

    Raises
    ------
    InvalidSetting
        If the arguments are no JSON object or there are no episodes.
    """
    if options.episodes < 1:
        raise InvalidSetting(f"--episodes must be 1 or more, got {options.episodes}")
    return BankPlan(
        env_id=options.env,
        arguments=arguments_of(options.arguments),
        episodes=options.episodes,
        seed=options.seed,
        directions=options.directions,
    )
