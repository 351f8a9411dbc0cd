"""Diagnosis as a notebook and a terminal show it: headline, table of explanations, next steps."""

from __future__ import annotations

from html import escape

from loose_env.arms import Arm
from loose_env.instrument import Diagnosis
from loose_env.io import sentence
from loose_env.report.diagnosis.text import (
    headline,
    percent,
    short_name,
    steps,
    with_plain_names,
)
from loose_env.report.pages.notebook import aligned, bar, bullets, cells_table

__all__ = ["diagnosis_html", "diagnosis_text"]

_LEAST, _MOST = 0.01, 5
"""Probability from which an explanation is listed, and their number at most."""
_HEADS = ("explanation", "probability", "direction in the link's frame", "free travel")


def diagnosis_text(diagnosis: Diagnosis, arm: Arm) -> str:
    """Diagnosis in a few lines of text.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    arm : Arm
        The nominal arm that it was found with.
    """
    lines = [headline(diagnosis, arm)]
    lines += [f"  {line}" for line in aligned([_HEADS, *_rows(diagnosis, arm)])]
    lines += [f"next: {step}" for step in steps(diagnosis, arm)]
    lines += [f"warning: {sentence(warning)}" for warning in diagnosis.warnings]
    return "\n".join(lines)


def diagnosis_html(diagnosis: Diagnosis, arm: Arm) -> str:
    """Diagnosis as a fragment of HTML, with the probabilities drawn as bars.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    arm : Arm
        The nominal arm that it was found with.
    """
    names = {name: short_name(arm, name) for name in diagnosis.posterior}
    bars = [bar(diagnosis.posterior[name]) for name in _listed(diagnosis)]
    rows = [
        (name, drawn, *others)
        for (name, *others), drawn in zip(_rows(diagnosis, arm), bars, strict=True)
    ]
    warnings = [sentence(with_plain_names(words, names)) for words in diagnosis.warnings]
    return "".join(
        [
            f"<p><strong>{escape(headline(diagnosis, arm))}</strong></p>",
            cells_table((_HEADS[0], "", *_HEADS[1:]), rows, markup=(1,)),
            bullets("Next", steps(diagnosis, arm)),
            bullets("Warnings", warnings),
        ]
    )


def _listed(diagnosis: Diagnosis) -> list[str]:
    """Hypotheses of the table, the most probable first; the diagnosed one is always among them."""
    ranked = sorted(diagnosis.posterior, key=lambda name: -diagnosis.posterior[name])
    own = diagnosis.fault.hypothesis
    others = [n for n in ranked if n != own and diagnosis.posterior[n] >= _LEAST]
    return [own, *others[: _MOST - 1]]


def _rows(diagnosis: Diagnosis, arm: Arm) -> list[tuple[str, str, str, str]]:
    """Explanation, probability, direction and free travel; the diagnosed one first."""
    fault, found = diagnosis.fault, []
    for name in _listed(diagnosis):
        kind, _, where = name.partition("@")
        axis, travel = "", ""
        slide = diagnosis.directions.get(where) if kind == "structural_looseness" else None
        if slide is not None:
            axis = _axis(slide.axis, slide.half_angle_deg)
        if name == fault.hypothesis:
            if fault.direction is not None:
                axis = _axis(fault.direction, fault.direction_half_angle_deg)
            travel = _travel(diagnosis, arm)
        found.append((short_name(arm, name), percent(diagnosis.posterior[name]), axis, travel))
    return found


def _axis(axis: tuple[float, float, float], half_angle_deg: float | None) -> str:
    numbers = ", ".join(f"{x:.2f}".replace("-", "−") for x in axis)
    return f"({numbers})" + ("" if half_angle_deg is None else f" ± {half_angle_deg:.0f}°")


def _travel(diagnosis: Diagnosis, arm: Arm) -> str:
    """Free travel of the diagnosed fault [mm, mrad for the backlash of a turning joint]."""
    fault = diagnosis.fault
    if fault.gap_m is None:
        return ""
    turns = fault.kind == "backlash" and not (
        fault.where in arm.joints and bool(arm.sliding[arm.joints.index(fault.where)])
    )
    ends = fault.gap_interval_m
    between = "" if ends is None else f" ({1e3 * ends[0]:.2g} to {1e3 * ends[1]:.2g})"
    return f"{1e3 * fault.gap_m:.2g}{between} {'mrad' if turns else 'mm'}"
