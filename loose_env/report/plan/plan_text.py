"""Text of a plan: steps at the machine, in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from loose_env.instrument import (
    RECORDING,
    JointDrive,
    NextSettings,
    Plan,
    PlannedRun,
    Signal,
    option_words,
    path_word,
    run_columns,
    signal_stems,
)
from loose_env.report.diagnosis.text import percent, position_text, short_name
from loose_env.report.plan.plan_motion import (
    file_words,
    further_steps,
    kind_words,
    limit_lines,
    peak_rows,
    transit_words,
)

__all__ = ["commands_after", "plain_names", "pose_rows", "starts", "steps", "summary"]

_PEAK_COLUMNS = ("Quantity", "Peak", "Limit", "Source")
_LISTED = 0.02
"""Probability from which a hypothesis is mentioned [1]."""


def pose_rows(plan: Plan) -> list[tuple[str, str]]:
    """Joint and where to hold it, base first."""
    return [
        (name, position_text(plan.arm.nominal, own, plan.next.pose[name]))
        for name, own in zip(plan.arm.joints, plan.arm.nominal.joints, strict=True)
    ]


def starts(plan: Plan) -> list[str]:
    """Command of each joint's actuator when the first signal begins, base first."""
    first = plan.signals[0].start
    return [
        "–" if drive is None else f"{first[drive.actuator]:.4f}".replace("-", "−")
        for drive in plan.arm.drives
    ]


def commands_after(
    plan: Plan, folder: str | Path = "DIR", model: str | Path | None = None
) -> list[str]:
    """Commands that make use of the measured run: diagnose, and plan again.

    Parameters
    ----------
    plan : Plan
        The plan.
    folder : str or Path
        Folder of the plan, as commands name it.
    model : str or Path, optional
        The model, as commands are to name it; by default as the plan has it.
    """
    place = Path(folder)
    found = path_word(place / "diagnosis")
    chosen_with = {n: v for n, v in plan.again.items() if n in asdict(NextSettings())}
    return [
        f"loose diagnose {path_word(place / RECORDING)} --out {found}{option_words(chosen_with)}",
        f"loose plan {path_word(model or plan.arm.path)} --out {path_word(place)} "
        f"--known {found}{option_words(plan.again)}",
    ]


def steps(plan: Plan, runs: tuple[str, ...], planned: Sequence[PlannedRun] = ()) -> list[str]:
    """Steps at the machine in order; the last refers to `commands_after`.

    Parameters
    ----------
    plan : Plan
        The plan.
    runs : tuple of str
        File of each signal's run.
    planned : sequence of PlannedRun
        All runs of the plan, repeats and references included.
    """
    arm, chosen = plan.arm, plan.next
    made = arm.recording_model
    said = [
        "Move the arm to the pose: "
        + ", ".join(f"{name} {value}" for name, value in pose_rows(plan))
        + ". Look first that nothing is in its way; keep everybody out of its reach. "
        + transit_words(plan),
    ]
    rate = f"{chosen.rate_hz:g} times a second"
    for signal, run, stem in zip(plan.signals, runs, signal_stems(plan.signals), strict=True):
        j = arm.joints.index(signal.joint)
        drive = arm.drives[j]
        assert drive is not None
        own = f"{_unit_words(drive, bool(arm.nominal.sliding[j]))} for {drive.actuator}"
        what = kind_words(signal) or own
        others = (
            "The other columns hold the arm."
            if drive.servo
            else "Torque alone holds no pose: let your controller keep every joint near its place, "
            f"slow enough to leave the noise alone (below {chosen.band_hz[0] / 4:.0f} Hz), and add "
            "the signal to what it gives."
        )
        if signal.kind != "model":
            others = f"{signal.joint} is shaken, the others stay in the pose."
        commands = (
            f"those of {stem}.csv"
            if drive.servo
            else "the torques that were really given, the controller's part included"
        )
        said.append(
            f"Start the recorder at {rate} or faster, then play {file_words(plan, stem)} at "
            f"{signal.rate_hz:g} commands a second: {what}, {signal.time[-1]:.2f} s long, noise "
            f"from {chosen.band_hz[0]:g} to {chosen.band_hz[1]:g} Hz. {others}"
            f"{_starts(signal) if drive.servo and signal.kind == 'model' else ''}"
        )
        said.append(
            f"Save the readings as recording/{run} with the columns "
            f"{', '.join(run_columns(plan))}. {_command_words(signal, commands)}; "
            "accelerations are in m/s² as the sensor gives them, gravity included, along the axes "
            f"of the site {made.site!r}."
        )
    said += further_steps(plan, planned)
    said.append(
        "Run the two commands below: the first says what is loose, the second plans the next pose."
    )
    return said


