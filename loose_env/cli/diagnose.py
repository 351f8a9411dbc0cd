"""Diagnose a loose link or a joint with backlash, from runs with excited joints in held poses.

Reads a recording: a folder with recording.json, the nominal model and measured runs. Runs of the
healthy arm are optional; they make smaller faults detectable. Computes the probability of a healthy
arm, of looseness at every link and of backlash at every joint, and proposes the next measurement
where that does not settle it. Settings of the 'loose plan' in whose folder the recording lies hold,
unless an option is given here.

With --before it also says what has changed since earlier sessions of the same arm: the transmission
of every joint to every tool axis in the same pose and under the same signal, the free travel and
the probability of a fault, each on a control chart with a stated rate of false alarms.

Written to the output folder: report.html, to be read; result.json, the same for programs and for
'loose plan --known'; with --before trend.html and trend.json. With more runs in the recording, the
same command replaces them.

    loose diagnose session/recording --out session/diagnosis
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

from loose_env.cli.console import Console, Outcome, add_recording_options, folder_of
from loose_env.cli.doctor import add_preflight, check_first
from loose_env.cli.options import add_choice, add_settings, settings_of, take_over
from loose_env.errors import InvalidSetting
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    Maintenance,
    NextSettings,
    Trend,
    TrendSettings,
    change_since,
    diagnose,
    read_maintenance,
    read_recorded_arm,
    read_sessions,
    session_beside,
    time_of,
)
from loose_env.recording import read_recording
from loose_env.report import diagnosis_text, write_diagnosis


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser)
    add_preflight(parser)
    parser.add_argument(
        "--date",
        metavar="DATE",
        help="date of the measurement, as 2026-05-04 (default: that of the latest run's file)",
    )
    parser.add_argument(
        "--before",
        type=Path,
        nargs="+",
        default=[],
        metavar="OLD",
        help="earlier sessions of the same arm: results, session folders or recordings",
    )
    parser.add_argument(
        "--maintenance",
        type=Path,
        metavar="FILE",
        help='JSON list of {"date", "joint" or "link", "work", "note"}: after it the baseline '
        "starts anew",
    )
    add_settings(parser, TrendSettings, title="change since earlier sessions")
    add_choice(parser)
    chosen_with = [each.name.replace("_", "-") for each in fields(NextSettings)]
    add_settings(parser, DiagnoseSettings, title="prior and model errors", leave_out=chosen_with)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Diagnose and write it down."""
    before = session_beside(options.recording)
    take_over(options, before.choice, "the plan beside the recording")
    settings = settings_of(options, DiagnoseSettings)
    folder = folder_of(options)
    if options.recording.resolve() == folder.path:
        raise InvalidSetting("--out is the recording itself; give another folder")
    if options.date is not None:
        time_of(options.date)
    compared = settings_of(options, TrendSettings)
    if options.maintenance is not None and not options.before:
        raise InvalidSetting("--maintenance needs earlier sessions; give them by --before")
    recording = read_recording(options.recording, model=options.model)
    arm = read_recorded_arm(recording.model_path)
    records: tuple[Maintenance, ...] = ()
    if options.maintenance is not None:
        records = read_maintenance(options.maintenance, (*arm.joints, *arm.links))
    preflight = check_first(recording, options)
    name = options.recording.resolve().name
    trend = None
    with folder.worked_in():
        earlier = read_sessions(options.before, partial(_earlier, options, settings, console.say))
        found = diagnose(recording, settings, motion=before.limits, say=console.say)
        found = replace(found, preflight=preflight)
        if options.date is not None:
            found = replace(found, date=options.date)
        if earlier:
            trend = change_since(found, earlier, name=name, maintenance=records, settings=compared)
    written = write_diagnosis(
        folder.path,
        found,
        recording.model_path,
        recording=name,
        given=str(options.recording),
        trend=trend,
        say=console.say,
    )
    folder.note(written)
    text = [diagnosis_text(found, arm.shown, folder=str(options.recording), warnings=False)]
    if trend is not None:
        text.append(trend_summary(trend))
    text.append("written: " + ", ".join(str(path) for path in written))
    return Outcome(
        text="\n".join(text),
        json=found.to_json,
        warnings=(*found.warnings, *(trend.warnings if trend else ())),
    )


def _earlier(
    options: argparse.Namespace,
    settings: DiagnoseSettings,
    say: Callable[[str], None],
    folder: Path,
) -> Diagnosis:
    """Diagnosis of the recording of an earlier session, which has no result."""
    say(f"diagnosing the earlier session {folder}")
    return diagnose(read_recording(folder, model=options.model), settings, plan=False)


def trend_summary(trend: Trend) -> str:
    """Change since earlier sessions in a few lines."""
    rate = f"at most {100 * trend.false_alarm_rate:.2g} % of a healthy arm's sessions alarm"
    if not trend.compared:
        return "not compared with earlier sessions: too few are like this one; see the warnings"
    if not trend.changed:
        return f"no change since {len(trend.sessions) - 1} earlier sessions ({rate})"
    lines = [f"changed since earlier sessions ({rate}):"]
    for each in trend.changed[:4]:
        since = trend.sessions[each.alarm or 0]
        what = {
            "probability": "probability of a fault",
            "free_travel": f"free travel of {each.joint}",
            "transmission": f"transmission from {each.joint} to {each.channel}",
        }[each.quantity]
        band = (
            "" if each.band_hz is None else f", {each.band_hz[0]:.0f} to {each.band_hz[1]:.0f} Hz"
        )
        lines.append(f"  {what}{band}: alarm since {since.date[:10] or since.name}")
    return "\n".join(lines)
