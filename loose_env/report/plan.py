"""Report of a plan as text and page: pose, signals, limits, steps, expected observations."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from loose_env.envs import INK, MEASURED, MUTED
from loose_env.instrument import (
    FIRST,
    QUANTITIES,
    RECORDING,
    TRANSIT,
    JointDrive,
    NextSettings,
    Plan,
    PlannedRun,
    Signal,
    ToolPlan,
    option_words,
    path_word,
    run_columns,
    signal_stems,
    unit_of,
)
from loose_env.io import begun, sentence, write_text
from loose_env.report.diagnosis_figures import arm_figure
from loose_env.report.figures import labels, panels
from loose_env.report.page import (
    Brief,
    FigureCard,
    Section,
    Table,
    aligned,
    render_page,
    typographic,
    warnings_section,
)
from loose_env.report.words import percent, position_text, short_name, with_plain_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LISTED = 0.005  # probability from which a hypothesis is listed
_FILE_ENDINGS = {"csv": ".csv", "parquet": ".parquet", "ros2": ".yaml"}
_KINDS = {
    "torque": "torques of all joints (N·m, N where one slides), to be added to what your "
    "controller gives to hold the arm",
    "position": "positions of all joints (rad, m where one slides), which your controller follows",
    "velocity": "velocities of all joints (rad/s, m/s where one slides), which your controller "
    "follows",
}
_ACTS = {
    "hammer": "strike the tool some ten times a second, not in step, with a tip hard enough that "
    "an impact lasts {contact:.0f} ms or less",
    "shaker": "play signal.csv (force.tool in N) on the shaker, whose force sensor sits between "
    "it and the tool",
}
_PULSE_BAND = 0.75
"""Duration of an impact times the upper end of the band: its spectrum has its first zero at twice
that [1]."""
_LAST = "Run the two commands below: the first says what is loose, the second plans the next pose."


@dataclass(frozen=True, kw_only=True)
class _Sheet:
    """Content of a plan, for terminal and page."""

    title: str
    answers: Mapping[str, str]
    pose: Table
    card: FigureCard
    further: Sequence[Section]
    lines: Sequence[str]
    """Lines of the terminal below the pose."""


def summary(plan: Plan | ToolPlan) -> str:
    """A plan in a few lines, for a terminal."""
    sheet = _sheet(plan, ())
    said = [f"{name.lower()}: {words}" for name, words in sheet.answers.items()]
    pose = aligned([list(row.values())[:2] for row in sheet.pose.rows])
    parts = [("", "", [*said, "pose"]), ("", "  ", pose), ("", "", sheet.lines)]
    return Brief(headline=sheet.title, parts=parts).text()


def write_plan_page(
    path: str | os.PathLike[str],
    plan: Plan | ToolPlan,
    planned: Sequence[PlannedRun],
    *,
    folder: str | Path | None = None,
    model: str | Path | None = None,
) -> Path:
    """Write the page of a plan, the sheet to take to the machine.

    Parameters
    ----------
    path : path-like
        Path of the page.
    plan : Plan or ToolPlan
        The plan.
    planned : sequence of PlannedRun
        All its runs, repeats and references included.
    folder, model : str or Path, optional
        The plan's folder and the model, as the commands on the page are to name them; by default
        the folder of the page, and the model as the plan has it.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    sheet = _sheet(plan, planned)
    commands = plan_commands(plan, folder or Path(path).parent, model)
    steps = _tool_steps(plan, planned) if isinstance(plan, ToolPlan) else _steps(plan, planned)
    plain = {} if isinstance(plan, ToolPlan) else _plain_names(plan)
    arm = plan.arm
    page = render_page(
        sheet.title,
        [
            Section(answers={name: [sentence(words)] for name, words in sheet.answers.items()}),
            warnings_section(("warning", with_plain_names(w, plain)) for w in plan.warnings),
            Section(heading="Steps", points=steps, code="\n".join(commands)),
            Section(heading="The pose", cards=[sheet.card], tables=[sheet.pose], beside=True),
            *sheet.further,
        ],
        kicker=[arm.path.name, "the next measurement"],
        notes=f"The accelerometer is taken to sit at {arm.report.tool} ({arm.report.tool_origin}). "
        f"The arm is {arm.nominal.name}, {arm.nominal.n} joints.",
    )
    return write_text(Path(path), page)