def _unit_words(drive: JointDrive, slides: bool) -> str:
    """Kind and unit of a signal's commands."""
    if drive.servo:
        unit = "m" if slides else "rad"
        ratio = float(drive.command(0.0, 1.0)) - float(drive.command(0.0, 0.0))
        own = unit if np.isclose(ratio, 1.0) else f"{ratio:g} for each {unit} of the joint"
        return f"position commands ({own})"
    what, unit = ("force", "N") if slides else ("torque", "N·m")
    own = "" if np.isclose(drive.gain, 1.0) else f" (1 gives {drive.gain:g} {unit})"
    return f"{what} commands{own}"


def _command_words(signal: Signal, commands: str) -> str:
    """Origin of the columns of commands or torques in the recording."""
    if signal.kind == "model":
        return f"The commands are {commands}"
    return (
        "The torques are those of the drives as the controller measures them; leave out their "
        "columns where it does not"
    )


def _starts(signal: Signal) -> str:
    """Commands with which a signal begins, as its file has them, in a sentence."""
    first = ", ".join(f"{name} at {value:.4g}" for name, value in signal.start.items())
    return f" It begins with {first}: the arm has to stand under these commands, or it jumps."


def summary(plan: Plan) -> str:
    """A plan in a few lines, for a terminal."""
    arm, chosen = plan.arm, plan.next
    nominal = arm.nominal
    width = max(len(name) for name in arm.joints)
    lines = [f"reason: {chosen.reason}", "pose"]
    lines += [f"  {name.ljust(width)}  {value:>10}" for name, value in pose_rows(plan)]
    for signal in plan.signals:
        j = arm.joints.index(signal.joint)
        unit, turn = ("N", "m/s²") if nominal.sliding[j] else ("N·m", "rad/s²")
        lines.append(f"shake {signal.joint}")
        lines.append(
            f"  noise from {chosen.band_hz[0]:g} to {chosen.band_hz[1]:g} Hz for "
            f"{chosen.seconds:g} s, {chosen.rate_hz:g} samples a second"
        )
        lines.append(
            f"  joint {signal.joint_rms:.3g} {turn} rms, tool {signal.tool_rms:.3g} m/s² rms, "
            f"moves up to {_small(signal.travel[j], bool(nominal.sliding[j]))}"
        )
        lines.append(
            f"  torque {signal.drive_rms:.3g} {unit} rms, peaks {signal.torque_peaks[j]:.3g} of "
            f"{nominal.torque_limits[j]:g} {unit}, holding torque included"
        )
        rows = peak_rows(plan, signal)
        widths = {key: max((len(row[key]) for row in rows), default=0) for key in _PEAK_COLUMNS}
        for row in rows:
            cells = "  ".join(row[key].ljust(width) for key, width in widths.items())
            whose = "" if row["Joint"] == signal.joint else f"  ({row['Joint']})"
            lines.append(f"  peak {cells.rstrip()}{whose}")
    lines.append("limits")
    lines += [f"  {line}" for line in limit_lines(plan)]
    lines.append(f"way to the pose\n  {transit_words(plan)}")
    plain = plain_names(plan)
    known = sorted(plan.expected.items(), key=lambda item: -item[1].probability)
    if any("@" in name and one.probability > 0.3 for name, one in known):
        lines.append("in question")
        for name, one in known:
            if one.probability >= _LISTED:
                lines.append(f"  {percent(one.probability):>8}  {plain[name]}")
    return "\n".join(lines)


def plain_names(plan: Plan) -> dict[str, str]:
    """Each hypothesis of a plan in a few words."""
    arm = plan.arm
    found = {}
    for name in plan.expected:
        kind, _, where = name.partition("@")
        if kind == "backlash":  # the arm has a name of its own in the place of a reserved one
            where = arm.nominal.joints[arm.joints.index(where)]
        found[name] = short_name(arm.nominal, f"{kind}@{where}" if where else kind)
    return found


def _small(travel: float, slides: bool) -> str:
    return f"{travel * 1e3:.2g} mm" if slides else f"{np.degrees(travel):.2g}°"
