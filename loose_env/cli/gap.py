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

With --next also the motion that best separates what the runs do not tell apart: next_motion.csv and
next_motion.parquet, its commands; next_motion.json, what it is expected to tell and how it was
chosen. Run it on the machine, twice, and give the new recording beside the earlier output: the
answer is then from all runs.

    loose gap arm --out arm-gap --next
    loose gap arm-gap arm-2 --out arm-gap-2 --next
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from loose_env.arms import files_of
from loose_env.cli.console import Console, Outcome, add_recording_options, folder_of
from loose_env.cli.doctor import add_preflight, check_first
from loose_env.cli.options import add_kept, add_settings, settings_of, take_over
from loose_env.cli.output_folder import KEPT, OutputFolder
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    NEXT_MOTION,
    NO_MOTION,
    GapResult,
    GapSettings,
    NextMotionSettings,
    Stages,
    find_gap,
    join_recordings,
    key_of,
    next_motion_lines,
    note_source,
    quick_look,
    read_effects,
    read_next_motion,
    read_source,
    write_gap,
)
from loose_env.io import write_text
from loose_env.recording import Recording
from loose_env.report import (
    gap_text,
    quick_text,
    require_rerun,
    write_gap_report,
    write_rerun,
)

_OWN = ("threads",)
"""Settings on which the result does not depend."""
_KEPT = tuple(each.name for each in fields(GapSettings) if each.name != "held_out")
"""Settings that hold on for an earlier output with further recordings."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser)
    parser.add_argument(
        "more",
        type=Path,
        nargs="*",
        metavar="MORE",
        help="further recordings of the same machine, compared together with the first; RECORDING "
        "may be the output of an earlier run then, whose answer and settings are gone on from",
    )
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
    parser.add_argument(
        "--next",
        action="store_true",
        help="also write the motion that best separates what these runs do not tell apart",
    )
    add_kept(parser, GapSettings, title="settings", only=_KEPT)
    add_settings(parser, NextMotionSettings, title="next motion (--next)")


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Name what the model lacks and write it down."""
    if options.quick and options.next:
        raise InvalidSetting(
            "--quick names nothing, so that there is nothing for --next to separate"
        )
    if options.quick and options.rerun is not None:
        raise InvalidSetting(
            "--quick corrects no model, so that it has no motion for --rerun; leave one of them out"
        )
    _check_rerun(options.rerun)
    wanted = settings_of(options, NextMotionSettings) if options.next else None
    folder = folder_of(options)
    sources = [read_source(path, KEPT, model=options.model) for path in _given(options, folder)]
    earlier = sources[0].result
    before = GapSettings() if earlier is None else _settings_of(earlier)
    take_over(options, before, str(options.recording), only=_KEPT)
    settings = settings_of(options, GapSettings)
    recording = sources[0].recording
    if len(sources) > 1:
        recording, held = join_recordings(
            folder.prepared(), sources, share=settings.held_share, held_out=settings.held_out
        )
        settings = replace(settings, held_out=held)
    preflight = check_first(recording, options)
    for file in options.effects:
        read_effects(file)
    if options.quick:
        return _quick(folder, recording, settings, console)
    plain = {k: v for k, v in asdict(settings).items() if k not in _OWN}
    for file in options.effects:
        plain[f"effects of {file}"] = file.read_text(encoding="utf-8")
    if earlier is not None:
        plain["earlier result"] = earlier.to_json()
    with folder.worked_in() as kept:
        stages = Stages(kept / "stages", key_of(recording, plain))
        note_source(kept, recording, options.model)
        found = find_gap(recording, settings, say=console.say, stages=stages, earlier=earlier)
        found = replace(found, preflight=preflight)
    if stages.taken_up:
        console.say(f"resumed from checkpoints: {', '.join(stages.taken_up)}")
    # Known as this command's own even if it is cut short while it copies.
    home = recording.model_path.parent
    folder.note(folder.path / f.relative_to(home) for f in files_of(recording.model_path))
    report = partial(write_gap_report, say=console.say)
    result, written = write_gap(
        folder.path, found, report=report, say=console.say, next_motion=wanted, earlier=earlier
    )
    if options.rerun is not None:
        console.say("writing the motion for Rerun")
        file = write_rerun(options.rerun.resolve(), found)
        written = [*written, file] if file.is_relative_to(folder.path) else written
    folder.note(written)
    shown = [str(path) for path in written if path.parent == folder.path]
    if options.rerun is not None and str(options.rerun.resolve()) not in shown:
        shown.append(str(options.rerun))
    motion = _next(folder.path, result) if options.next else []
    return Outcome(
        text="\n".join([gap_text(result, warnings=False), *motion, f"written: {', '.join(shown)}"]),
        json=result.to_json,
        warnings=tuple(result.warnings),
    )


def _given(options: argparse.Namespace, folder: OutputFolder) -> list[Path]:
    """Recordings of the command line, none of them twice or in the output folder.

    Raises
    ------
    InvalidSetting
        If one is.
    """
    paths = [options.recording, *options.more]
    places = [path.resolve() for path in paths]
    for k, (path, place) in enumerate(zip(paths, places, strict=True)):
        if place in places[:k]:
            raise InvalidSetting(f"{path} is given twice; give each recording once")
        if place == folder.path:
            raise InvalidSetting(
                f"--out {options.out} is {path} itself, which would be overwritten; give another "
                "folder"
            )
        if k and path.is_file():
            raise InvalidSetting(
                f"{path} is a file; further recordings are folders, and a model is --model {path}"
            )
    return paths


def _settings_of(result: GapResult) -> GapSettings:
    """Settings of an earlier result; the defaults for those that it does not have."""
    known = {each.name for each in fields(GapSettings)}
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in result.settings.items()
        if name in known and name != "held_out"
    }
    return GapSettings(**given)


def _next(folder: Path, result: GapResult) -> list[str]:
    """Lines on the next motion."""
    file = folder / f"{NEXT_MOTION}.json"
    if not file.is_file():
        if any(words.startswith(NO_MOTION) for words in result.warnings):
            return ["next motion: none, for the reason in the warnings"]
        return ["next motion: none; nothing is left that a motion would tell apart"]
    return next_motion_lines(read_next_motion(file))


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