def plan_commands(
    plan: Plan | ToolPlan, folder: str | Path, model: str | Path | None = None
) -> list[str]:
    """Commands that make use of the measured run: diagnose, and plan again.

    Parameters
    ----------
    plan : Plan or ToolPlan
        The plan.
    folder : str or Path
        Folder of the plan, as commands name it.
    model : str or Path, optional
        The model, as commands are to name it; by default as the plan has it.
    """
    chosen = {}
    if isinstance(plan, Plan):
        chosen = {n: v for n, v in plan.again.items() if n in asdict(NextSettings())}
    found = path_word(Path(folder) / "diagnosis")
    return [
        f"loose diagnose {path_word(Path(folder) / RECORDING)} --out {found}{option_words(chosen)}",
        f"loose plan {path_word(model or plan.arm.path)} --out {path_word(folder)} "
        f"--known {found}{option_words(plan.again)}",
    ]


def _sheet(plan: Plan | ToolPlan, planned: Sequence[PlannedRun]) -> _Sheet:
    return _tool_sheet(plan) if isinstance(plan, ToolPlan) else _joint_sheet(plan, planned)


def _positions(plan: Plan | ToolPlan) -> dict[str, str]:
    """Joint and where to hold it, base first."""
    nominal = plan.arm.nominal
    return {
        name: position_text(nominal, own, float(q))
        for name, own, q in zip(plan.arm.joints, nominal.joints, plan.pose, strict=True)
    }


def _move_words(plan: Plan | ToolPlan, transit: str) -> str:
    pose = ", ".join(f"{name} {value}" for name, value in _positions(plan).items())
    return f"Move the arm to the pose: {pose}. Look first that nothing is in its way. {transit}"


# Joints that are shaken


def _joint_sheet(plan: Plan, planned: Sequence[PlannedRun]) -> _Sheet:
    chosen, nominal, plain = plan.next, plan.arm.nominal, _plain_names(plan)
    levels = sorted(f"{signal.tool_rms:.2g}" for signal in plan.signals)
    level = levels[0] if levels[0] == levels[-1] else f"{levels[0]} to {levels[-1]}"
    first = plan.signals[0].start
    starts = ["–" if d is None else f"{first[d.actuator]:.4f}" for d in plan.arm.drives]
    pose = [
        {"Joint": name, "Hold at": value, "Command at the start": started}
        for (name, value), started in zip(_positions(plan).items(), starts, strict=True)
    ]
    own = [nominal.joints[plan.arm.joints.index(j)] for j in chosen.joints]
    signals, limits, expected = _signal_table(plan), _limit_lines(plan), _expected_table(plan)
    lines = ["signal", *_indented(signals), "peaks"]
    for signal in plan.signals:
        lines += _indented(_peak_table(plan, signal), "  peak ", heads=False)
    lines += ["limits", *(f"  {line}" for line in limits), f"way to the pose: {_transit(plan)}"]
    if any("@" in name and one.probability > 0.3 for name, one in plan.expected.items()):
        lines += ["expected", *_indented(expected)]
    runs = [
        {
            "Run": one.file,
            "Signal": one.signal,
            "Shaken joint": one.joint,
            "Condition": str(one.listed["condition"]),
            "Reason": str(one.listed["reason"]) or "new pose",
        }
        for one in planned
    ]
    run_note = "Repeats and references may be measured later, or not."
    return _Sheet(
        title=f"Next: shake {' and '.join(chosen.joints)}",
        answers={
            "Reason": with_plain_names(chosen.reason, plain),
            "Duration and level": f"{len(plan.signals)} run{'s' * (len(plan.signals) > 1)} of "
            f"{plan.signals[0].time[-1]:.1f} s at {chosen.rate_hz:g} samples a second; noise "
            f"from {chosen.band_hz[0]:g} to {chosen.band_hz[1]:g} Hz shakes the tool by {level} "
            "m/s² rms",
            "Holding of the joints": plan.arm.held_by,
        },
        pose=Table(
            rows=pose,
            note="From the base. Commands are those of the signal's first row, in the actuator's "
            "own unit.",
        ),
        card=FigureCard(
            title="Pose of the arm",
            image=arm_figure(
                nominal, dict(zip(nominal.joints, plan.pose, strict=True)), excited=own
            ),
            caption="The joint in yellow is shaken, the others are braked or servoed.",
        ),
        further=[
            Section(
                heading="The signal",
                tables=[signals],
                cards=[
                    FigureCard(
                        title=f"Command of {signal.joint}",
                        image=_signal_figure(plan, signal),
                        caption="Above: the command over time. Below: its spectrum.",
                    )
                    for signal in plan.signals
                ],
            ),
            Section(
                heading="Peaks and limits",
                points=[sentence(begun(line)) for line in limits],
                tables=[_peak_table(plan, signal) for signal in plan.signals],
            ),
            Section(heading="Runs", tables=[Table(rows=runs, note=run_note)]),
            Section(heading="Expected observations", tables=[expected]),
        ],
        lines=lines,
    )


