"""Plain words for what the arm does and what is wrong with it.

What of an arm a fault leaves loose, for the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearPose
from loose_env.excitation import Excitation
from loose_env.faults import (
    SEVERAL_FAULTS,
    UNSURE,
    Backlash,
    Fault,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    parts_of,
    place_of,
)

__all__ = ["fault_words", "hypothesis_words", "loose_links_of", "pose_words", "shaking_words"]


def hypothesis_words(hypothesis: str | None, *, past: bool = False) -> str:
    """Say a hypothesis, or what was the matter once the episode is over.

    Examples
    --------
    >>> hypothesis_words("structural_looseness@link2")
    'link 2 is loose'
    >>> hypothesis_words("backlash@joint1", past=True)
    'joint 1 had play'
    >>> hypothesis_words(None), hypothesis_words("unsure")
    ('no verdict', 'unsure')
    """
    if hypothesis is None:
        return "no verdict"
    if hypothesis == UNSURE:
        return "unsure"
    if hypothesis == SEVERAL_FAULTS:
        return f"there {'were' if past else 'are'} several faults"
    place = place_of(hypothesis)
    if place is None:
        return f"nothing {'was' if past else 'is'} loose"
    if hypothesis.startswith("backlash"):
        return f"joint {place} {'had' if past else 'has'} play"
    verb = "was" if past else "is"
    if hypothesis.startswith("rotational"):
        return f"link {place} {verb} loose and {'rocked' if past else 'rocks'}"
    if hypothesis.startswith("compound"):
        return f"link {place} {verb} loose in several directions"
    return f"link {place} {verb} loose"


def fault_words(fault: Fault, arm: Arm | None = None) -> str:
    """Say what was wrong with an arm, with the travel of the loose seat.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> from loose_env.faults import Healthy
    >>> fault_words(Healthy())
    'nothing was loose'
    >>> fault_words(Backlash(joint=3, gap=1e-4, stiffness=(1e5, 1e5)), scara())
    'joint 3 had play (0.1 mm)'
    """
    if isinstance(fault, SeveralFaults):
        return "; ".join(fault_words(one, arm) for one in fault.faults)
    words = hypothesis_words(fault.hypothesis, past=True)
    travel = ", ".join(t for t in (_travel(part, arm) for part in parts_of(fault)) if t)
    return f"{words} ({travel})" if travel else words


def _travel(part: Fault, arm: Arm | None) -> str:
    """Travel of one loose degree of freedom, in millimetres or degrees."""
    if isinstance(part, Backlash):
        slides = arm is not None and bool(arm.sliding[part.joint - 1])
        return f"{1e3 * part.gap:.2g} mm" if slides else f"{np.degrees(part.gap):.2g}°"
    if isinstance(part, RotationalLooseness):
        return f"{np.degrees(part.gap):.2g}°"
    return f"{1e3 * part.gap:.2g} mm" if isinstance(part, StructuralLooseness) else ""


def pose_words(pose: NDArray[np.float64], sliding: NDArray[np.bool_] | None = None) -> str:
    """Write a pose in whole degrees, and whole millimetres where a joint slides.

    Examples
    --------
    >>> pose_words(np.radians([30.0, -90.2]))
    '30°, −90°'
    >>> pose_words(np.array([0.0, -0.08]), np.array([False, True]))
    '0°, −80 mm'
    """
    slides = np.zeros(len(pose), dtype=bool) if sliding is None else sliding
    words = (
        f"{round(1e3 * float(q))} mm" if slide else f"{round(float(np.degrees(q)))}°"
        for q, slide in zip(pose, slides, strict=True)
    )
    return ", ".join(word.replace("-", "−") for word in words)


def shaking_words(at: LinearPose, excitation: Excitation) -> str:
    """Say which joints are shaken, how hard and for how long.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> from loose_env.excitation import at_levels
    >>> at = LinearArm(planar(2)).at([0.0, 1.0])
    >>> shake, _ = at_levels(at, np.array([0.0, 4.0]), duration=1.2)
    >>> shaking_words(at, shake)
    'Joint 2 shaken at level 2 (4 m/s²) for 1.2 s'
    """
    joints = np.flatnonzero(excitation.excited)
    torque = np.array(excitation.torque_rms)[joints]
    tool = at.response(excitation.excited).tool
    rms = torque * np.sqrt(np.mean(np.sum(np.abs(tool) ** 2, axis=1), axis=0))
    who = "All joints" if len(joints) == at.linear.arm.n else _list("Joint", joints + 1)
    return f"{who} shaken at {_how_hard(at.linear.arm, rms)} for {excitation.duration:g} s"


def _how_hard(arm: Arm, rms: NDArray[np.float64]) -> str:
    """Name the levels, or what the torque limits left of them."""
    near = np.isclose(rms[:, None], np.array(arm.levels), rtol=0.01)
    same = bool(np.ptp(rms) < 0.01 * rms.max())
    if not near.any(axis=1).all():
        amounts = [f"{a:.2g}" for a in (rms[:1] if same else rms)]
        return f"{_list('', amounts)} m/s²".strip()
    numbers = near.argmax(axis=1) + 1
    if same:
        return f"level {numbers[0]} ({arm.levels[numbers[0] - 1]:g} m/s²)"
    return _list("level", numbers)


def _list(noun: str, items: Sequence[object] | NDArray[np.intp]) -> str:
    """Join items with commas and "and" behind their noun."""
    words = [str(item) for item in items]
    if len(words) == 1:
        return f"{noun} {words[0]}"
    return f"{noun}{'s' if noun else ''} {', '.join(words[:-1])} and {words[-1]}"


def loose_links_of(fault: Fault | None) -> frozenset[int]:
    """Return the numbers of the links that are loose on their flanges.

    Examples
    --------
    >>> from loose_env.faults import Backlash
    >>> sorted(loose_links_of(Backlash(joint=1, gap=1e-3, stiffness=(1e4, 1e4))))
    []
    """
    parts = () if fault is None else parts_of(fault)
    kinds = StructuralLooseness, RotationalLooseness
    return frozenset(part.link for part in parts if isinstance(part, kinds))
