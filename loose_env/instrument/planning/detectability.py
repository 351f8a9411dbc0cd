"""Detectability of every fault: the best record over many poses and excited joints.

A seat can be found along a direction if in some pose gravity lets it move and what that changes
of the tool's motion stands out of the sensors' noise and the model's errors.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import ToolFrames, confusable_faults, fault_locations
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.excitation import (
    proposed,
    sensitivity,
    tool_noise,
    torque_of,
)
from loose_env.instrument.planning.next_measurement import seat_features
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import (
    DETECTABLE_Z,
    FOUND_MOSTLY,
    FOUND_YES,
    OPEN_SHARE,
    PLANNED_SD_DEG,
    TRANSVERSE_POWER,
)
from loose_env.typing import Array

Verdict = Literal["yes", "mostly", "hardly", "no"]

_DIRECTIONS = 40


@dataclass(frozen=True, kw_only=True)
class Findable:
    """Detectability of a fault."""

    hypothesis: str
    """Its name in a diagnosis."""
    verdict: Verdict
    """"yes", "mostly", "hardly" or "no"."""
    directions: float
    """Share of the directions in which a loose link could slide that would be seen in some pose
    [1]; of play 1 or 0."""
    shut_along: tuple[float, ...] | None
    """Direction, in the link's frame, along which gravity holds the seat hardest in every pose;
    None where it can be opened along all, and for play."""
    smallest_gap: float | None
    """Smallest travel that would show with a healthy reference, half of the directions the better
    ones [m; rad for a joint that turns]; None where none would."""
    smallest_gap_model: float | None
    """The same against the nominal model alone."""
    at_tool_m: float | None
    """`smallest_gap_model` as motion of the tool [m]."""
    best_joint: str
    """Joint that shows it best."""
    alike: tuple[str, ...]
    """Faults that the direction at the tool cannot tell from it in any pose."""
    why: str
    """In a few words, where it is not simply found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BestSeen:
    """Best of all records for every location: P locations, slides before plays."""

    directions: Array
    """Of a link (A, axes)."""
    opens: Array
    """(P,)."""
    seen: Array
    """Change by the gap of interest against noise and model, in standard deviations (P,)."""
    sharp: Array
    """The same against the noise of the sensors alone (P,)."""
    gap: Array
    """Smallest with a reference (P,)."""
    gap_model: Array
    """Smallest without (P,)."""
    joint: NDArray[np.intp]
    """That shows it best (P,)."""
    levers: Array
    """Tool motion per motion of each joint, median of the poses [m, 1] (n,)."""
    noise: float
    """Of an axis of the accelerometer in the band, rms [m/s²]."""
    band: tuple[float, float]
    """Of the arm [Hz]."""

    def seconds(self, rules: NextSettings) -> float:
        """Length at which noise leaves 3 degrees, for half of what can be found [s]."""
        good = self.sharp[self.seen >= DETECTABLE_Z]
        if not len(good):
            return float("inf")
        noise = rules.seconds / np.median(good) ** 2
        rattle = TRANSVERSE_POWER / (2 * (self.band[1] - self.band[0]))
        return float((noise + rattle) / np.radians(PLANNED_SD_DEG) ** 2)


def best_seen(
    linear: LinearArm,
    where: Array,
    rules: NextSettings,
    joints: Collection[int] | None = None,
) -> BestSeen:
    """Take every joint in every pose, and keep the best of each location.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> linear = LinearArm(planar(2))
    >>> found = best_seen(linear, np.array([[0.1, 1.2]]), NextSettings())
    >>> bool((found.opens == 1).all())  # nothing weighs on a seat in the horizontal plane
    True
    """
    nominal = linear.arm
    features = seat_features(linear, rules, directions=_DIRECTIONS)
    count = features.locations
    slides = count - nominal.n
    gap = rules.gap_mm * 1e-3
    gaps = np.full(count, gap)
    levers = np.array([np.linalg.norm(linear.at(q).kinematic, axis=0) for q in where])
    lever = np.median(levers, axis=0)
    turn = gap / max(nominal.reach, 1e-6)
    gaps[slides:] = np.where(nominal.sliding, gap, turn)
    best = {
        "opens": np.zeros(count),
        "seen": np.zeros(count),
        "sharp": np.zeros(count),
        "gap": np.full(count, np.inf),
        "gap_model": np.full(count, np.inf),
    }
    joint = np.zeros(count, dtype=np.intp)
    for q in where:
        proposal = proposed(nominal, q, rules)
        for j in range(nominal.n) if joints is None else joints:
            torque = torque_of(proposal, j, rules)
            if not torque.any():
                continue
            one = sensitivity(features, q, torque, rules.seconds)
            lost = one.lost(gaps)
            better = lost * one.by_model > best["seen"]
            joint[better] = j
            best["opens"] = np.maximum(best["opens"], one.opens)
            best["seen"] = np.maximum(best["seen"], lost * one.by_model)
            best["sharp"] = np.maximum(best["sharp"], lost * one.by_noise)
            best["gap"] = np.minimum(best["gap"], one.smallest_gap(reference=True))
            best["gap_model"] = np.minimum(best["gap_model"], one.smallest_gap(reference=False))
    return BestSeen(
        directions=features.directions,
        joint=joint,
        levers=lever,
        noise=tool_noise(features),
        band=nominal.band,
        **best,
    )


