"""Say what is loose in an arm, by runs in which joints were shaken while it held a pose.

Reads a recording (a folder with recording.json, the nominal model and measured runs; healthy
reference runs help where there are any), weighs every link's looseness, every joint's backlash and
a healthy arm, and says what to measure next where that is not settled. That is chosen with the
settings of the 'loose plan' in whose folder the recording lies; options take their place.

With --before it also says what has changed since earlier sessions of the same arm: the transmission
of every joint to every tool axis in the same pose and under the same signal, the free travel and
the probability of a fault, each on a control chart with a stated rate of false alarms.

Written to the output folder: result.json, what was found; report.html, the same to be read; with
--before trend.json and trend.html. The same command on a recording with more runs takes their
place. Exit codes: 0 done, whatever was found; 1 something given cannot be used; 2 the command line
makes no sense; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

from loose_env.cli.choice import add_choice, take_over
from loose_env.cli.options import add_settings, settings_of
from loose_env.cli.recorded import Said, add_recording_options, folder_of
from loose_env.errors import InvalidData, InvalidSetting, MissingExtra
from loose_env.instrument import (
    HEALTHY,
    DiagnoseSettings,
    Diagnosis,
    Maintenance,
    NextSettings,
    Trend,
    TrendSettings,
    change_since,
    diagnose,
    joints_and_links,
    read_maintenance,
    read_recorded_arm,
    read_sessions,
    session_beside,
    time_of,
)
from loose_env.recording import read_recording


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser)
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
    add_settings(parser, DiagnoseSettings, title="what is known beforehand", leave_out=chosen_with)


def run(options: argparse.Namespace) -> None:
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
    say = Said(quiet=options.quiet)
    trend = None
    with folder.worked_in():
        earlier = read_sessions(options.before, partial(_earlier, options, settings, say))
        found = diagnose(recording, settings, say=say)
        if options.date is not None:
            found = replace(found, date=options.date)
        if earlier:
            records: tuple[Maintenance, ...] = ()
            if options.maintenance is not None:
                names = [name for names in joints_and_links(found) for name in names]
                records = read_maintenance(options.maintenance, names)
            name = options.recording.resolve().name
            trend = change_since(found, earlier, name=name, maintenance=records, settings=compared)
    written = []
    # An earlier result must not stand beside a later page if this run is cut short.
    for name in ("result.json", "trend.json", "trend.html"):
        (folder.path / name).unlink(missing_ok=True)
    try:
        from loose_env.report import write_page, write_trend_page

        arm = read_recorded_arm(recording.model_path).shown
        name = options.recording.resolve().name
        path, given = folder.path / "report.html", str(options.recording)
        written.append(write_page(path, found, arm, recording=name, folder=given))
        if trend is not None:
            path = folder.path / "trend.html"
            written.append(write_trend_page(path, trend, recording=name))
    except (MissingExtra, InvalidData) as error:  # what was found is written all the same
        (folder.path / "report.html").unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    if trend is not None:
        written.append(trend.write(folder.path / "trend.json"))
    written.append(found.write(folder.path / "result.json"))  # last: it says that all is there
    folder.note(written)
    for warning in (*found.warnings, *(trend.warnings if trend else ())):
        print(f"warning: {warning}", file=sys.stderr)
    print(summary(found))
    if trend is not None:
        print(trend_summary(trend))
    print("written: " + ", ".join(str(path) for path in written))


def _earlier(
    options: argparse.Namespace, settings: DiagnoseSettings, say: Said, folder: Path
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


def summary(found: Diagnosis) -> str:
    """Summary of the result in a few lines."""
    fault = found.fault
    if fault.kind == HEALTHY:
        lines = [f"healthy, probability {found.probability:.3f}: nothing is seen to be loose"]
    else:
        lines = [f"{fault.kind} at {fault.where}, probability {found.probability:.3f}"]
    if fault.direction is not None:
        along = ", ".join(f"{x:.3f}" for x in fault.direction)
        half = fault.direction_half_angle_deg
        within = "" if half is None else f", within {half:.1f} degrees (95 %)"
        lines.append(f"  along ({along}) of the link's frame{within}")
    if fault.gap_m is not None:
        ends = fault.gap_interval_m
        between = "" if ends is None else f" ({ends[0]:.2g} to {ends[1]:.2g})"
        unit = "m" if fault.kind == "structural_looseness" else "rad (m where the joint slides)"
        lines.append(f"  free travel {fault.gap_m:.2g}{between} {unit}")
    others = sorted(
        ((p, name) for name, p in found.posterior.items() if name != fault.hypothesis), reverse=True
    )
    lines += [f"  or {name}, probability {p:.3f}" for p, name in others[:3] if p >= 0.01]
    following = found.next
    if following is None:
        lines.append(
            "nothing more needs to be measured"
            if found.settled
            else "that is not settled, and no pose was found that would tell more; see the warnings"
        )
        return "\n".join(lines)
    pose = ", ".join(f"{joint} {q:.3f}" for joint, q in following.pose.items())
    played = ", ".join(
        f"{joint} at {torque:.3g} rms"
        for joint, torque in zip(following.joints, following.torques, strict=True)
    )
    lines += [
        f"measure next: {following.reason}",
        f"  pose: {pose} [rad or m]",
        f"  shake: {played} [N·m or N], {following.band_hz[0]:g} to {following.band_hz[1]:g} Hz, "
        f"{following.seconds:g} s",
    ]
    return "\n".join(lines)
