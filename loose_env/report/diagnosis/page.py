"""Page of a diagnosis: result and next steps in words, figures and tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from loose_env.arms import Arm
from loose_env.instrument import HEALTHY, Diagnosis, NextMeasurement, RecordSeen
from loose_env.io import sentence
from loose_env.report.diagnosis.arm_figure import arm_figure
from loose_env.report.diagnosis.figures import loop_figure, posterior_figure, shown_hypotheses
from loose_env.report.diagnosis.hypotheses import hypothesis_table
from loose_env.report.diagnosis.spectra import spectra_cards
from loose_env.report.diagnosis.text import (
    correction_commands,
    headline,
    joint_words,
    percent,
    position_text,
    short_name,
    steps,
    summary_words,
)
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import graded, group
from loose_env.report.pages.template import template, write_whole

__all__ = ["page_of", "write_page"]

_LOOPS = 12
"""Records whose loops are drawn."""
_BARS = 24
"""Bars of the posterior."""


def write_page(
    path: str | os.PathLike[str],
    diagnosis: Diagnosis,
    arm: Arm,
    *,
    recording: str = "",
    folder: str = "",
) -> Path:
    """Write the page, beside its final name first.

    Parameters
    ----------
    path : path-like
        Path of the page; its folder is made if missing.
    diagnosis : Diagnosis
        Diagnosis.
    arm : Arm
        The nominal arm that it was found with.
    recording : str
        Name of the recording, for the head of the page.
    folder : str
        Path of the recording, for commands to be typed.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InvalidData
        If the diagnosis names a joint or a link that the arm does not have.
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    return write_whole(path, page_of(diagnosis, arm, recording=recording, folder=folder))


def page_of(diagnosis: Diagnosis, arm: Arm, *, recording: str = "", folder: str = "") -> str:
    """Return the page that `write_page` writes."""
    first = [
        _to_do_group(diagnosis, arm, folder or recording or "RECORDING"),
        group("Hypotheses", "", tables=[hypothesis_table(diagnosis, arm)]),
        group("Measured and predicted transmission", "", cards=spectra_cards(diagnosis, arm)),
    ]
    groups = [
        _found_group(diagnosis, arm),
        _next_group(diagnosis, arm),
        _loops_group(diagnosis, arm),
        _records_group(diagnosis, arm),
    ]
    page: str = template("loose_env.report/diagnosis_page.html").render(
        title=headline(diagnosis, arm),
        kicker=" · ".join(
            filter(None, [recording, "diagnosis of a loose link or joint", diagnosis.date[:10]])
        ),
        summary=summary_words(diagnosis, arm),
        questions=[],
        first=[each for each in first if each],
        warnings=graded([(s, sentence(w)) for s, w in diagnosis.graded_warnings]),
        groups=[each for each in groups if each],
        notes=_notes(diagnosis, arm),
    )
    return page


def _to_do_group(diagnosis: Diagnosis, arm: Arm, folder: str) -> dict[str, Any]:
    """Section of the next steps, with the commands where the model has to be corrected."""
    return group(
        "What to do next",
        "",
        points=steps(diagnosis, arm),
        code=correction_commands(folder) if diagnosis.verdict == "model_mismatch" else "",
    )


def _found_group(diagnosis: Diagnosis, arm: Arm) -> dict[str, Any]:
    """Section of the result: the arm in its last pose, and the probabilities by record."""
    return group(
        "Arm and probabilities",
        "",
        cards=[_arm_card(diagnosis, arm), *_posterior_cards(diagnosis, arm)],
    )


def _arm_card(diagnosis: Diagnosis, arm: Arm) -> FigureCard:
    fault = diagnosis.fault
    suspect = [r for r in diagnosis.records if r.condition != HEALTHY]
    last = suspect[-1] if suspect else None
    if fault.where is None:
        marked = "Nothing is marked: nothing is suspected."
    else:
        said = short_name(arm, fault.hypothesis)
        marked = f"Marked: {said} ({percent(diagnosis.probability)})."
    return FigureCard(
        title="The last pose measured" if last else "The arm, all joints at zero",
        image=arm_figure(
            arm,
            last.pose if last else {},
            fault=fault,
            excited=last.excited if last else None,
        ),
        caption=f"{marked} {_numbers(arm)}".strip(),
    )


def _numbers(arm: Arm) -> str:
    """Table of joint numbers and names, where the names lack the numbers."""
    names = [f"{k} {name}" for k, name in enumerate(arm.joints, 1)]
    if all(name == f"joint{k}" for k, name in enumerate(arm.joints, 1)):
        return ""
    return f"Joints from the base: {', '.join(names)}."