def findable_faults(arm: InstrumentedArm, found: BestSeen) -> tuple[Findable, ...]:
    """Detectability of every fault in its most informative record."""
    nominal = arm.nominal
    frames = ToolFrames(nominal)
    own = dict(zip(fault_locations(nominal), arm.hypotheses[1:], strict=True))
    count = len(found.directions)
    made = []
    for k, (location, name) in enumerate(own.items()):
        if k < nominal.n:
            rows = slice(k * count, (k + 1) * count)
            seen = found.seen[rows] >= DETECTABLE_Z
            opens = found.opens[rows]
            worst = int(np.argmin(opens))
            shut = None
            if opens[worst] < OPEN_SHARE:
                shut = tuple(float(x) for x in found.directions[worst])
            share = float(np.mean(seen))
            alike: tuple[str, ...] = ()
            gap, gap_model = _middle(found.gap[rows]), _middle(found.gap_model[rows])
            why = _why_link(share, float(np.mean(opens < OPEN_SHARE)), shut)
            at_tool = gap_model
        else:
            place_row = nominal.n * count + k - nominal.n
            rows = slice(place_row, place_row + 1)
            share = float(found.seen[place_row] >= DETECTABLE_Z)
            shut = None
            gap, gap_model = _middle(found.gap[rows]), _middle(found.gap_model[rows])
            others = confusable_faults(frames, location, tolerance=np.radians(3.0))
            alike = tuple(own[other] for other in others if other != location)
            lever = float(found.levers[k - nominal.n])
            at_tool = None if gap_model is None else gap_model * lever
            why = _why_joint(share, lever, float(found.opens[place_row]), gap_model)
        verdict: Verdict = (
            "yes" if share >= FOUND_YES else "mostly" if share >= FOUND_MOSTLY else "hardly"
        )
        if share < FOUND_MOSTLY and gap_model is None:
            verdict = "no"
        made.append(
            Findable(
                hypothesis=name,
                verdict=verdict,
                directions=share,
                shut_along=shut,
                smallest_gap=gap,
                smallest_gap_model=gap_model,
                at_tool_m=at_tool,
                best_joint=arm.joints[int(np.bincount(found.joint[rows]).argmax())],
                alike=alike,
                why=why,
            )
        )
    return tuple(made)


def _middle(gaps: Array) -> float | None:
    """Median; None where half of them are infinite."""
    value = float(np.median(gaps))
    return value if np.isfinite(value) else None


def _why_link(share: float, shut: float, along: tuple[float, ...] | None) -> str:
    if share >= FOUND_YES:
        return ""
    if along is not None:
        words = " ".join(f"{x:+.1f}" for x in along)
        if shut > 0:
            return f"gravity keeps the seat shut in every pose about the direction {words}"
    return "along some directions the change is within the model error"


def _why_joint(share: float, lever: float, opens: float, gap: float | None) -> str:
    if share >= FOUND_YES:
        return ""
    if lever < 1e-3:
        return "the tool lies on this joint's axis and does not feel it turn"
    if opens < OPEN_SHARE:
        return "gravity loads the gear's teeth in every pose"
    if gap is None:
        return "its motion is confusable with the model error"
    return "only larger play than the gap of interest shows"