def _indented(table: Table, prefix: str = "  ", *, heads: bool = True) -> list[str]:
    """Rows of a table for the terminal."""
    rows = [*([table.columns] if heads else []), *(list(row.values()) for row in table.rows)]
    return [f"{prefix}{line}" for line in aligned(rows)] if rows else []


def _signal_table(plan: Plan) -> Table:
    rows = []
    for signal in plan.signals:
        j = plan.arm.joints.index(signal.joint)
        unit, turn = ("N", "m") if plan.arm.nominal.sliding[j] else ("N·m", "rad")
        rows.append(
            {
                "Joint": signal.joint,
                "Noise, rms": f"{signal.drive_rms:.3g} {unit}",
                "Peak": f"{signal.torque_peaks[j]:.3g} {unit}",
                "Drive's limit": f"{plan.arm.nominal.torque_limits[j]:g} {unit}",
                "Joint, rms": f"{signal.joint_rms:.3g} {turn}/s²",
                "Tool, rms": f"{signal.tool_rms:.3g} m/s²",
                "Travel": f"{signal.travel[j] * 1e3:.2g} m{turn}",
            }
        )
    note = (
        "Predictions of the nominal model: torque of the noise, its peak with the holding torque "
        "included, acceleration of joint and tool, travel of the joint. Peaks stay within the "
        "share of each drive's torque that was allowed."
    )
    return Table(rows=rows, note=note)


def _peak_table(plan: Plan, signal: Signal) -> Table:
    """Peaks of a run beside their limits: of the shaken joint, and of others near a limit."""
    rows = [
        {
            "Quantity": f"{peak.quantity} of the {peak.of}",
            "Joint": peak.joint,
            "Peak": f"{peak.value:.3g} {peak.unit}",
            "Limit": "none" if peak.limit is None else f"{peak.limit:.3g} {peak.unit}",
            "Source": peak.source or "not stated",
        }
        for peak in signal.peaks
        if peak.joint == signal.joint or (peak.limit is not None and 2 * peak.value >= peak.limit)
    ]
    note = "No limit lowers its level."
    if signal.limited_by:
        note = f"It is shaken at {signal.scale:.0%} of the wanted level: {signal.limited_by}."
    return Table(rows=rows, note=f"Run that shakes {signal.joint}. {note}")


