"""Text of a diagnosis: fault, probability, next steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.instrument import HEALTHY, PROBABLE, Diagnosis, NextMeasurement
from loose_env.io import begun, sentence

__all__ = [
    "headline",
    "joint_words",
    "link_words",
    "percent",
    "position_text",
    "probability_words",
    "questions",
    "short_name",
    "steps",
    "with_plain_names",
]

_RIVAL = 0.01
"""Probability from which the next best explanation is worth a word."""


def joint_words(arm: Arm, joint: str) -> str:
    """Name a joint, with its number from the base where the name does not have it.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM, arm_from_file
    >>> joint_words(arm_from_file(DESK_ARM), "elbow")
    'joint 3 (elbow)'
    """
    return _named("joint", arm.joints, joint, arm)


def link_words(arm: Arm, body: str) -> str:
    """Name a link, with its number from the base where the name does not have it.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> link_words(planar(2), "link2")
    'link 2'
    """
    return _named("link", arm.seat_bodies, body, arm)


def _named(noun: str, names: tuple[str, ...], name: str, arm: Arm) -> str:
    if name not in names:
        raise InvalidData(
            f"the diagnosis names {name!r}, which is no {noun} of arm {arm.name!r}; it has "
            f"{', '.join(names)}: give the model that was diagnosed"
        )
    number = names.index(name) + 1
    plain = f"{noun} {number}"
    return (
        plain
        if name.lower().replace("_", " ") in (plain, f"{noun}{number}")
        else (f"{plain} ({name})")
    )


def short_name(arm: Arm, hypothesis: str) -> str:
    """Say a hypothesis in a few words.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> short_name(planar(2), "backlash@joint1"), short_name(planar(2), "healthy")
    ('joint 1 has play', 'nothing is loose')
    """
    kind, _, where = hypothesis.partition("@")
    if kind == HEALTHY:
        return "nothing is loose"
    if kind == "backlash":
        return f"{joint_words(arm, where)} has play"
    return f"{link_words(arm, where)} is loose"


def headline(diagnosis: Diagnosis, arm: Arm) -> str:
    """Outcome in one sentence, worded by its probability."""
    said = short_name(arm, diagnosis.fault.hypothesis)
    if diagnosis.settled:
        return f"{begun(said)}."
    if diagnosis.probability >= PROBABLE:
        return f"Probably {said}."
    return f"Not decided yet. Most likely so far: {said}."


def probability_words(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Probability of the outcome, and the next most probable explanation."""
    own = diagnosis.fault.hypothesis
    others = sorted(
        ((p, name) for name, p in diagnosis.posterior.items() if name != own), reverse=True
    )
    found = [f"{percent(diagnosis.probability)}."]
    rivals = [f"{short_name(arm, name)} ({percent(p)})" for p, name in others[:2] if p >= _RIVAL]
    if rivals:
        found.append(f"Next most probable: {', or '.join(rivals)}.")
    found.append(
        f"Considered were {len(diagnosis.posterior)} possibilities: a healthy arm, one loose link, "
        "or play in one joint. Two faults at once, or one of another kind, are not among them."
    )
    return found


def percent(p: float) -> str:
    """A probability in per cent, never rounded to certainty.

    Examples
    --------
    >>> percent(0.9996), percent(0.42), percent(0.0002)
    ('over 99.9 %', '42 %', 'under 0.1 %')
    """
    if p > 0.999:
        return "over 99.9 %"
    if p < 0.001:
        return "under 0.1 %"
    digits = 1 if p > 0.99 or p < 0.01 else 0
    return f"{100 * p:.{digits}f} %"


def position_text(arm: Arm, joint: str, value: float) -> str:
    """Position of a joint in the unit that a teach panel shows.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> position_text(scara(), "joint1", 0.5), position_text(scara(), "joint3", -0.05)
    ('28.6°', '−50.0 mm')
    """
    slides = joint in arm.joints and bool(arm.sliding[arm.joints.index(joint)])
    shown = f"{1e3 * value:.1f} mm" if slides else f"{np.degrees(value):.1f}°"
    return shown.replace("-0.0", "0.0").replace("-", "−")


