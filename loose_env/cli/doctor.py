"""Check a recording before it is used: units, ranges, signs, sampling, channels, clocks, entries.

Reads a recording (a folder with recording.json, the nominal model and measured runs), and prints
all findings at once: errors, which make a result wrong; warnings, which may; notes. Each says what
was found, with its number and unit, the consequence and the remedy. 'loose diagnose' and
'loose gap' run the same checks first and stop at errors; --ignore-doctor goes on. The exit code is
1 where there are errors.

    loose doctor session/recording
    loose doctor session/recording --fix session/corrected

Where a changed unit, sign, order of joints, clock or direction of gravity explains the torques, the
finding names it with the share of their variance that is left. --fix writes the corrected
recording beside; nothing is corrected without it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from loose_env.cli.console import Console, Outcome, add_recording_options
from loose_env.cli.options import add_settings, settings_of
from loose_env.doctor import DoctorSettings, Finding, examine, write_corrected
from loose_env.recording import Recording, read_recording


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser, out=False)
    parser.add_argument(
        "--fix",
        type=Path,
        metavar="DIR",
        help="write the recording with the offered corrections of errors and warnings to a new "
        "folder; the one that is read stays as it is",
    )
    add_settings(parser, DoctorSettings, title="tolerances")


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Check the recording and print the findings."""
    settings = settings_of(options, DoctorSettings)
    recording = read_recording(options.recording, model=options.model)
    report = examine(recording, settings)
    outcome = Outcome(text=report.text(), json=report.to_json, code=1 if report.errors else 0)
    if options.fix is None:
        return outcome
    found = (*report.errors, *report.warnings)
    fixes = list(dict.fromkeys(each.fix for each in found if each.fix is not None))
    try:
        made = write_corrected(recording, fixes, options.fix)
    except BaseException:
        console.show(outcome)  # the findings are worth their time without the copy, too
        raise
    written = f"written: {made.folder}, with {'; '.join(fix.words for fix in fixes)}"
    return replace(outcome, text=f"{outcome.text}\n{written}")


def add_preflight(parser: argparse.ArgumentParser) -> None:
    """Add the option of a command that checks its recording first."""
    parser.add_argument(
        "--ignore-doctor",
        action="store_true",
        help="go on although the preflight ('loose doctor') finds errors in the recording",
    )


def check_first(recording: Recording, options: argparse.Namespace) -> tuple[Finding, ...]:
    """Check a recording that was read, and print errors and warnings on the error stream.

    Returns
    -------
    tuple of Finding
        All findings, for the result.

    Raises
    ------
    InvalidData
        If there are errors, and they are not to be ignored.
    """
    report = examine(recording)
    for line in report.lines(least="warning"):
        print(line, file=sys.stderr)
    if not options.ignore_doctor:
        report.refuse_errors(listed="listed above", remedy="--ignore-doctor")
    return report.findings
