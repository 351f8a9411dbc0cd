"""How the next measurement is chosen, as options: what is not given is as it was in the session."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, fields

from loose_env.cli.options import add_settings
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.option_words import option_words, unlike

__all__ = ["add_choice", "take_over"]


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options; one that is not given is None."""
    add_settings(parser, NextSettings, title="how poses and excitation are chosen")
    parser.set_defaults(**dict.fromkeys((each.name for each in fields(NextSettings)), None))


def take_over(options: argparse.Namespace, before: NextSettings, whose: str) -> None:
    """Set the options that were not given, and say which of them are not the usual ones.

    Parameters
    ----------
    options : Namespace
        What was parsed.
    before : NextSettings
        What holds where nothing is given.
    whose : str
        Where that comes from, for the words.
    """
    taken = {n: v for n, v in asdict(before).items() if getattr(options, n) is None}
    for name, value in taken.items():
        setattr(options, name, value)
    words = option_words({n: v for n, v in unlike(before, NextSettings()).items() if n in taken})
    if words:
        print(f"note: as {whose} has it:{words}", file=sys.stderr)
