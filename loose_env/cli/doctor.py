"""Check a recording before it is used: units, ranges, signs, sampling, channels, clocks, entries.

Reads a recording (a folder with recording.json, the nominal model and measured runs), and prints
all findings at once: errors, which make a result wrong; warnings, which may; notes. Each says what
was found, with its number and unit, the consequence and the remedy. 'loose diagnose' and
'loose gap' run the same checks first and stop at errors; --ignore-doctor goes on. The exit code is
1 where there are errors.

    loose doctor session/recording
"""

from __future__ import annotations

import argparse
import sys

from loose_env.cli.console import Console, Outcome, add_recording_options
from loose_env.cli.options import add_settings, settings_of
from loose_env.doctor import DoctorSettings, Finding, examine
from loose_env.recording import Recording, read_recording


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser, out=False)
    add_settings(parser, DoctorSettings, title="tolerances")


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Check the recording and print the findings."""
    settings = settings_of(options, DoctorSettings)
    report = examine(read_recording(options.recording, model=options.model), settings)
    return Outcome(text=report.text(), json=report.to_json, code=1 if report.errors else 0)


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
