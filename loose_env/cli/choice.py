"""Options that hold for a session: what is not given is as it was."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from dataclasses import asdict, fields
from typing import Any

from loose_env.cli.options import add_settings
from loose_env.instrument import NextSettings, option_words, unlike


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options of how the next measurement is chosen; one that is not given is None."""
    add_kept(parser, NextSettings, title="poses and excitation")


def add_kept(
    parser: argparse.ArgumentParser, kind: type, *, title: str, only: Collection[str] | None = None
) -> None:
    """Add the options of some settings; one that is not given is None.

    Parameters
    ----------
    parser : ArgumentParser
        Takes the options.
    kind : type
        A settings dataclass.
    title : str
        Heading in the help.
    only : collection of str, optional
        Fields that are kept in this way; all by default.
    """
    add_settings(parser, kind, title=title)
    names = [each.name for each in fields(kind)]
    parser.set_defaults(**{name: None for name in names if only is None or name in only})


def take_over(
    options: argparse.Namespace, before: Any, whose: str, *, only: Collection[str] | None = None
) -> None:
    """Set the options that were not given, and report those that differ from their defaults.

    Parameters
    ----------
    options : Namespace
        What was parsed.
    before : dataclass
        Settings that hold where nothing is given.
    whose : str
        Where they come from, for the words.
    only : collection of str, optional
        Fields that are taken over; all by default.
    """
    there = {n: v for n, v in asdict(before).items() if only is None or n in only}
    taken = {n: v for n, v in there.items() if getattr(options, n) is None}
    for name, value in taken.items():
        setattr(options, name, value)
    words = option_words({n: v for n, v in unlike(before, type(before)()).items() if n in taken})
    if words:
        print(f"note: as {whose} has it:{words}", file=sys.stderr)
