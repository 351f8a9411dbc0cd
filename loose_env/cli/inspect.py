"""Show what can be expected of a diagnosis of an arm, from its model alone.

Reads an MJCF or URDF file and prints one screen: the joints with ranges, torque limits and drives,
where the accelerometer is thought to sit, the modes of the held arm, a band and a level to shake
each joint with, and for every fault whether it could be found and how small a gap would show.

Nothing is written unless --json names a file. Exit codes: 0 done; 1 something given cannot be
used; 2 the command line makes no sense.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import add_settings, settings_of
from loose_env.instrument import ModelSettings, NextSettings, inspect_model, screen


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="MJCF or URDF of the arm")
    add_settings(parser, ModelSettings, title="the arm as it stands")
    add_settings(
        parser, NextSettings, title="how poses and excitation are chosen", leave_out=("in-turn",)
    )


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Inspect the model and print the result."""
    found = inspect_model(
        options.model, settings_of(options, NextSettings), settings_of(options, ModelSettings)
    )
    return Outcome(text=screen(found), json=found.to_json)
