"""Page of a plan: steps at the machine, pose, signal and expected observations."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import welch

from loose_env.envs import INK, MEASURED, MUTED
from loose_env.instrument import Plan, PlannedRun, Signal
from loose_env.io import sentence
from loose_env.report.diagnosis.arm_figure import arm_figure
from loose_env.report.diagnosis.text import percent, with_plain_names
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.figures import new_figure
from loose_env.report.pages.sections import graded, group
from loose_env.report.pages.template import template, write_whole
from loose_env.report.plan.plan_motion import limit_lines, peak_rows
from loose_env.report.plan.plan_text import (
    commands_after,
    plain_names,
    pose_rows,
    starts,
    steps,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plan_page", "write_plan_page"]

_LISTED = 0.005
"""Probability from which a hypothesis stands in the table [1]."""


def write_plan_page(
    path: str | os.PathLike[str],
    plan: Plan,
    runs: Sequence[str],
    *,
    folder: str | Path | None = None,
    model: str | Path | None = None,
    planned: Sequence[PlannedRun] = (),
) -> Path:
    """Write the page, beside its final name first.

    Parameters
    ----------
    path : path-like
        Path of the page.
    plan : Plan
        The plan.
    runs : sequence of str
        File of the recording that each signal's run goes into.
    folder, model : str or Path, optional
        The plan's folder and the model, as the commands on the page are to name them; by default
        the folder of the page, and the model as the plan has it.
    planned : sequence of PlannedRun
        All runs of the plan, repeats and references included.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    return write_whole(
        path,
        plan_page(plan, runs, folder=folder or Path(path).parent, model=model, planned=planned),
    )


def plan_page(
    plan: Plan,
    runs: Sequence[str],
    *,
    folder: str | Path = "DIR",
    model: str | Path | None = None,
    planned: Sequence[PlannedRun] = (),
) -> str:
    """Return the page that `write_plan_page` writes."""
    nominal, chosen, plain = plan.arm.nominal, plan.next, plain_names(plan)
    joints = " and ".join(chosen.joints)
    groups = [
        group(
            "Steps",
            "",
            points=steps(plan, tuple(runs), planned),
            code="\n".join(commands_after(plan, folder, model)),
        ),
        _pose_group(plan),
        _signal_group(plan),
        _limits_group(plan),
        *([_runs_group(planned)] if len(planned) > len(runs) else []),
        _expected_group(plan),
    ]
    page: str = template("loose_env.report/diagnosis_page.html").render(
        title=f"Next: shake {joints}",
        kicker=f"{plan.arm.path.name} · the next measurement",
        questions=[
            ("Reason", [sentence(with_plain_names(chosen.reason, plain))]),
            (
                "Duration and level",
                [
                    f"{len(plan.signals)} run{'s' * (len(plan.signals) > 1)} of "
                    f"{plan.signals[0].time[-1]:.1f} s at {chosen.rate_hz:g} samples a second; the "
                    f"tool is shaken by {_rms(plan.signals)} m/s² rms."
                ],
            ),
            ("Holding of the joints", [sentence(plan.arm.held_by)]),
        ],
        summary=[],
        first=[],
        warnings=graded(
            [("warning", sentence(with_plain_names(words, plain))) for words in plan.warnings]
        ),
        groups=[each for each in groups if each],
        notes=[
            f"The accelerometer is taken to sit at {plan.arm.report.tool} "
            f"({plan.arm.report.tool_origin}). The arm is {nominal.name}, {nominal.n} joints."
        ],
    )
    return page


def _pose_group(plan: Plan) -> dict[str, Any]:
    own = [plan.arm.nominal.joints[plan.arm.joints.index(j)] for j in plan.next.joints]
    pose = {
        a: plan.next.pose[j] for a, j in zip(plan.arm.nominal.joints, plan.arm.joints, strict=True)
    }
    return group(
        "The pose",
        "",
        cards=[
            FigureCard(
                title="Pose of the arm",
                image=arm_figure(plan.arm.nominal, pose, excited=own),
                caption="The joint in yellow is shaken, the others are held.",
            )
        ],
        beside=True,
        tables=[
            {
                "rows": [
                    {"Joint": name, "Hold at": value, "Command at the start": started}
                    for (name, value), started in zip(pose_rows(plan), starts(plan), strict=True)
                ],
                "note": "From the base. Commands are those of the signal's first row, in the "
                "actuator's own unit.",
            }
        ],
    )