def _limit_lines(plan: Plan) -> list[str]:
    """Limits of the joints with their sources, one line for each quantity."""
    lines, arm = [], plan.arm
    for quantity in QUANTITIES:
        values, sources = plan.limits.values[quantity], plan.limits.sources[quantity]
        if not np.isfinite(values).any():
            lines.append(f"{quantity}: no limit stated")
            continue
        groups: dict[tuple[float, str, bool], list[str]] = {}
        for k, name in enumerate(arm.joints):
            key = float(values[k]), sources[k], bool(arm.nominal.sliding[k])
            groups.setdefault(key, []).append(name)
        said = []
        for (value, source, sliding), names in groups.items():
            whose = "all joints" if len(names) == len(arm.joints) else ", ".join(names)
            limit = (
                f"{value:.4g} {unit_of(quantity, sliding)}" if np.isfinite(value) else "no limit"
            )
            said.append(f"{whose} {limit}" + (f" ({source})" if source else ""))
        lines.append(f"{quantity}: {'; '.join(said)}")
    width = plan.limits.bandwidth_hz
    stated = f"{width:g} Hz (--command-bandwidth-hz)" if np.isfinite(width) else "not stated"
    return [*lines, f"command bandwidth: {stated}"]


def _expected_table(plan: Plan) -> Table:
    plain, rows = _plain_names(plan), []
    for name, one in sorted(plan.expected.items(), key=lambda item: -item[1].probability):
        along = one.direction_tool
        lost = "any direction" if along is None else " ".join(f"{x:+.2f}" for x in along)
        if one.probability >= _LISTED:
            rows.append(
                {
                    "Hypothesis": plain[name],
                    "Probability": percent(one.probability),
                    "Motion is lost along": "nothing" if name == "healthy" else typographic(lost),
                    "Share lost": "0 %" if name == "healthy" else percent(one.lost),
                    "z-score": f"{one.deviations:.1f}",
                }
            )
    note = (
        f"For a free travel of {plan.settings.get('gap_mm', 0.1):g} mm. Directions are those of "
        "the tool frame, without sign. The last column is the z-score of the change of the tool's "
        "motion, by the errors of sensors and nominal model: detectable from 4."
    )
    return Table(rows=rows, note=note)


def _signal_figure(plan: Plan, signal: Signal) -> Figure:
    actuator = _drive(plan, signal).actuator
    name, command = f"ctrl.{actuator}", signal.commands[actuator]
    if signal.kind != "model":
        name = f"{signal.kind}.{signal.joint}"
        command = signal.played[name]
    figure, (above, below) = panels(2, 2.0)
    above.plot(signal.time, command, color=MEASURED, linewidth=0.5)
    for edge in signal.steady_s:
        above.axvline(edge, color=MUTED, linewidth=0.8, linestyle="--")
    above.set_xlim(0, signal.time[-1])
    labels(above, x="time [s]", above=name)
    inside = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    count = max(min(int(inside.sum()), int(signal.rate_hz / 2)), 8)
    frequency, power = welch(command[inside] - command.mean(), signal.rate_hz, nperseg=count)
    shown = frequency <= 2 * plan.next.band_hz[1]
    below.plot(frequency[shown], np.sqrt(power[shown]), color=INK, linewidth=0.9)
    below.set_ylim(bottom=0)
    below.ticklabel_format(axis="y", scilimits=(-2, 3))  # long numbers push the label out
    labels(below, x="frequency [Hz]", above="per √Hz")
    return figure


def _plain_names(plan: Plan) -> dict[str, str]:
    """Each hypothesis of a plan in a few words."""
    arm, found = plan.arm, {}
    for name in plan.expected:
        kind, _, where = name.partition("@")
        if kind == "backlash":  # the arm has a name of its own in the place of a reserved one
            where = arm.nominal.joints[arm.joints.index(where)]
        found[name] = short_name(arm.nominal, f"{kind}@{where}" if where else kind)
    return found


def _file_words(plan: Plan, stem: str) -> str:
    """Names of a signal's files, the first outside brackets."""
    formats = plan.settings.get("signal_format") or ("csv", "parquet")
    first, *others = (f"{stem}{_FILE_ENDINGS[name]}" for name in formats)
    return f"{first} (or {', '.join(others)})" if others else first


