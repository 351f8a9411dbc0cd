"""Predict from the model of an arm alone which faults a diagnosis could find.

Reads an MJCF or URDF file and prints one screen: the joints with ranges, torque limits and drives;
the assumed location of the accelerometer; the modes of the held arm; band and level to excite each
joint with; for every fault whether it is detectable, and the smallest detectable free travel.

Nothing is written unless --json names a file.

    loose inspect arm.xml
    loose inspect arm.urdf --tool flange --payload-kg 1.5 --json -
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
    add_settings(parser, ModelSettings, title="arm")
    add_settings(parser, NextSettings, title="poses and excitation", leave_out=("in-turn",))


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Inspect the model and print the result."""
    found = inspect_model(
        options.model, settings_of(options, NextSettings), settings_of(options, ModelSettings)
    )
    return Outcome(text=screen(found), json=found.to_json)
