"""Make a recording from files of loggers: MCAP, tables in text, universal files (UFF 58).

A mapping file says which channel of which file goes into which column of the recording, in which
unit, and by which clock. --describe lists the channels of files and prints a mapping to fill in.

    loose import --describe robot.mcap vibration.csv > mapping.toml
    loose import robot.mcap vibration.csv --mapping mapping.toml --out recording

The recording is read back and checked before it takes its final name: a folder of that name is
always complete.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from loose_env.arms import compile_spec, load_spec
from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import add_settings, settings_of
from loose_env.errors import InvalidSetting
from loose_env.importing import (
    FileList,
    ImportSettings,
    describe_sources,
    import_recording,
    list_sources,
)
from loose_env.io import json_text
from loose_env.recording import Recording

IMPORTED, DESCRIBED = "loose-import/1", "loose-sources/1"
"""Formats of the JSON documents of an import, and of --describe."""


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
    parser.set_defaults(refuse=parser.error)
    add_settings(parser, ImportSettings)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Import, or describe."""
    if options.describe:
        return _described(options)
    if options.mapping is None or options.out is None:
        options.refuse("give --mapping MAP and --out RECORDING, or --describe to see channels")
    recording = import_recording(
        options.sources,
        options.mapping,
        options.out,
        settings_of(options, ImportSettings),
        model=options.model,
        say=console.say,
    )
    return Outcome(
        text=f"written: {options.out} ({len(recording.runs)} runs)",
        json=lambda: json_text({"format": IMPORTED, **contents(recording)}),
    )


def _described(options: argparse.Namespace) -> Outcome:
    """Channels of the files, as a mapping to fill in and as JSON."""
    if options.mapping is not None or options.out is not None:
        options.refuse("--describe takes files and --model only")
    model = None
    if options.model is not None:
        if not options.model.is_file():
            raise InvalidSetting(f"there is no model {str(options.model)!r}")
        file, _, spec = load_spec(options.model, package=options.package_path)
        model = compile_spec(spec, file)
    sources = {name: listed(each) for name, each in list_sources(options.sources).items()}
    return Outcome(
        text=describe_sources(options.sources, model),
        json=lambda: json_text({"format": DESCRIBED, "sources": sources}),
    )


def listed(source: FileList) -> dict[str, Any]:
    """Streams and channels of a file; what its kind does not say is null."""
    streams = [
        {
            "topic": stream.topic,
            "samples": stream.samples or None,
            "seconds": stream.seconds,
            "rate_hz": stream.rate_hz,
            "channels": [
                {"channel": each.key.channel, "unit": each.unit, "first_values": each.first}
                for each in stream.channels
            ],
        }
        for stream in source.streams
    ]
    return {"file": source.name, "kind": source.kind, "streams": streams}


def contents(recording: Recording) -> dict[str, Any]:
    """Contents of a recording: its model, and every run with its columns, length and rate."""
    runs = []
    for run in recording.runs:
        seconds = float(run.time[-1] - run.time[0])
        runs.append(
            {
                "file": run.name,
                "samples": len(run.time),
                "seconds": seconds,
                "rate_hz": (len(run.time) - 1) / seconds if seconds > 0 else None,
                "condition": run.condition,
                "excited": list(run.excited),
                "controls": list(run.controls),
                "sensors": list(run.sensors),
                "torques": list(run.torques),
            }
        )
    return {"recording": recording.folder, "model": recording.model_path, "runs": runs}