def questions(diagnosis: Diagnosis, arm: Arm) -> list[tuple[str, list[str]]]:
    """Questions of a first reader, with their answers."""
    found = [
        ("Fault", _what(diagnosis, arm)),
        ("Probability", probability_words(diagnosis, arm)),
    ]
    if diagnosis.fault.kind != HEALTHY:
        found.append(("Clearance", [_travel(diagnosis, arm)]))
    found.append(("Next steps", steps(diagnosis, arm)))
    found.append(("Data", [_looked(diagnosis)]))
    return found


def _what(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    fault = diagnosis.fault
    if fault.where is None:
        return [
            "All motion is transmitted as in the model of the healthy arm. A seat that friction or "
            "weight kept shut cannot be told from a healthy one."
        ]
    if fault.kind == "backlash":
        return [
            f"{begun(joint_words(arm, fault.where))}: its motor and its link are not tightly "
            "connected."
        ]
    joint = arm.joints[arm.seat_bodies.index(fault.where)] if fault.where in arm.seat_bodies else ""
    link = link_words(arm, fault.where)
    said = f"{begun(link)}: it slides where it is fastened to {joint_words(arm, joint)}."
    if fault.direction is None:
        return [said, "The data do not identify the direction."]
    axis = ", ".join(f"{x:.2f}".replace("-", "−") for x in fault.direction)
    within = (
        ""
        if fault.direction_half_angle_deg is None
        else f", within {fault.direction_half_angle_deg:.0f}° (95 %)"
    )
    return [said, f"It slides along ({axis}) of its own frame{within}."]


def _travel(diagnosis: Diagnosis, arm: Arm) -> str:
    fault = diagnosis.fault
    if fault.gap_m is None:
        return "The data do not identify the clearance."
    turns = fault.kind == "backlash" and not (
        fault.where in arm.joints and bool(arm.sliding[arm.joints.index(fault.where)])
    )
    scale, unit = (60 * 180 / np.pi, "arc minutes") if turns else (1e3, "mm")
    ends = fault.gap_interval_m
    between = (
        "" if ends is None else f", 95 % between {scale * ends[0]:.2g} and {scale * ends[1]:.2g}"
    )
    return f"{scale * fault.gap_m:.2g} {unit} from stop to stop{between}."


def _looked(diagnosis: Diagnosis) -> str:
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


def with_plain_names(words: str, names: Mapping[str, str]) -> str:
    """Text with the hypotheses in plain words.

    Parameters
    ----------
    words : str
        Text of a program.
    names : Mapping of str to str
        Hypotheses, and each in a few words. "healthy" stays: it is a word of its own.

    Examples
    --------
    >>> with_plain_names("backlash@j1 is left", {"backlash@j1": "joint 1 has play"})
    '“joint 1 has play” is left'
    """
    for name in sorted(names, key=len, reverse=True):
        if "@" in name:
            words = words.replace(name, f"“{names[name]}”")
    return words


def _count(number: int, noun: str) -> str:
    return f"one {noun}" if number == 1 else f"{number} {noun}s"


def steps(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Next steps, in order."""
    found = []
    fault = diagnosis.fault
    if diagnosis.next is not None:
        found.append(_measure(diagnosis.next, arm, diagnosis.posterior))
    if not diagnosis.settled:
        if diagnosis.next is None:
            found.append(
                "Measure in further poses, each far from those before, or louder: what is at hand "
                "does not decide it."
            )
        return found
    if fault.kind == HEALTHY:
        found.append(
            "Keep this recording: it is the reference of the healthy arm for the next time."
        )
    elif fault.kind == "backlash" and fault.where is not None:
        found.append(
            f"Look at the drive of {joint_words(arm, fault.where)}: gear, coupling, key, belt."
        )
    elif fault.where is not None:
        found.append(
            f"Look at what fastens {link_words(arm, fault.where)}: bolts, dowels, cracks at the "
            "flange."
        )
    if fault.kind != HEALTHY:
        found.append(
            "Measure once more in the same poses after the repair: the correlations should lie on "
            "the dashed lines again."
        )
    return found


def _measure(following: NextMeasurement, arm: Arm, names_of: Iterable[str]) -> str:
    names = [joint_words(arm, joint) for joint in following.joints]
    shaken = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} in turn"
    reason = following.reason.strip()
    if reason:
        reason = f" {sentence(with_plain_names(reason, {n: short_name(arm, n) for n in names_of}))}"
    return (
        f"Measure once more in the pose shown below: shake {shaken} for {following.seconds:g} s, "
        f"hold the others.{reason}"
    )
