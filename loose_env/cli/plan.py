"""Plan the next measurement: the pose, the joint to excite and the signal to play.

Reads the model of an arm (MJCF or URDF) and what is known so far: nothing at first, then the
result of 'loose diagnose' (--known). Plan, measure and diagnose in turn until the fault is
identified. By default the plan is what the diagnosis asks for next; with options for poses, band,
length or rate the pose is chosen anew.

Written to the output folder: plan.html, what to do at the machine; plan.json, the same for
programs; signal.csv and signal.parquet, a command for every actuator in its own unit; recording,
the folder that the measured run goes into and that 'loose diagnose' reads. In the folder of an
earlier plan the measured runs stay, and settings that are not given hold as before.

    loose plan arm.xml --out session
    loose plan arm.xml --out session --known session/diagnosis
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import add_choice, add_kept, settings_of, take_over
from loose_env.errors import MissingExtra
from loose_env.instrument import (
    KEPT,
    PAGE,
    PLAN,
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
    add_kept(parser, ModelSettings, title="arm")
    add_choice(parser)
    add_kept(parser, MotionSettings, title="limits and commands of the controller")
    add_kept(parser, PlanSettings, title="this measurement", only=KEPT)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Plan the next measurement and write it down."""
    diagnosis = None if options.known is None else read_diagnosis(options.known)
    before = session_beside(options.out / RECORDING)
    if diagnosis is None or before.is_newer_than(options.known):
        take_over(options, before.choice, "the earlier plan")
    else:
        take_over(options, diagnosis.choice, "the diagnosis")
    take_over(options, before.arm, "the earlier plan")
    take_over(options, before.motion, "the earlier plan")
    take_over(options, before.own, "the earlier plan", only=KEPT)
    model, choice = settings_of(options, ModelSettings), settings_of(options, NextSettings)
    own, motion = settings_of(options, PlanSettings), settings_of(options, MotionSettings)
    source = "" if options.known is None else str(options.known)
    if model.excitation == "joint":
        made = plan(options.model, diagnosis, arm=model, choice=choice, own=own, motion=motion)
        files = PlanFiles(options.out, made.arm.recording_model.xml)
        planned = files.runs_of(made)
        runs = [one.file for one in planned if one.kind == "run"]
        written = write_plan(files, made, known=source)
        text = _report("summary")(made)
        page = partial(_report("write_plan_page"), files.folder / PAGE, made, runs, planned=planned)
        warnings = made.warnings
    else:
        struck = plan_tool(
            options.model, diagnosis, arm=model, choice=choice, own=own, motion=motion
        )
        files = PlanFiles(options.out, struck.arm.recording_model.xml)
        planned = tool_runs(files, struck)
        written = write_tool_plan(files, struck, known=source)
        text = _report("tool_summary")(struck)
        page = partial(_report("write_tool_page"), files.folder / PAGE, struck, planned)
        warnings = struck.warnings
    missing: tuple[str, ...] = ()
    try:
        written.append(page(folder=options.out, model=options.model))
    except MissingExtra as error:
        missing = (f"no {PAGE}: {error}",)
    names = sorted({path.relative_to(files.folder).parts[0] for path in written})
    lines = [text, f"written to {files.folder}: {', '.join(names)}"]
    for kind, words in _PUT.items():
        mine = [str(files.recording / one.file) for one in planned if one.kind == kind]
        if mine:
            lines.append(f"{words} into {', '.join(mine)}")
    return Outcome(
        text="\n".join(lines),
        json=lambda: (files.folder / PLAN).read_text(encoding="utf-8"),
        warnings=(*warnings, *missing),
    )


def _report(name: str) -> Callable[..., Any]:
    """A function of the reports, which load more than a plan needs to be chosen."""
    import loose_env.report

    found: Callable[..., Any] = getattr(loose_env.report, name)
    return found
