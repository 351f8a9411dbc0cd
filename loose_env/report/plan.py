"""Report of a planned session as text and page: poses, signal, limits, steps, what is tested."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loose_env.instrument import RECORDING, SWEEP, Plan, PlannedRun, is_tested_share, preset
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

_TESTED = {
    "tested": ("#009e73", "its load reverses: it would knock if it were loose"),
    "in part": ("#e69f00", "its load reverses in some directions alone"),
    "not tested": ("#8a8f98", "its load never reverses beyond friction: it would stay shut"),
}
"""How a place is tested -> its colour and the reason."""


def summary(plan: Plan) -> str:
    """A plan in a few lines, for a terminal."""
    runs, tested = _runs_table(plan), _tested_table(plan)
    rows = [list(row.values()) for row in tested.rows]
    return Brief(
        headline=_headline(plan),
        parts=[
            ("", "signal: ", [_signal_words(plan)]),
            ("", "  ", [runs.columns, *(list(row.values()) for row in runs.rows)]),
            ("", "", [_tested_words(plan)]),
            ("", "  ", [tested.columns, *rows] if plan.untested else []),
            ("", "note: ", [sentence(words) for words in plan.notes]),
        ],
    ).text()


def plan_commands(folder: str | Path, model: str | Path) -> list[str]:
    """Commands after the runs, by folder and model as typed: diagnose, then plan what is open.

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
    """Write the page of a plan; `folder` and `model` are as the reader types them.

    Raises
    ------
    MissingExtra
        If jinja2 is not installed.
    """
    own, commands = preset(plan.settings.controller), "\n".join(plan_commands(folder, model))
    tested = {place_label(name): _tested_word(share) for name, share in plan.tested.items()}
    page = render_page(
        _headline(plan),
        [
            Section(heading="Steps", points=_steps(plan)),
            Section(heading="Runs", tables=[_runs_table(plan)]),
            Section(heading="Peaks and limits", tables=[_peaks_table(plan)]),
            Section(
                heading="Tested places", intro=[_tested_words(plan)], tables=[_tested_table(plan)]
            ),
            Section(heading=f"Play: {own.machine}", intro=[f"Log {own.log}."], code=own.code),
            Section(heading="Afterwards", intro=[_AFTER], code=commands),
            warnings_section(("note", words) for words in plan.notes),
        ],
        kicker=[plan.model, "session to find a loose link or joint"],
        text=_signal_words(plan),
        notes="Predictions are those of the model as rigid bodies. All numbers stand in plan.json.",
        colours={label: _TESTED[word][0] for label, word in tested.items()},
    )
    return write_text(Path(path), page)


_AFTER = (
    "The first command says what is loose. The second plans what it left open, in the same folder; "
    "it is not needed where everything is settled."
)


def _under_test(plan: Plan) -> list[PlannedRun]:
    return [run for run in plan.runs if run.condition == "suspect"]


def _headline(plan: Plan) -> str:
    poses = {tuple(run.pose.items()) for run in _under_test(plan)}
    first = "" if plan.sweep is None else f"Play {SWEEP} and plan again. Then s"
    return f"{first or 'S'}hake the arm in {len(poses)} poses, {plan.seconds:.0f} s in all"


def _signal_words(plan: Plan) -> str:
    signal, limits = plan.signal.signal, plan.settings.limits
    levels = ", ".join(f"{100 * level:.0f} %" for level in plan.settings.levels)
    return (
        f"All joints shake together: {len(signal.excited)} odd lines from "
        f"{signal.hertz.min():g} to {signal.hertz.max():g} Hz, {signal.periods} periods of "
        f"{signal.period_s:g} s after {signal.lead_s:g} s to settle, {signal.seconds:g} s a run, "
        f"at {levels} of the limits, {limits.commands} commands at {limits.rate_hz:g} Hz."
    )


def _limit_words(values: Sequence[float], unit: str, joint: int) -> str:
    """Limit of a joint."""
    return f"{values[min(joint, len(values) - 1)]:g} {unit}" if values else "-"


def _peaks_table(plan: Plan) -> Table:
    """Peak acceleration of each joint beside the limits."""
    own, rows = plan.settings.limits, []
    for k, joint in enumerate(plan.joints):
        slides = joint in plan.slides
        unit, force = ("m", "N") if slides else ("rad", "N·m")
        peak = max(run.peak[joint] for run in _under_test(plan))
        rows.append(
            {
                "Joint": joint,
                "Peak": f"{peak:.3g} {unit}/s²",
                "Limit": _limit_words(own.max_acceleration_rad_s2, f"{unit}/s²", k),
                "Speed limit": _limit_words(own.max_speed_rad_s, f"{unit}/s", k),
                "Jerk limit": _limit_words(own.max_jerk_rad_s3, f"{unit}/s³", k),
                "Torque limit": _limit_words(own.max_torque_nm, force, k),
            }
        )
    note = (
        "Peak acceleration over the runs, and its limit. A dash: none is stated; torque limits are "
        f"then those of the model. The bandwidth is {own.bandwidth_hz:g} Hz."
    )
    return Table(rows=rows, note=note)


def _runs_table(plan: Plan) -> Table:
    rows = []
    for run in _under_test(plan):
        row = {"Run": run.file}
        if len(plan.settings.levels) > 1:
            row["Level"] = f"{100 * run.level:.0f} %"
        for joint, value in run.pose.items():
            slides = joint in plan.slides
            row[joint] = f"{1e3 * value:.0f} mm" if slides else f"{np.degrees(value):.1f}°"
        rows.append(row)
    return Table(rows=rows, note="Position that each joint shakes about, base first.")


def _tested_word(share: float) -> str:
    return "tested" if is_tested_share(share) else "in part" if share > 0 else "not tested"


def _tested_table(plan: Plan) -> Table:
    """What the poses test, what they do not come first."""
    rows = [
        {
            "Place": place_label(name),
            "Tested": _tested_word(share),
            "Share": f"{100 * share:.0f} %",
            "Reason": _TESTED[_tested_word(share)][1],
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
    run = plan.sweep or _under_test(plan)[0]
    healthy = [each.file for each in plan.runs if each.condition == "healthy"]
    kind = plan.settings.limits.commands
    way = "from that of the first row" if kind == "position" else "from zero"
    said = [
        "Fix the accelerometer to the tool with a screw, not with tape, at the place that the "
        "model has; let no cable beat.",
        f"Move the arm to the pose of {run.file} (its first row). Look that nothing is in its way, "
        "and keep everybody out of its reach.",
        f"Play {run.file} at a tenth of its amplitude first, with a hand on the emergency stop: "
        f"of each row a tenth of the distance {way}. Stop if more than a faint hum is heard.",
        f"Start the recorder half a second before and stop it half a second after: play {run.file} "
        f"whole ({kind} in SI units). Save positions and "
        f"accelerometer as {RECORDING}/{run.file}: columns time, sensor.NAME of the positions, "
        "sensor.NAME.x, .y, .z of the accelerometer, in m/s² with gravity; the names are those of "
        f"{RECORDING}/model.xml. loose import --guess makes it of the files of your loggers.",
        "Go on with the next run: move, look, record, play. All runs belong to one session; leave "
        "screws and cables as they are.",
    ]
    if plan.sweep is not None:
        said[4:4] = [f"Then plan again, by the same command: {SWEEP} measured how far the joints "
                     "follow, and all runs are written anew for that."]  # fmt: skip
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
