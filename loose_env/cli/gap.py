"""Identify the effects that a simulation model lacks, and where, from measured runs.

Reads a recording: a folder with recording.json, the nominal model and two measured runs at least.
Finds where model and measurement disagree, accepts the effects that improve the prediction of
held-out runs significantly, and writes the corrected model.

Written to the output folder: model.xml, the corrected model; report.html, to be read; result.json,
the same for programs. Finished stages are kept in .gap: after an interruption the same command
goes on from there.

    loose gap arm --out arm-gap
    loose gap arm --out arm-gap --kinds coulomb_friction backlash
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from loose_env.arms import files_of
from loose_env.cli.console import Console, Outcome, add_recording_options, folder_of
from loose_env.cli.doctor import add_preflight, check_first
from loose_env.cli.options import add_settings, settings_of
from loose_env.gap import (
    GapSettings,
    Stages,
    find_gap,
    key_of,
    read_effects,
    write_gap,
)
from loose_env.recording import read_recording
from loose_env.report import gap_text, write_gap_report

_OWN = ("threads",)
"""Settings on which the result does not depend."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser)
    add_preflight(parser)
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="Python file with effects of your own, considered beside the catalogue; it is run",
    )
    add_settings(parser, GapSettings)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Name what the model lacks and write it down."""
    settings = settings_of(options, GapSettings)
    folder = folder_of(options)
    recording = read_recording(options.recording, model=options.model)
    preflight = check_first(recording, options)
    plain = {k: v for k, v in asdict(settings).items() if k not in _OWN}
    for file in options.effects:
        read_effects(file)
        plain[f"effects of {file}"] = file.read_text(encoding="utf-8")
    with folder.worked_in() as kept:
        stages = Stages(kept / "stages", key_of(recording, plain))
        found = find_gap(recording, settings, say=console.say, stages=stages)
        found = replace(found, preflight=preflight)
    if stages.taken_up:
        console.say(f"resumed from checkpoints: {', '.join(stages.taken_up)}")
    # Known as this command's own even if it is cut short while it copies.
    home = recording.model_path.parent
    folder.note(folder.path / f.relative_to(home) for f in files_of(recording.model_path))
    report = partial(write_gap_report, say=console.say)
    result, written = write_gap(folder.path, found, report=report, say=console.say)
    folder.note(written)
    shown = [str(path) for path in written if path.parent == folder.path]
    return Outcome(
        text=f"{gap_text(result, warnings=False)}\nwritten: {', '.join(shown)}",
        json=result.to_json,
        warnings=tuple(result.warnings),
    )
