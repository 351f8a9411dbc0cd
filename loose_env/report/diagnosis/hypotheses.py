"""Table of the hypotheses of a diagnosis, for the page, the terminal and notebooks."""

from __future__ import annotations

from typing import Any

import numpy as np

from loose_env.arms import Arm
from loose_env.instrument import HEALTHY, Diagnosis
from loose_env.io import begun
from loose_env.report.diagnosis.text import percent, short_name

__all__ = [
    "data_words",
    "direction_words",
    "hypothesis_table",
    "listed",
    "travel_words",
]

_LISTED, _RANKED = 1e-3, 6
"""Probability from which a hypothesis stands in the table, and its rows at most."""
_TO_ARC_MINUTES = 60 * 180 / np.pi


def hypothesis_table(diagnosis: Diagnosis, arm: Arm) -> dict[str, Any]:
    """The one table of a diagnosis, most probable hypothesis first."""
    kept = listed(diagnosis)
    rows = [
        {
            "Hypothesis": begun(short_name(arm, name)),
            "Probability": percent(p),
            "Direction": direction_words(diagnosis, name),
            "Free travel": travel_words(diagnosis, arm)
            if name == diagnosis.fault.hypothesis
            else "–",
            "Runs": _runs(diagnosis, name),
        }
        for name, p in kept
    ]
    left = len(diagnosis.posterior) - len(kept)
    note = [data_words(diagnosis)]
    if left > 1:
        together = percent(max(0.0, 1 - sum(p for _, p in kept)))
        note.append(f"The other {left} hypotheses have {together} together.")
    note.append(
        "Direction: unit vector in the link's frame, half opening of its 95 % cone. Free travel: "
        "from stop to stop, with 95 % interval. Runs: those that raised the probability. Two "
        "faults at once, or one of another kind, are no hypothesis."
    )
    return {"title": "", "rows": rows, "note": " ".join(note)}


def listed(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Hypotheses of the table with their probabilities, most probable first."""
    ranked = sorted(diagnosis.posterior.items(), key=lambda item: -item[1])
    return [item for k, item in enumerate(ranked) if item[1] >= _LISTED or k == 0][:_RANKED]


def direction_words(diagnosis: Diagnosis, hypothesis: str) -> str:
    """Direction of a hypothesis's slide; a dash for others."""
    kind, _, where = hypothesis.partition("@")
    if kind != "structural_looseness":
        return "–"
    fault = diagnosis.fault
    axis, half = None, None
    if fault.hypothesis == hypothesis:
        axis, half = fault.direction, fault.direction_half_angle_deg
    elif where in diagnosis.directions:
        own = diagnosis.directions[where]
        axis, half = own.axis, own.half_angle_deg
    if axis is None:
        return "not identified"
    shown = ", ".join(f"{x:.2f}".replace("-", "−") for x in axis)
    return f"({shown})" + ("" if half is None else f" ±{half:.0f}°")


def travel_words(diagnosis: Diagnosis, arm: Arm) -> str:
    """Free travel of the fault with its interval; "not identified" where there is none."""
    fault = diagnosis.fault
    if fault.kind == HEALTHY:
        return "–"
    if fault.gap_m is None:
        return "not identified"
    turns = fault.kind == "backlash" and not (
        fault.where in arm.joints and bool(arm.sliding[arm.joints.index(fault.where)])
    )
    scale, unit = (_TO_ARC_MINUTES, "arc minutes") if turns else (1e3, "mm")
    ends = fault.gap_interval_m
    between = "" if ends is None else f" ({scale * ends[0]:.2g} to {scale * ends[1]:.2g})"
    return f"{scale * fault.gap_m:.2g}{between} {unit}"


def _runs(diagnosis: Diagnosis, hypothesis: str) -> str:
    """Runs that raised the probability of a hypothesis, of those that could be used."""
    steps = [r.probabilities for r in diagnosis.records if r.probabilities]
    if not steps:
        return "–"
    before = float(diagnosis.settings.get("healthy_prior", 0.5))
    if hypothesis != HEALTHY:
        before = (1 - before) / max(len(diagnosis.posterior) - 1, 1)
    risen = 0
    for step in steps:
        after = step.get(hypothesis, 0.0)
        risen += after > before
        before = after
    return f"{risen} of {len(steps)}"


def data_words(diagnosis: Diagnosis) -> str:
    """Records and poses that a diagnosis rests on."""
    suspect = [r for r in diagnosis.records if r.condition != HEALTHY]
    poses = {tuple(round(v, 3) for v in r.pose.values()) for r in suspect}
    healthy = len(diagnosis.records) - len(suspect)
    said = begun(f"{_count(len(suspect), 'record')} in {_count(len(poses), 'pose')}")
    unused = sum(not r.probabilities for r in suspect)
    if unused:
        said += f", {unused} of which could not be used"
    if healthy:
        return f"{said}, beside {_count(healthy, 'record')} of the healthy arm."
    return f"{said}. There is no record of the healthy arm: the model stands in its place."


def _count(number: int, noun: str) -> str:
    return f"one {noun}" if number == 1 else f"{number} {noun}s"