def _next_group(diagnosis: Diagnosis, arm: Arm) -> dict[str, Any]:
    following = diagnosis.next
    if following is None:
        return {}
    pose = [
        {"Joint": joint_words(arm, joint), "Hold at": position_text(arm, joint, value)}
        | {"In the recording": f"{value:.4f}".replace("-", "−") + _unit(arm, joint)}
        for joint, value in following.pose.items()
    ]
    card = FigureCard(
        title="The pose to measure next",
        image=arm_figure(arm, following.pose, fault=diagnosis.fault, excited=following.joints),
        caption="Shake the joint in yellow, hold the others."
        if len(following.joints) == 1
        else "Shake the joints in yellow one after the other, hold the others.",
    )
    return group(
        "The next measurement",
        _expects(following),
        cards=[card],
        beside=True,
        tables=[
            {"title": "", "rows": pose, "note": "Positions from the base, every joint held there."},
            {
                "title": "Excitation",
                "rows": [
                    {
                        "Joint to shake": joint_words(arm, joint),
                        "Band": f"{following.band_hz[0]:g} to {following.band_hz[1]:g} Hz",
                        "Acceleration, rms": f"{level:.3g}{_unit(arm, joint)}/s²",
                        "Drive, rms": f"{torque:.3g} {'N' if _slides(arm, joint) else 'N·m'}",
                        "Length": f"{following.seconds:g} s",
                        "Sampling rate": f"{following.rate_hz:g} Hz",
                    }
                    for joint, level, torque in zip(
                        following.joints, following.levels, following.torques, strict=True
                    )
                ],
                "note": "Random noise in the band, one run for each joint. The drive is what the "
                "nominal model needs for this acceleration; check it against the drive's limits "
                "before it is played.",
            },
        ],
    )


def _expects(following: NextMeasurement) -> str:
    if following.gain > 0:
        return (
            f"Expected information: {following.gain:.2g} bits about the fault; one bit halves "
            "the possibilities."
        )
    return ""


def _slides(arm: Arm, joint: str) -> bool:
    return joint in arm.joints and bool(arm.sliding[arm.joints.index(joint)])


def _unit(arm: Arm, joint: str) -> str:
    return " m" if _slides(arm, joint) else " rad"


def _posterior_cards(diagnosis: Diagnosis, arm: Arm) -> list[FigureCard]:
    seen = [(k, r) for k, r in enumerate(diagnosis.records, 1) if r.probabilities]
    if not seen:
        return []
    shown = seen[-_BARS:]
    steps = [dict(r.probabilities) for _, r in shown]
    names = {h: short_name(arm, h) for h in shown_hypotheses(steps)}
    dropped = len(seen) - len(shown)
    return [
        FigureCard(
            title="Probability by record",
            image=posterior_figure(steps, [f"record {k}" for k, _ in shown], names),
            caption="Probability of every explanation after each record and all before it, in per "
            "cent. A record supports an explanation that predicted the measurement. The "
            "records are numbered as in the table at the end."
            + (f" The first {dropped} are not drawn." if dropped else ""),
        )
    ]


def _loops_group(diagnosis: Diagnosis, arm: Arm) -> dict[str, Any]:
    drawn = [(k, r) for k, r in enumerate(diagnosis.records, 1) if r.loops]
    dropped = len(drawn) - _LOOPS
    cards = [
        FigureCard(
            title=f"Record {number}: {', '.join(record.excited) or 'nothing'} shaken",
            image=loop_figure(record),
            caption=_loop_words(record, arm),
        )
        for number, record in drawn[-_LOOPS:]
    ]
    return group(
        "Correlation by record",
        "Correlation of the tool with the excited joint, by direction. The distance of the "
        "curve from the middle is the correlation; on the circle it is 1. Where a link is loose, "
        "the measured curve turns away from that of the healthy arm. The direction in which motion "
        "is lost turns from pose to pose only if a joint between the loose link and the tool was "
        "moved: that is how the link is found."
        + (f" The first {dropped} records are not drawn." if dropped > 0 else ""),
        cards=cards,
    )


def _loop_words(record: RecordSeen, arm: Arm) -> str:
    pose = ", ".join(position_text(arm, joint, value) for joint, value in record.pose.items())
    said = f"Pose {pose}." if pose else ""
    if record.direction_tool is None:
        return f"{said} No direction in which motion is lost stands out.".strip()
    axis = ", ".join(f"{x:.2f}".replace("-", "−") for x in record.direction_tool)
    within = "" if record.half_angle_deg is None else f", within {record.half_angle_deg:.0f}°"
    return (
        f"{said} By all records together, motion is lost along ({axis}) of the tool's frame here"
        f"{within}."
    ).strip()


def _records_group(diagnosis: Diagnosis, arm: Arm) -> dict[str, Any]:
    rows = []
    for number, record in enumerate(diagnosis.records, 1):
        best = max(record.probabilities.items(), key=lambda item: item[1], default=None)
        rows.append(
            {
                "Record": str(number),
                "File": record.file,
                "Arm": "healthy" if record.condition == HEALTHY else record.condition,
                "Excited joints": ", ".join(record.excited) or "–",
                "Pose": ", ".join(position_text(arm, j, v) for j, v in record.pose.items()) or "–",
                "Most probable then": "–"
                if best is None
                else f"{short_name(arm, best[0])}, {percent(best[1])}",
            }
        )
    notes = [
        f"Record {number}: {sentence(note)}"
        for number, record in enumerate(diagnosis.records, 1)
        for note in record.notes
    ]
    return group(
        "Records",
        "",
        tables=[
            {"rows": rows, "note": " ".join(["The pose lists the joints from the base.", *notes])}
        ],
    )


def _notes(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    settings = ", ".join(
        f"{name} {value}"
        for name, value in diagnosis.settings.items()
        if not isinstance(value, dict)
    )
    by = " ".join(filter(None, ["loose-env", diagnosis.version]))
    hashed = f" (SHA-256 {diagnosis.model_hash})" if diagnosis.model_hash else ""
    measured = f"Measured {diagnosis.date}. " if diagnosis.date else ""
    return [
        f"{measured}Diagnosed by {by}. Model: {diagnosis.model}{hashed}, {arm.n} joints. All "
        "numbers stand in result.json.",
        *([f"Settings: {settings}."] if settings else []),
    ]
