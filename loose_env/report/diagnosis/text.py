"""Text of a diagnosis: headline, outcome, next steps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.instrument import HEALTHY, PROBABLE, Diagnosis, NextMeasurement, path_word
from loose_env.io import begun, sentence

__all__ = [
    "correction_commands",
    "headline",
    "joint_words",
    "link_words",
    "percent",
    "position_text",
    "short_name",
    "steps",
    "summary_words",
    "with_plain_names",
]


_HEADLINE = 44
"""Letters of a hypothesis in the headline, at most."""


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


def headline(diagnosis: Diagnosis, arm: Arm) -> str:
    """Outcome in one line, worded by the verdict and its probability.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.instrument import Fault
    >>> found = Diagnosis(
    ...     fault=Fault(kind="healthy"),
    ...     probability=1.0,
    ...     posterior={"healthy": 1.0},
    ...     verdict="model_mismatch",
    ... )
    >>> headline(found, planar(2))
    'The model is not that of this arm: correct it first.'
    """
    said = short_name(arm, diagnosis.fault.hypothesis)
    if len(said) > _HEADLINE:  # the number alone: the name stands below the headline
        said = re.sub(r" \([^()]*\)", "", said)
    if diagnosis.verdict == "model_mismatch":
        return "The model is not that of this arm: correct it first."
    if diagnosis.verdict != "open":
        return f"{begun(said)}."
    probability = diagnosis.probability
    if diagnosis.fault.kind == HEALTHY and np.isfinite(diagnosis.nothing_opened):
        probability = diagnosis.nothing_opened  # as the verdict has it
    if probability >= PROBABLE:
        return f"Probably {said}."
    return f"Not decided. Most likely so far: {said}."


def summary_words(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Probability and meaning of the outcome, and reasons why it is open."""
    said = begun(short_name(arm, diagnosis.fault.hypothesis))
    found = []
    if diagnosis.verdict == "model_mismatch":
        share = ""
        if np.isfinite(diagnosis.misfit):
            share = f" The best model leaves {100 * diagnosis.misfit:.0f} % of the record "
            share += "unexplained."
        found.append(
            "Model and record differ by more than the model's tolerances and any single fault "
            f"explain: no fault is named.{share}"
        )
    else:
        found.append(f"{said}: {percent(diagnosis.probability)}. {_meaning(diagnosis, arm)}")
    if diagnosis.verdict in ("open", "model_mismatch"):
        found += [begun(sentence(_in_words(diagnosis, arm, r))) for r in diagnosis.open_because]
    return found


def _in_words(diagnosis: Diagnosis, arm: Arm, reason: str) -> str:
    """A reason with the hypotheses in words; longer names first, for one may begin another."""
    for name in sorted(diagnosis.posterior, key=len, reverse=True):
        if "@" in name:
            reason = reason.replace(name, f"“{short_name(arm, name)}”")
    return reason


def _meaning(diagnosis: Diagnosis, arm: Arm) -> str:
    fault = diagnosis.fault
    if fault.where is None:
        shown = ""
        if np.isfinite(diagnosis.nothing_opened):
            shown = f" (that nothing opened in any run: {percent(diagnosis.nothing_opened)})"
        return (
            f"All motion is transmitted as in the healthy arm{shown}. A seat that friction or "
            "weight kept shut cannot be told from a healthy one."
        )
    if fault.kind == "backlash":
        return "Its motor and its link are not tightly connected."
    joint = arm.joints[arm.seat_bodies.index(fault.where)] if fault.where in arm.seat_bodies else ""
    return f"It slides where it is fastened to {joint_words(arm, joint)}."


def correction_commands(folder: str) -> str:
    """Commands that correct the model of a recording and diagnose with the corrected one.

    Examples
    --------
    >>> print(correction_commands("cell 4"))
    loose gap 'cell 4' --out 'cell 4-gap'
    loose diagnose 'cell 4' --model 'cell 4-gap/model.xml' --out 'cell 4-corrected'
    """
    recording, gap, out = (path_word(f"{folder}{end}") for end in ("", "-gap", "-corrected"))
    model = path_word(f"{folder}-gap/model.xml")
    return (
        f"loose gap {recording} --out {gap}\nloose diagnose {recording} --model {model} --out {out}"
    )


def steps(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Next steps, in order."""
    if diagnosis.verdict == "model_mismatch":
        return [
            "Correct the model by the same recording (first command below). Record free motions "
            "too, slow and fast, where it finds too little.",
            "Diagnose again with the corrected model (second command).",
        ]
    found = []
    fault = diagnosis.fault
    if diagnosis.next is not None:
        found.append(_measure(diagnosis.next, arm, diagnosis.posterior))
    if diagnosis.verdict == "open":
        if diagnosis.next is None:
            found.append(
                "Measure in further poses, each far from those before, or louder: what is at hand "
                "does not decide it."
            )
        found.append("Take nothing apart yet: the case is open.")
        return found
    if fault.kind == HEALTHY:
        found.append(
            "Nothing needs to be done. Keep this recording: it is the reference of the healthy arm."
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
            "Measure once more in the same poses after the repair: the transmission should be that "
            "of the healthy arm again."
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
