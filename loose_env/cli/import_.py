"""Make a recording of what loggers wrote: MCAP files, tables in text, universal files.

A mapping file says which channel of which file goes into which column of the recording, in which
unit, and by which clock. `loose import --describe FILE...` lists what files hold, and what it
prints is a mapping to fill in.

    loose import --describe robot.mcap vibration.csv > mapping.toml
    loose import robot.mcap vibration.csv --mapping mapping.toml --out recording

The recording is read back and checked before it takes its place: a folder that is there is whole.
Exit codes: 0 done; 1 something given cannot be used, said in one line; 2 the command line makes no
sense; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from loose_env.arms import compile_spec, load_spec
from loose_env.cli.options import add_settings, settings_of
from loose_env.errors import InvalidSetting
from loose_env.importing import ImportSettings, describe_sources, import_recording


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="SOURCE",
        help="file of a logger; NAME=PATH where the mapping calls it NAME",
    )
    parser.add_argument(
        "--describe", action="store_true", help="list the files' channels, as a mapping to fill in"
    )
    parser.add_argument("--mapping", type=Path, metavar="MAP", help="mapping file, .toml or .json")
    parser.add_argument("--out", type=Path, metavar="RECORDING", help="folder of the recording")
    parser.add_argument(
        "--model", type=Path, metavar="MODEL.xml", help="MJCF file in the place of the mapping's"
    )
    parser.add_argument(
        "--package-path",
        type=Path,
        metavar="DIR",
        help="with --describe: folder of the package, or packages, of a URDF's meshes",
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing on the way")
    parser.set_defaults(refuse=parser.error)
    add_settings(parser, ImportSettings)


def run(options: argparse.Namespace) -> None:
    """Import, or describe."""
    if options.describe:
        if options.mapping is not None or options.out is not None:
            options.refuse("--describe takes files alone, and --model")
        model = None
        if options.model is not None:
            if not options.model.is_file():
                raise InvalidSetting(f"there is no model {str(options.model)!r}")
            file, _, spec = load_spec(options.model, package=options.package_path)
            model = compile_spec(spec, file)
        print(describe_sources(options.sources, model), end="")
        return
    if options.mapping is None or options.out is None:
        options.refuse("give --mapping MAP and --out RECORDING, or --describe to see channels")
    recording = import_recording(
        options.sources,
        options.mapping,
        options.out,
        settings_of(options, ImportSettings),
        model=options.model,
        say=_silent if options.quiet else _said,
    )
    print(f"written: {options.out} ({len(recording.runs)} runs)")


def _said(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _silent(_: str) -> None:
    pass