def _transit(plan: Plan) -> str:
    """Sentence about the move to the pose."""
    move = plan.transit
    if move.duration_s == 0:
        return "The arm is there already."
    speeds = (peak for peak in move.peaks if peak.quantity == "speed" and peak.limit)
    fastest = max(speeds, key=lambda peak: peak.value / (peak.limit or 1.0))
    return (
        f"{_file_words(plan, TRANSIT)} moves all joints there together in {move.duration_s:.1f} s, "
        f"{fastest.joint} at up to {fastest.value:.2g} {fastest.unit}; it begins at "
        f"{plan.start_origin}."
    )


def _steps(plan: Plan, planned: Sequence[PlannedRun]) -> list[str]:
    arm = plan.arm
    runs = [one.file for one in planned if one.kind == "run"]
    said = [f"{_move_words(plan, _transit(plan))} Keep everybody out of its reach."]
    for signal, run, stem in zip(plan.signals, runs, signal_stems(plan.signals), strict=True):
        said.append(_play_words(plan, signal, stem))
        origin = (
            "The torques are those of the drives as the controller measures them; leave out their "
            "columns where it does not"
        )
        if signal.kind == "model":
            servo = _drive(plan, signal).servo
            given = "the torques that were really given, the controller's part included"
            origin = f"The commands are {f'those of {stem}.csv' if servo else given}"
        said.append(
            f"Save the readings as recording/{run} with the columns "
            f"{', '.join(run_columns(plan))}. {origin}; accelerations are in m/s² as the sensor "
            "gives them, gravity included, along the axes of the site "
            f"{arm.recording_model.site!r}."
        )
    repeats = [one for one in planned if one.kind == "repeat"]
    if repeats:
        names = ", ".join(f"recording/{one.file}" for one in repeats)
        again = "" if repeats[0].pose == plan.next.pose else " Move back to the first pose for it."
        times = "once" if len(repeats) == 1 else f"{len(repeats)} times"
        said.append(
            f"When the session ends, play the first run's signal {_file_words(plan, FIRST)} "
            f"{times} more in its pose, as {names}: what differs from the first run is drift and "
            f"scatter of machine and sensors.{again} A repeat that is not there is left out."
        )
    references = [f"recording/{one.file}" for one in planned if one.kind == "reference"]
    if references:
        said.append(
            f"On the same machine when it is healthy, play the same as {', '.join(references)}: "
            "with a reference faults are found by the difference of two measurements, without the "
            "errors of the model. References count as soon as their files are there."
        )
    return [*said, _LAST]


def _drive(plan: Plan, signal: Signal) -> JointDrive:
    drive = plan.arm.drives[plan.arm.joints.index(signal.joint)]
    assert drive is not None
    return drive


def _play_words(plan: Plan, signal: Signal, stem: str) -> str:
    """Step in which one signal is played."""
    drive, band = _drive(plan, signal), plan.next.band_hz
    what, others = _KINDS.get(signal.kind, ""), "The other columns hold the arm."
    if signal.kind != "model":
        others = f"{signal.joint} is shaken, the others stay in the pose."
    elif drive.servo:
        first = ", ".join(f"{name} at {value:.4g}" for name, value in signal.start.items())
        others += (
            f" It begins with {first}: the arm has to stand under these commands, or it jumps."
        )
    else:
        others = (
            "Torque alone holds no pose: let your controller keep every joint near its place, slow "
            f"enough to leave the noise alone (below {band[0] / 4:.0f} Hz), and add the signal to "
            "what it gives."
        )
    sliding = bool(plan.arm.nominal.sliding[plan.arm.joints.index(signal.joint)])
    return (
        f"Start the recorder at {plan.next.rate_hz:g} times a second or faster, then play "
        f"{_file_words(plan, stem)} at {signal.rate_hz:g} commands a second: "
        f"{what or f'{_unit_words(drive, sliding)} for {drive.actuator}'}, {signal.time[-1]:.2f} s "
        f"long, noise from {band[0]:g} to {band[1]:g} Hz. {others}"
    )


