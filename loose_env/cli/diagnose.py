"""Say what is loose in an arm, by runs in which joints were shaken while it held a pose.

Reads a recording (a folder with recording.json, the nominal model and measured runs; healthy
reference runs help where there are any), weighs every link's looseness, every joint's backlash and
a healthy arm, and says what to measure next where that is not settled. That is chosen with the
settings of the 'loose plan' in whose folder the recording lies; options take their place.

Written to the output folder: result.json, what was found; report.html, the same to be read. The
same command on a recording with more runs takes their place. Exit codes: 0 done, whatever was
found; 1 something given cannot be used; 2 the command line makes no sense; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields

from loose_env.cli.choice import add_choice, take_over
from loose_env.cli.doctor import add_preflight, check_first
from loose_env.cli.options import add_settings, settings_of
from loose_env.cli.recorded import Said, add_recording_options, folder_of
from loose_env.errors import InvalidData, InvalidSetting, MissingExtra
from loose_env.instrument import (
    HEALTHY,
    DiagnoseSettings,
    Diagnosis,
    NextSettings,
    diagnose,
    read_recorded_arm,
    session_beside,
)
from loose_env.recording import read_recording


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_recording_options(parser)
    add_preflight(parser)
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
    recording = read_recording(options.recording, model=options.model)
    check_first(recording, options)
    say = Said(quiet=options.quiet)
    with folder.worked_in():
        found = diagnose(recording, settings, say=say)
    written = []
    # An earlier result must not stand beside a later page if this run is cut short.
    (folder.path / "result.json").unlink(missing_ok=True)
    try:
        from loose_env.report import write_page

        arm = read_recorded_arm(recording.model_path).shown
        name = options.recording.resolve().name
        written.append(write_page(folder.path / "report.html", found, arm, recording=name))
    except (MissingExtra, InvalidData) as error:  # what was found is written all the same
        (folder.path / "report.html").unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    written.append(found.write(folder.path / "result.json"))  # last: it says that all is there
    folder.note(written)
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(summary(found))
    print("written: " + ", ".join(str(path) for path in written))


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
