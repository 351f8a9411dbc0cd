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
from pathlib import Path

from loose_env.cli.choice import add_choice, add_kept, take_over
from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import settings_of
from loose_env.errors import MissingExtra
from loose_env.instrument import (
    KEPT,
    PAGE,
    RECORDING,
    ModelSettings,
    NextSettings,
    PlanFiles,
    PlanSettings,
    plan,
    plan_json,
    read_diagnosis,
    session_beside,
    write_plan,
)
from loose_env.io import json_text


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
    take_over(options, before.own, "the earlier plan", only=KEPT)
    made = plan(
        options.model,
        diagnosis,
        arm=settings_of(options, ModelSettings),
        choice=settings_of(options, NextSettings),
        own=settings_of(options, PlanSettings),
    )
    files = PlanFiles(options.out, made.arm.recording_model.xml)
    runs = files.next_names(len(made.signals))
    known = "" if options.known is None else str(options.known)
    written = write_plan(files, made, known=known)
    missing: tuple[str, ...] = ()
    from loose_env.report import summary

    try:
        from loose_env.report import write_plan_page

        written.append(
            write_plan_page(
                files.folder / PAGE, made, runs, folder=options.out, model=options.model
            )
        )
    except MissingExtra as error:
        missing = (f"no {PAGE}: {error}",)
    names = sorted({path.relative_to(files.folder).parts[0] for path in written})
    measured = ", ".join(str(files.recording / name) for name in runs)
    return Outcome(
        text=f"{summary(made)}\nwritten to {files.folder}: {', '.join(names)}\n"
        f"put the measured run into {measured}",
        json=lambda: json_text(plan_json(made, runs, known)),
        warnings=(*made.warnings, *missing),
    )
