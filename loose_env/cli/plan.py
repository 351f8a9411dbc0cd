"""Say what to measure next: the pose, the joint to shake and the signal to play.

Reads the model of an arm (MJCF or URDF) and what is known so far: nothing at first, then the
result of 'loose diagnose'. Plan, measure and diagnose in turn until the fault has a name.
What a diagnosis asks for next is what is planned; settings of it that are given here (how poses
are chosen, band, length, rate) take the place of its own, and the pose is chosen anew with them.

Written to the output folder: plan.html, what to do at the machine; plan.json, the same for
programs; signal.csv and signal.parquet, a command for every actuator in its own unit; recording,
a folder that the measured run is put into and that 'loose diagnose' reads. A folder of an earlier
plan is gone on with: its measured runs stay, and so do settings that are not given anew. Exit
codes: 0 done; 1 something given cannot be used; 2 the command line makes no sense; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from loose_env.cli.choice import add_choice, add_kept, take_over
from loose_env.cli.options import settings_of
from loose_env.errors import MissingExtra
from loose_env.instrument import (
    KEPT,
    PAGE,
    RECORDING,
    ModelSettings,
    MotionSettings,
    NextSettings,
    PlanFiles,
    PlanSettings,
    plan,
    plan_tool,
    read_diagnosis,
    session_beside,
    tool_runs,
    write_plan,
    write_tool_plan,
)

_PUT = {
    "run": "put the measured run",
    "repeat": "a repeat of the first run at the end, for drift and scatter,",
    "reference": "the same on the healthy machine",
}
"""Kind of a run -> how it is spoken of."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="MJCF or URDF of the arm")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for what is written"
    )
    parser.add_argument(
        "--known",
        type=Path,
        metavar="RESULT",
        help="what is known so far: result.json of 'loose diagnose', or the folder with it",
    )
    add_kept(parser, ModelSettings, title="the arm as it stands")
    add_choice(parser)
    add_kept(parser, MotionSettings, title="limits and commands of the controller")
    add_kept(parser, PlanSettings, title="the next measurement itself", only=KEPT)


def run(options: argparse.Namespace) -> None:
    """Plan the next measurement and write it down."""
    known = None if options.known is None else read_diagnosis(options.known)
    before = session_beside(options.out / RECORDING)
    if known is None or before.is_newer_than(options.known):
        take_over(options, before.choice, "the earlier plan")
    else:
        take_over(options, known.choice, "the diagnosis")
    take_over(options, before.arm, "the earlier plan")
    take_over(options, before.motion, "the earlier plan")
    take_over(options, before.own, "the earlier plan", only=KEPT)
    model, choice = settings_of(options, ModelSettings), settings_of(options, NextSettings)
    own, motion = settings_of(options, PlanSettings), settings_of(options, MotionSettings)
    source = "" if options.known is None else str(options.known)
    if model.excitation == "joint":
        made = plan(options.model, known, arm=model, choice=choice, own=own, motion=motion)
        files = PlanFiles(options.out, made.arm.recording_model.xml)
        planned = files.runs_of(made)
        runs = [one.file for one in planned if one.kind == "run"]
        written = write_plan(files, made, known=source)
        text = _report("summary")(made)
        page = partial(_report("write_plan_page"), files.folder / PAGE, made, runs, planned=planned)
        warnings = made.warnings
    else:
        struck = plan_tool(options.model, known, arm=model, choice=choice, own=own, motion=motion)
        files = PlanFiles(options.out, struck.arm.recording_model.xml)
        planned = tool_runs(files, struck)
        written = write_tool_plan(files, struck, known=source)
        text = _report("tool_summary")(struck)
        page = partial(_report("write_tool_page"), files.folder / PAGE, struck, planned)
        warnings = struck.warnings
    try:
        written.append(page(folder=options.out, model=options.model))
    except MissingExtra as error:
        print(f"note: no {PAGE}: {error}", file=sys.stderr)
    for warning in warnings:
        print(f"note: {warning}", file=sys.stderr)
    print(text)
    names = sorted({path.relative_to(files.folder).parts[0] for path in written})
    print(f"written to {files.folder}: {', '.join(names)}")
    for kind, words in _PUT.items():
        mine = [str(files.recording / one.file) for one in planned if one.kind == kind]
        if mine:
            print(f"{words} into {', '.join(mine)}")


def _report(name: str) -> Callable[..., Any]:
    """A function of the reports, which load more than a plan needs to be chosen."""
    import loose_env.report

    found: Callable[..., Any] = getattr(loose_env.report, name)
    return found