def _unit_words(drive: JointDrive, sliding: bool) -> str:
    """Kind and unit of a signal's commands."""
    if drive.servo:
        unit = "m" if sliding else "rad"
        ratio = float(drive.command(0.0, 1.0)) - float(drive.command(0.0, 0.0))
        own = unit if np.isclose(ratio, 1.0) else f"{ratio:g} for each {unit} of the joint"
        return f"position commands ({own})"
    what, unit = ("force", "N") if sliding else ("torque", "N·m")
    own = "" if np.isclose(drive.gain, 1.0) else f" (1 gives {drive.gain:g} {unit})"
    return f"{what} commands{own}"


# A tool that is struck or shaken


def _tool_sheet(plan: ToolPlan) -> _Sheet:
    act, nominal = "strike" if plan.kind == "hammer" else "shake", plan.arm.nominal
    names = " and ".join(run.name for run in plan.runs)
    opened = [
        {"Direction": run.name} | {link: percent(share) for link, share in run.opens.items()}
        for run in plan.runs
    ]
    table = Table(
        rows=opened,
        note="Share of a seat's motion that the force frees against gravity, by link. Directions "
        "are axes of the tool's frame.",
    )
    way = f"way to the pose: {plan.transit.duration_s:.1f} s"
    return _Sheet(
        title=f"Next: {act} the tool along {names}",
        answers={
            "Reason": "of the candidate poses, this one lets a force on the tool open most seats",
            "Duration and level": f"{len(plan.runs)} runs of {plan.seconds:g} s at "
            f"{plan.rate_hz:g} samples a second; {plan.force_n:g} N rms from {plan.band_hz[0]:g} "
            f"to {plan.band_hz[1]:g} Hz",
        },
        pose=Table(
            rows=[{"Joint": n, "Hold at": v} for n, v in _positions(plan).items()],
            note="From the base.",
        ),
        card=FigureCard(
            title="Pose of the arm",
            image=arm_figure(
                nominal, dict(zip(nominal.joints, plan.pose, strict=True)), excited=()
            ),
            caption="The controller holds all joints.",
        ),
        further=[Section(heading="Expected opening of the seats", tables=[table])],
        lines=["seats open by", *_indented(table), way],
    )


def _tool_steps(plan: ToolPlan, planned: Sequence[PlannedRun]) -> list[str]:
    move = "The arm is there already."
    if plan.transit.duration_s > 0:
        move = f"transit moves all joints there together in {plan.transit.duration_s:.1f} s."
    act = _ACTS[plan.kind].format(contact=1e3 * _PULSE_BAND / plan.band_hz[1])
    said = [
        _move_words(plan, move) + " Let the controller hold it, with constant commands.",
        *(
            f"Start the recorder at {plan.rate_hz:g} samples a second or faster. For "
            f"{plan.seconds:g} s {act}, along {one.signal} of the tool's frame and through the "
            f"origin of the site {plan.arm.recording_model.site!r}, with {plan.force_n:g} N rms. "
            f"Save the readings as recording/{one.file}."
            for one in planned
            if one.kind == "run"
        ),
        f"Columns: {', '.join(plan.columns)}. The force is the one on the tool in N, in the axes "
        "of the site, its sign that of the push; accelerations are in m/s² as the sensor gives "
        "them, gravity included.",
    ]
    repeats = [one.file for one in planned if one.kind == "repeat"]
    if repeats:
        said.append(
            f"When the session ends, repeat the first run as {', '.join(repeats)}: what differs is "
            "drift and scatter. A repeat that is not there is left out."
        )
    references = [f"{one.file} ({one.signal})" for one in planned if one.kind == "reference"]
    if references:
        names = ", ".join(references)
        said.append(f"On the same machine when it is healthy, do the same as {names}.")
    return [*said, _LAST]
