"""Diagnosis as a notebook and a terminal show it: headline, hypotheses, next steps."""

from __future__ import annotations

from html import escape

from loose_env.arms import Arm
from loose_env.instrument import Diagnosis
from loose_env.io import sentence
from loose_env.report.diagnosis.hypotheses import hypothesis_table, listed
from loose_env.report.diagnosis.text import (
    correction_commands,
    headline,
    joint_words,
    position_text,
    short_name,
    steps,
    with_plain_names,
)
from loose_env.report.pages.notebook import aligned, bar, bullets, cells_table

__all__ = ["diagnosis_html", "diagnosis_text"]


def diagnosis_text(
    diagnosis: Diagnosis, arm: Arm, *, folder: str = "", warnings: bool = True
) -> str:
    """Diagnosis in a few lines of text.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    arm : Arm
        The nominal arm that it was found with.
    folder : str
        Path of the recording, for commands to be typed.
    warnings : bool
        True to end with the warnings.
    """
    rows = hypothesis_table(diagnosis, arm)["rows"]
    lines = [headline(diagnosis, arm)]
    lines += [f"  {line}" for line in aligned([tuple(rows[0]), *(tuple(r.values()) for r in rows)])]
    lines += [f"open: {reason}" for reason in _open(diagnosis)]
    lines += [f"next: {step}" for step in steps(diagnosis, arm)]
    lines += [
        f"  {words}" for words in [*_measurement(diagnosis, arm), *_commands(diagnosis, folder)]
    ]
    if warnings:
        lines += [f"{severity}: {sentence(words)}" for severity, words in diagnosis.graded_warnings]
    return "\n".join(lines)


def diagnosis_html(diagnosis: Diagnosis, arm: Arm, *, folder: str = "") -> str:
    """Diagnosis as a fragment of HTML, with the probabilities drawn as bars.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    arm : Arm
        The nominal arm that it was found with.
    folder : str
        Path of the recording, for commands to be typed.
    """
    names = {name: short_name(arm, name) for name in diagnosis.posterior}
    table = hypothesis_table(diagnosis, arm)["rows"]
    bars = [bar(diagnosis.posterior[name]) for name, _ in listed(diagnosis)]
    rows = [
        (row["Hypothesis"], drawn, *list(row.values())[1:])
        for row, drawn in zip(table, bars, strict=True)
    ]
    first, *others = table[0]
    commands = "\n".join(_commands(diagnosis, folder))
    warnings = [sentence(with_plain_names(words, names)) for _, words in diagnosis.graded_warnings]
    return "".join(
        [
            f"<p><strong>{escape(headline(diagnosis, arm))}</strong></p>",
            cells_table((first, "", *others), rows, markup=(1,)),
            bullets("Open", _open(diagnosis)),
            bullets("Next", steps(diagnosis, arm)),
            bullets("Next measurement", _measurement(diagnosis, arm)),
            f"<pre>{escape(commands)}</pre>" if commands else "",
            bullets("Warnings", warnings),
        ]
    )


def _open(diagnosis: Diagnosis) -> list[str]:
    """Reasons why no fault is named."""
    if diagnosis.verdict not in ("open", "model_mismatch"):
        return []
    return [sentence(reason) for reason in diagnosis.open_because]


def _measurement(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Pose and excitation of the next measurement."""
    following = diagnosis.next
    if following is None or diagnosis.verdict == "model_mismatch":
        return []
    pose = [f"{joint_words(arm, j)} {position_text(arm, j, q)}" for j, q in following.pose.items()]
    shaken = []
    for joint, torque in zip(following.joints, following.torques, strict=True):
        slides = joint in arm.joints and bool(arm.sliding[arm.joints.index(joint)])
        unit = "N" if slides else "N·m"
        shaken.append(f"{joint_words(arm, joint)} by {torque:.3g} {unit} rms")
    low, high = following.band_hz
    return [
        f"pose: {', '.join(pose)}",
        f"shake: {', '.join(shaken)}, {low:g} to {high:g} Hz, {following.seconds:g} s",
    ]


def _commands(diagnosis: Diagnosis, folder: str) -> list[str]:
    """Commands that correct the model, where it is not that of the arm."""
    if diagnosis.verdict != "model_mismatch":
        return []
    return correction_commands(folder or "RECORDING").splitlines()
