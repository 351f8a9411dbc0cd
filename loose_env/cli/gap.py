"""Identify the effects that a simulation model lacks, and where, from measured runs.

Reads a recording: a folder with recording.json, the nominal model and two measured runs at least.
Finds where model and measurement disagree, accepts the effects that improve the prediction of
held-out runs significantly, and writes the corrected model.

Written to the output folder: model.xml, the corrected model; report.html, to be read; result.json,
the same for programs. Finished stages are kept in .gap: after an interruption the same command
goes on from there.

    loose gap arm --out arm-gap
    loose gap arm --out arm-gap --kinds coulomb_friction backlash
    loose gap arm --out arm-gap --quick
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
from loose_env.cli.output_folder import OutputFolder
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    GapSettings,
    Stages,
    find_gap,
    key_of,
    quick_look,
    read_effects,
    write_gap,
)
from loose_env.io import write_text
from loose_env.recording import Recording, read_recording
from loose_env.report import (
    gap_text,
    quick_text,
    require_rerun,
    write_gap_report,
    write_rerun,
)

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
    parser.add_argument(
        "--rerun",
        type=Path,
        metavar="FILE.rrd",
        help="also write measured, nominal and corrected motion of the held-out runs for the Rerun "
        "viewer (extra rerun); an existing file is replaced",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a look of about half a minute: where the model is wrong and the three most promising "
        "explanations, without tests and intervals; only quick.json is written",
    )
    add_settings(parser, GapSettings)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Name what the model lacks and write it down."""
    settings = settings_of(options, GapSettings)
    if options.quick and options.rerun is not None:
        raise InvalidSetting(
            "--quick corrects no model, so that it has no motion for --rerun; leave one of them out"
        )
    _check_rerun(options.rerun)
    folder = folder_of(options)
    recording = read_recording(options.recording, model=options.model)
    preflight = check_first(recording, options)
    for file in options.effects:
        read_effects(file)
    if options.quick:
        return _quick(folder, recording, settings, console)
    plain = {k: v for k, v in asdict(settings).items() if k not in _OWN}
    for file in options.effects:
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
    if options.rerun is not None:
        console.say("writing the motion for Rerun")
        file = write_rerun(options.rerun.resolve(), found)
        written = [*written, file] if file.is_relative_to(folder.path) else written
    folder.note(written)
    shown = [str(path) for path in written if path.parent == folder.path]
    if options.rerun is not None and str(options.rerun.resolve()) not in shown:
        shown.append(str(options.rerun))
    return Outcome(
        text=f"{gap_text(result, warnings=False)}\nwritten: {', '.join(shown)}",
        json=result.to_json,
        warnings=tuple(result.warnings),
    )


def _quick(
    folder: OutputFolder, recording: Recording, settings: GapSettings, console: Console
) -> Outcome:
    """Rank what may be missing, from windows of the runs."""
    with folder.worked_in():
        look = quick_look(recording, settings, say=console.say)
        file = write_text(folder.path / "quick.json", look.to_json())
    folder.note([file])
    return Outcome(
        text=f"{quick_text(look)}\nwritten: {file}", json=look.to_json, warnings=look.warnings
    )


def _check_rerun(file: Path | None) -> None:
    """Refuse a file of Rerun that cannot be written, before the search."""
    if file is None:
        return
    if file.suffix != ".rrd" or file.is_dir():
        raise InvalidSetting(f"--rerun {file}: give the name of a file that ends with .rrd")
    require_rerun()