def _signal_group(plan: Plan) -> dict[str, Any]:
    rows = []
    for signal in plan.signals:
        j = plan.arm.joints.index(signal.joint)
        slides = bool(plan.arm.nominal.sliding[j])
        unit, turn = ("N", "m") if slides else ("N·m", "rad")
        rows.append(
            {
                "Joint": signal.joint,
                "Noise torque, rms": f"{signal.drive_rms:.3g} {unit}",
                "Peak, holding torque included": f"{signal.torque_peaks[j]:.3g} {unit}",
                "Drive's limit": f"{plan.arm.nominal.torque_limits[j]:g} {unit}",
                "Joint, rms": f"{signal.joint_rms:.3g} {turn}/s²",
                "Tool, rms": f"{signal.tool_rms:.3g} m/s²",
                "Joint moves by": f"{signal.travel[j] * 1e3:.2g} m{turn}",
            }
        )
    return group(
        "The signal",
        "",
        cards=[
            FigureCard(
                title=f"Command of {signal.joint}",
                image=_figure(plan, signal),
                caption="Above: the command over time, swelling and dying away. Below: its "
                "spectrum.",
            )
            for signal in plan.signals
        ],
        tables=[
            {
                "rows": rows,
                "note": "Predictions of the nominal model. Peaks stay within the share "
                "of each drive's torque that was allowed.",
            }
        ],
    )


def _limits_group(plan: Plan) -> dict[str, Any]:
    tables = []
    for signal in plan.signals:
        note = f"Run that shakes {signal.joint}. "
        if signal.limited_by:
            note += f"It is shaken at {signal.scale:.0%} of the wanted level: {signal.limited_by}."
        else:
            note += "No limit lowers its level."
        tables.append({"rows": peak_rows(plan, signal), "note": note})
    return group(
        "Peaks and limits",
        "",
        points=[sentence(line[0].upper() + line[1:]) for line in limit_lines(plan)],
        tables=tables,
    )


def _runs_group(planned: Sequence[PlannedRun]) -> dict[str, Any]:
    rows = [
        {
            "Run": one.file,
            "Signal": one.signal,
            "Shaken joint": one.joint,
            "Condition": str(one.listed["condition"]),
            "Reason": str(one.listed["reason"]) or "new pose",
        }
        for one in planned
    ]
    return group(
        "Runs",
        "",
        tables=[{"rows": rows, "note": "Repeats and references may be measured later, or not."}],
    )


def _figure(plan: Plan, signal: Signal) -> Figure:
    j = plan.arm.joints.index(signal.joint)
    drive = plan.arm.drives[j]
    assert drive is not None
    figure = new_figure(4.2)
    above, below = figure.subplots(2, 1, height_ratios=(3, 2))
    figure.subplots_adjust(left=0.14, right=0.97, top=0.97, bottom=0.13, hspace=0.5)
    name, command = f"ctrl.{drive.actuator}", signal.commands[drive.actuator]
    if signal.kind != "model":
        name = f"{signal.kind}.{signal.joint}"
        command = signal.played[name]
    above.plot(signal.time, command, color=MEASURED, linewidth=0.5)
    for edge in signal.steady_s:
        above.axvline(edge, color=MUTED, linewidth=0.8, linestyle="--")
    above.set(xlabel="time [s]", ylabel=name, xlim=(0, signal.time[-1]))
    inside = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    rate = signal.rate_hz
    count = min(int(inside.sum()), int(rate / 2))
    frequency, power = welch(command[inside] - command.mean(), rate, nperseg=max(count, 8))
    shown = frequency <= 2 * plan.next.band_hz[1]
    below.plot(frequency[shown], np.sqrt(power[shown]), color=INK, linewidth=0.9)
    below.set(xlabel="frequency [Hz]", ylabel="per √Hz", ylim=(0, None))
    below.ticklabel_format(axis="y", scilimits=(-2, 3))  # long numbers push the label out
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=9)
    return figure


def _expected_group(plan: Plan) -> dict[str, Any]:
    plain = plain_names(plan)
    rows = []
    ranked = sorted(plan.expected.items(), key=lambda item: -item[1].probability)
    for name, one in ranked:
        if one.probability < _LISTED:
            continue
        seen = one.direction_tool
        rows.append(
            {
                "Hypothesis": plain[name],
                "Probability": percent(one.probability),
                "Motion is lost along": "nothing"
                if name == "healthy"
                else "any direction"
                if seen is None
                else " ".join(f"{x:+.2f}".replace("-", "−") for x in seen),
                "Share lost": "0 %" if name == "healthy" else percent(one.lost),
                "z-score": f"{one.deviations:.1f}",
            }
        )
    gap = plan.settings.get("gap_mm", 0.1)
    return group(
        "Expected observations",
        "",
        tables=[
            {
                "rows": rows,
                "note": f"For a free travel of {gap:g} mm. Directions are those of the tool frame, "
                "without sign. The last column is the z-score of the change of the tool's motion, "
                "by the errors of sensors and nominal model: detectable from 4.",
            }
        ],
    )


def _rms(signals: Sequence[Signal]) -> str:
    values = [signal.tool_rms for signal in signals]
    low, high = f"{min(values):.2g}", f"{max(values):.2g}"
    return low if low == high else f"{low} to {high}"
