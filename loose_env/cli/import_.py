"""Make a recording from logs: ROS 2 bags, tables, LeRobot and robomimic datasets and others.

A mapping file says which channel of which file goes into which column of the recording, in which
unit, and by which clock. --guess proposes one by names, ranges and correlations, with the reason
for each line, and writes it for you to check. --describe lists the channels of files and prints a
mapping to fill in.

    loose import --guess robot.mcap --model arm.xml --mapping mapping.toml
    loose import robot.mcap --mapping mapping.toml --out recording
    loose import --describe robot.mcap vibration.csv > mapping.toml

The recording is read back and checked before it takes its final name: a folder of that name is
always complete.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mujoco

from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import add_settings, settings_of
from loose_env.errors import InvalidSetting
from loose_env.importing import (
    FileList,
    ImportSettings,
    Proposal,
    describe_sources,
    import_recording,
    list_sources,
    proposal_text,
    propose,
)
from loose_env.io import json_text, write_text
from loose_env.recording import Recording, load_model

IMPORTED, DESCRIBED, PROPOSAL = "loose-import/1", "loose-sources/1", "loose-proposal/1"
"""Formats of the JSON documents of an import, of --describe, and of --guess."""
PROPOSED = "mapping.toml"
"""File that --guess writes where --mapping names none."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="SOURCE",
        help="file or folder of a log; NAME=PATH where the mapping calls it NAME",
    )
    parser.add_argument(
        "--guess",
        action="store_true",
        help="propose the mapping for --model, print it and write it to --mapping "
        f"({PROPOSED} by default)",
    )
    parser.add_argument(
        "--rate-hz",
        type=float,
        metavar="HZ",
        help="with --guess: sampling rate of files without times [Hz]",
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
        help="with --describe or --guess: folder of the package, or packages, of a URDF's meshes",
    )
    parser.set_defaults(refuse=parser.error)
    add_settings(parser, ImportSettings)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Import, describe, or propose a mapping."""
    if options.describe and options.guess:
        options.refuse("give --describe or --guess, not both")
    if options.describe:
        return _described(options)
    if options.guess:
        return _guessed(options, console)
    if options.rate_hz is not None:
        options.refuse("--rate-hz is for --guess; a mapping has time = { rate_hz = ... }")
    if options.mapping is None or options.out is None:
        options.refuse("give --mapping MAP and --out RECORDING, or --describe or --guess")
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
    model = None if options.model is None else _model(options)
    sources = {name: listed(each) for name, each in list_sources(options.sources).items()}
    return Outcome(
        text=describe_sources(options.sources, model),
        json=lambda: json_text({"format": DESCRIBED, "sources": sources}),
    )


def _guessed(options: argparse.Namespace, console: Console) -> Outcome:
    """Proposed mapping, written to a file and as JSON."""
    if options.model is None or options.out is not None:
        options.refuse("--guess takes files, --model and the --mapping to write, no --out")
    if options.rate_hz is not None and not 1e-6 <= options.rate_hz <= 1e9:
        raise InvalidSetting(f"--rate-hz is from 1e-6 to 1e9 Hz, got {options.rate_hz:g}")
    target: Path = options.mapping or Path(PROPOSED)
    if target.suffix.lower() != ".toml":
        raise InvalidSetting(f"--mapping {str(target)!r}: a proposal is written as .toml")
    if target.exists() and not options.overwrite:
        raise InvalidSetting(
            f"{str(target)!r} is there already; --overwrite replaces it, or name another file by "
            "--mapping"
        )
    proposal = propose(options.sources, _model(options), options.rate_hz)
    model, home = options.model.resolve(), target.resolve().parent
    beside = model.relative_to(home).as_posix() if model.is_relative_to(home) else ""
    text = proposal_text(proposal, beside)
    write_text(target, text)
    taken = [each for each in proposal.columns if not each.open]
    console.say(f"written: {target}, {len(taken)} columns; check each line before the import")
    return Outcome(
        text=text,
        json=lambda: json_text({"format": PROPOSAL, **proposed(proposal, target)}),
    )


def proposed(proposal: Proposal, target: Path) -> dict[str, Any]:
    """Lines of a proposal, each with its reason."""
    columns = [
        {
            "column": each.column or None,
            "source": each.candidate.source,
            "topic": each.candidate.key.topic or None,
            "channel": each.candidate.key.channel,
            "unit": each.scaling.unit or None,
            "scale": each.scaling.scale,
            "sign": each.sign,
            "offset": each.scaling.offset,
            "complete": not each.open,
            "reason": each.reason,
        }
        for each in proposal.columns
    ]
    return {"mapping": target, "columns": columns, "notes": list(proposal.notes)}


def _model(options: argparse.Namespace) -> mujoco.MjModel:
    if not options.model.is_file():
        raise InvalidSetting(f"there is no model {str(options.model)!r}")
    return load_model(options.model, package=options.package_path)[1]


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
