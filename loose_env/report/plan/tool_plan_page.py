"""Page and text of a plan whose tool is struck by a hammer or shaken by a shaker."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loose_env.instrument import RECORDING, PlannedRun, ToolPlan, option_words, path_word
from loose_env.io import sentence
from loose_env.report.diagnosis.arm_figure import arm_figure
from loose_env.report.diagnosis.text import percent, position_text
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import graded, group
from loose_env.report.pages.template import template, write_whole

__all__ = ["tool_steps", "tool_summary", "write_tool_page"]

_ACTS = {
    "hammer": "strike the tool some ten times a second, not in step, with a tip hard enough that a "
    "blow lasts {contact:.0f} ms or less",
    "shaker": "play signal.csv (force.tool in N) on the shaker, whose force sensor sits between "
    "it and the tool",
}
_PULSE_BAND = 0.75
"""Length of a blow times the upper end of the band: its spectrum has its first zero at twice that
[1]."""


def tool_steps(plan: ToolPlan, planned: Sequence[PlannedRun]) -> list[str]:
    """Steps at the machine in order.

    Parameters
    ----------
    plan : ToolPlan
        The plan.
    planned : sequence of PlannedRun
        Its runs.
    """
    pose = ", ".join(f"{name} {value}" for name, value in _pose_rows(plan))
    move = "The arm is there already."
    if plan.transit.duration_s > 0:
        move = f"transit moves all joints there together in {plan.transit.duration_s:.1f} s."
    act = _ACTS[plan.kind].format(contact=1e3 * _PULSE_BAND / plan.band_hz[1])
    said = [
        f"Move the arm to the pose: {pose}. Look first that nothing is in its way. {move} Let the "
        "controller hold it, with constant commands."
    ]
    for one in planned:
        if one.kind != "run":
            continue
        said.append(
            f"Start the recorder at {plan.rate_hz:g} samples a second or faster. For "
            f"{plan.seconds:g} s {act}, along {one.signal} of the tool's frame and through the "
            f"origin of the site {plan.arm.recording_model.site!r}, with {plan.force_n:g} N rms. "
            f"Save the readings as recording/{one.file}."
        )
    said.append(
        f"Columns: {', '.join(plan.columns)}. The force is the one on the tool in N, in the axes "
        "of the site, its sign that of the push; accelerations are in m/s² as the sensor gives "
        "them, gravity included."
    )
    repeats = [one.file for one in planned if one.kind == "repeat"]
    if repeats:
        said.append(
            f"When the session ends, repeat the first run as {', '.join(repeats)}: what differs is "
            "drift and scatter. A repeat that is not there is left out."
        )
    references = [one for one in planned if one.kind == "reference"]
    if references:
        names = ", ".join(f"{one.file} ({one.signal})" for one in references)
        said.append(f"On the same machine when it is healthy, do the same as {names}.")
    said.append("Run the two commands below: the first says what is loose, the second goes on.")
    return said


def tool_summary(plan: ToolPlan) -> str:
    """A plan in a few lines, for a terminal."""
    rows = _pose_rows(plan)
    width = max(len(name) for name, _ in rows)
    lines = ["pose", *(f"  {name.ljust(width)}  {value:>10}" for name, value in rows)]
    act = "strike" if plan.kind == "hammer" else "shake"
    for run in plan.runs:
        opened = ", ".join(f"{link} {percent(share)}" for link, share in run.opens.items())
        lines.append(f"{act} the tool along {run.name}, {plan.force_n:g} N rms")
        lines.append(f"  seats open by: {opened}")
    lines.append(
        f"force within {plan.band_hz[0]:g} to {plan.band_hz[1]:g} Hz for {plan.seconds:g} s, "
        f"{plan.rate_hz:g} samples a second"
    )
    lines.append(f"way to the pose: {plan.transit.duration_s:.1f} s")
    return "\n".join(lines)


def write_tool_page(
    path: str | Path,
    plan: ToolPlan,
    planned: Sequence[PlannedRun],
    *,
    folder: str | Path,
    model: str | Path,
) -> Path:
    """Write the page, beside its final name first.

    Parameters
    ----------
    path : path-like
        Path of the page.
    plan : ToolPlan
        The plan.
    planned : sequence of PlannedRun
        Its runs.
    folder, model : str or Path
        The plan's folder and the model, as the commands on the page are to name them.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    found = path_word(Path(folder) / "diagnosis")
    commands = [
        f"loose diagnose {path_word(Path(folder) / RECORDING)} --out {found}",
        f"loose plan {path_word(model)} --out {path_word(folder)} --known {found}"
        f"{option_words(plan.again)}",
    ]
    nominal = plan.arm.nominal
    pose = dict(zip(nominal.joints, plan.pose.tolist(), strict=True))
    act = "Strike" if plan.kind == "hammer" else "Shake"
    directions = [
        {"Direction": run.name} | {link: percent(share) for link, share in run.opens.items()}
        for run in plan.runs
    ]
    page: str = template("loose_env.report/diagnosis_page.html").render(
        title=f"Next: {act.lower()} the tool along {' and '.join(r.name for r in plan.runs)}",
        kicker=f"{plan.arm.path.name} · the next measurement",
        questions=[
            (
                "Reason",
                ["Of the candidate poses, this one lets a force on the tool open most seats."],
            ),
            (
                "Duration and level",
                [
                    f"{len(plan.runs)} runs of {plan.seconds:g} s at {plan.rate_hz:g} samples a "
                    f"second; {plan.force_n:g} N rms from {plan.band_hz[0]:g} to "
                    f"{plan.band_hz[1]:g} Hz."
                ],
            ),
        ],
        summary=[],
        first=[],
        warnings=graded([("warning", sentence(warning)) for warning in plan.warnings]),
        groups=[
            group("Steps", "", points=tool_steps(plan, planned), code="\n".join(commands)),
            group(
                "The pose",
                "",
                cards=[
                    FigureCard(
                        title="Pose of the arm",
                        image=arm_figure(nominal, pose, excited=()),
                        caption="The controller holds all joints.",
                    )
                ],
                beside=True,
                tables=[
                    {
                        "rows": [{"Joint": n, "Hold at": v} for n, v in _pose_rows(plan)],
                        "note": "From the base.",
                    }
                ],
            ),
            group(
                "Expected opening of the seats",
                "",
                tables=[
                    {
                        "rows": directions,
                        "note": "Share of a seat's motion that the force frees against gravity, by "
                        "link. Directions are axes of the tool's frame.",
                    }
                ],
            ),
        ],
        notes=[],
    )
    return write_whole(path, page)


def _pose_rows(plan: ToolPlan) -> list[tuple[str, str]]:
    return [
        (name, position_text(plan.arm.nominal, own, float(q)))
        for name, own, q in zip(plan.arm.joints, plan.arm.nominal.joints, plan.pose, strict=True)
    ]
