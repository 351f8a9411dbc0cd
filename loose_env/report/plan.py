"""Report of a planned session as text and page: poses, signal, limits, steps, what is tested."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loose_env.instrument.controllers import preset
from loose_env.instrument.plan import RECORDING, Plan, PlannedRun
from loose_env.instrument.poses import is_tested_share
from loose_env.io import sentence, write_text
from loose_env.report.page import (
    Brief,
    Section,
    Table,
    named_list,
    render_page,
    warnings_section,
)
from loose_env.report.words import path_word, place_label

_TENTH = 10  # times smaller is the first run that is played
_LIGHTS = {"tested": "#009e73", "in part": "#e69f00", "not tested": "#8a8f98"}


def summary(plan: Plan) -> str:
    """A plan in a few lines, for a terminal."""
    runs, tested = _runs_table(plan), _tested_table(plan)
    untested = [name for name in plan.tested if name in plan.untested]
    rows = [list(row.values()) for row in tested.rows]
    return Brief(
        headline=_headline(plan),
        parts=[
            ("", "signal: ", [_signal_words(plan)]),
            ("", "limits: ", [", ".join(f"{k} {v}" for k, v in _limits(plan).items())]),
            ("", "  ", [runs.columns, *(list(row.values()) for row in runs.rows)]),
            ("", "", [_tested_words(plan)]),
            ("", "  ", [tested.columns, *rows] if untested else []),
            ("", "note: ", [sentence(words) for words in plan.notes]),
        ],
    ).text()


def plan_commands(folder: str | Path, model: str | Path) -> list[str]:
    """Commands after the runs: diagnose, then plan what is still open.

    Parameters
    ----------
    folder : str or Path
        Folder of the plan, as the reader types it.
    model : str or Path
        Model file, as the reader types it.

    Examples
    --------
    >>> plan_commands("session", "arm.xml")[0]
    'loose diagnose session/recording --out session/diagnosis'
    """
    session = Path(folder)
    found = path_word(session / "diagnosis")
    return [
        f"loose diagnose {path_word(session / RECORDING)} --out {found}",
        f"loose plan {path_word(model)} --out {path_word(session)} --known {found}",
    ]


def write_plan_page(
    path: str | os.PathLike[str], plan: Plan, *, folder: str | Path, model: str | Path
) -> Path:
    """Write the page of a plan, the sheet to take to the machine.

    Parameters
    ----------
    path : path-like
        Path of the page; its folder is made if missing.
    plan : Plan
        The plan.
    folder, model : str or Path
        Folder of the plan and model file, as the reader types them.

    Raises
    ------
    MissingExtra
        If jinja2 is not installed.
    """
    own = preset(plan.settings.controller)
    code = Section(
        heading=f"To play a run: {own.machine}", intro=[f"Log {own.log}."], code=own.code
    )
    limits = [{"Limit": name, "Value": value} for name, value in _limits(plan).items()]
    colours = {
        place_label(name): _LIGHTS[_tested_word(share)] for name, share in plan.tested.items()
    }
    peaks = _peaks_table(plan)
    page = render_page(
        _headline(plan),
        [
            Section(heading="Steps", points=_steps(plan)),
            Section(heading="Runs", tables=[_runs_table(plan)]),
            Section(heading="Peaks and limits", tables=[peaks, Table(rows=limits)]),
            Section(
                heading="What will be tested",
                intro=[_tested_words(plan)],
                tables=[_tested_table(plan)],
            ),
            code,
            Section(
                heading="Afterwards", intro=[_AFTER], code="\n".join(plan_commands(folder, model))
            ),
            warnings_section(("note", words) for words in plan.notes),
        ],
        kicker=[plan.model, "session to find a loose link or joint"],
        text=_signal_words(plan),
        notes="Predictions are those of the model as rigid bodies. All numbers stand in plan.json.",
        colours=colours,
    )
    return write_text(Path(path), page)


_AFTER = (
    "The first command says what is loose. The second plans what it left open, in the same folder; "
    "it is not needed where everything is settled."
)


def _under_test(plan: Plan) -> list[PlannedRun]:
    return [run for run in plan.runs if run.condition == "suspect"]


def _poses(plan: Plan) -> int:
    return len({tuple(run.pose.items()) for run in _under_test(plan)})


def _headline(plan: Plan) -> str:
    poses, seconds = _poses(plan), plan.seconds
    return f"Shake the arm in {poses} poses, {seconds:.0f} s in all"


def _signal_words(plan: Plan) -> str:
    lines, hertz = plan.signal, plan.signal.signal.hertz
    seconds = plan.signal.signal.seconds
    return (
        f"All joints shake together: {len(lines.excited)} odd lines from {hertz.min():g} to "
        f"{hertz.max():g} Hz, {lines.periods} periods of {lines.period_s:g} s after "
        f"{lines.lead_s:g} s to settle, {seconds:g} s a run, "
        f"{plan.settings.limits.commands} commands at {plan.settings.limits.rate_hz:g} Hz."
    )


def _limits(plan: Plan) -> dict[str, str]:
    """Limits of the controller in words."""
    own = plan.settings.limits

    def each(values: Sequence[float], unit: str) -> str:
        return f"{', '.join(f'{v:g}' for v in values)} {unit}" if values else "none stated"

    return {
        "speed": each(own.max_speed_rad_s, "rad/s (m/s)"),
        "acceleration": each(own.max_acceleration_rad_s2, "rad/s² (m/s²)"),
        "jerk": each(own.max_jerk_rad_s3, "rad/s³ (m/s³)"),
        "torque": each(own.max_torque_nm, "N·m (N)") if own.max_torque_nm else "as the model",
        "bandwidth": f"{own.bandwidth_hz:g} Hz",
    }


def _runs_table(plan: Plan) -> Table:
    rows = []
    for run in plan.runs:
        row = {"Run": run.file}
        if len({each.level for each in plan.runs}) > 1:
            row["Level"] = f"{100 * run.level:.0f} %"
        for joint, value in run.pose.items():
            slides = joint in plan.slides
            row[joint] = f"{1e3 * value:.0f} mm" if slides else f"{np.degrees(value):.1f}°"
        rows.append({**row, "Arm": "healthy" if run.condition == "healthy" else "under test"})
    return Table(rows=rows, note="Position that each joint shakes about, base first.")


def _peaks_table(plan: Plan) -> Table:
    """Peak acceleration of each joint in each run."""
    rows = [
        {
            "Run": run.file,
            **{j: f"{v:.3g} {'m' if j in plan.slides else 'rad'}/s²" for j, v in run.peak.items()},
        }
        for run in _under_test(plan)
    ]
    return Table(rows=rows, note="Peak acceleration of each joint.")


def _tested_word(share: float) -> str:
    return "tested" if is_tested_share(share) else "in part" if share > 0 else "not tested"


_WHY = {
    "tested": "its load reverses: it would knock if it were loose",
    "in part": "its load reverses in some directions alone",
    "not tested": "its load never reverses beyond friction: it would stay shut",
}


def _tested_table(plan: Plan) -> Table:
    """What the poses test, what they do not come first."""
    rows = [
        {
            "Place": place_label(name),
            "Tested": _tested_word(share),
            "Share": f"{100 * share:.0f} %",
            "Reason": _WHY[_tested_word(share)],
        }
        for name, share in sorted(plan.tested.items(), key=lambda item: item[1])
    ]
    return Table(rows=rows, note="Share: of a place's directions in which the load reverses.")


def _tested_words(plan: Plan) -> str:
    missing = [place_label(name).split(",")[0] for name in plan.untested]
    whole = len(plan.tested) - len(missing)
    said = f"{whole} of {len(plan.tested)} places are tested whole"
    return f"{said}; not {named_list(missing)}." if missing else f"{said}."


def _steps(plan: Plan) -> list[str]:
    run = _under_test(plan)[0]
    healthy = [each.file for each in plan.runs if each.condition == "healthy"]
    kind, unit = plan.settings.limits.commands, "as its columns are named, in SI units"
    said = [
        "Fix the accelerometer to the tool with a screw, not with tape, at the place that the "
        "model has; let no cable beat.",
        f"Move the arm to the pose of {run.file} (its first row). Look that nothing is in its way, "
        "and keep everybody out of its reach.",
        f"Play {run.file} at a tenth of its amplitude first, with a hand on the emergency stop: "
        "shrink the distance of each row from the first row. Stop if anything but a faint hum is "
        "heard.",
        f"Start the recorder, then play {run.file} whole ({kind}s, {unit}). Save positions and "
        f"accelerometer as {RECORDING}/{run.file}: columns time, sensor.NAME of the positions, "
        "sensor.NAME.x, .y, .z of the accelerometer, in m/s² with gravity.",
        "Go on with the next run: move, look, record, play. All runs belong to one session; leave "
        "screws and cables as they are.",
    ]
    if len(plan.settings.levels) > 1:
        said.append("Play the higher level only if the one below shows no knock.")
    if healthy:
        said.append(
            f"On the healthy machine play the same as {RECORDING}/{healthy[0]} to {healthy[-1]}: "
            "before the fault, or after the repair. They count as soon as they are there."
        )
    if plan.hobby:
        said.append(
            "Every arm of this class has play from the start: repeat the session each month and "
            "compare with loose trend."
        )
    return said
