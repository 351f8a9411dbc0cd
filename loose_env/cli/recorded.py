"""Options, output folder and progress of the commands on a recording."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from loose_env.cli.output_folder import OutputFolder
from loose_env.errors import InvalidSetting


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add RECORDING, --out, --model and --quiet."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for what is written"
    )
    parser.add_argument(
        "--model",
        type=Path,
        metavar="OTHER.xml",
        help="MJCF file that takes the place of the recording's model",
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing on the way")


def folder_of(options: argparse.Namespace) -> OutputFolder:
    """Output folder, in which the other model must not lie.

    Raises
    ------
    InvalidSetting
        If it does, or the folder cannot be used.
    """
    folder = OutputFolder(options.out, options.command)
    if options.model is not None and options.model.resolve().is_relative_to(folder.path):
        raise InvalidSetting(
            f"--model {options.model} lies in the output folder, where it would be overwritten; "
            "give another --out"
        )
    return folder


class Said:
    """Progress lines on the error stream, with the time that has passed."""

    def __init__(self, *, quiet: bool) -> None:
        self.quiet, self.start = quiet, time.monotonic()

    def __call__(self, line: str) -> None:
        """Say a line, unless asked to be quiet."""
        if not self.quiet:
            print(f"{time.monotonic() - self.start:7.1f} s  {line}", file=sys.stderr, flush=True)
