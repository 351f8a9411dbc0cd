"""Reasons for a planned pose in words, and for not taking the one that a diagnosis asks for.

Whether a plan does what a diagnosis asks for next, or chooses for itself.

A diagnosis chooses with settings of its own, and with the model of the recording, which has no
meshes. What it asks for is taken over where the plan's settings are the same and the arm's own
model lets the arm get there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isclose
from typing import Any

import numpy as np

from loose_env.arms import Arm
from loose_env.diagnosis import DirectionSighting, ToolFrames, link_posterior, precision_of
from loose_env.errors import InvalidData
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.prior_knowledge import Known, names_of
from loose_env.instrument.result import HEALTHY, NextMeasurement
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import MENTIONED
from loose_env.typing import Array


def expected_directions(
    nominal: Arm, known: Known, pose: Array, links: Sequence[str], joints: Sequence[str]
) -> Mapping[str, Array | None]:
    """Direction in the tool frame that each hypothesis expects to see in a pose."""
    frames = ToolFrames(nominal)
    names = names_of(links, joints)
    found: dict[str, Array | None] = dict.fromkeys(names)
    lines = frames.unit_lines(pose)[0]
    for name, line in zip(names[nominal.n + 1 :], lines, strict=True):
        found[name] = line if line.any() else None
    images = frames.images(pose)[0]
    sightings = []
    for record in known.records:
        if record.direction is not None:
            seen = record.direction[list(nominal.axes)]
            if np.linalg.norm(seen) > 1e-6:
                seen = seen / np.linalg.norm(seen)
                sightings.append(
                    DirectionSighting(
                        pose=record.pose,
                        direction=seen,
                        precision=precision_of(seen, max(record.sd, 1e-3)),
                    )
                )
    if sightings:
        directions = link_posterior(frames, sightings).directions
        for k, name in enumerate(names[1 : nominal.n + 1]):
            found[name] = images[k] @ directions[k]
    for link, axis in known.directions.items():
        if link in links:
            k = list(links).index(link)
            found[f"structural_looseness@{link}"] = images[k] @ axis[: images.shape[-1]]
    return found


def reason(
    nominal: Arm,
    known: Known,
    pose: Array,
    links: Sequence[str],
    joints: Sequence[str],
    here: Array | None,
) -> str:
    """One or two sentences: why this pose."""
    if not known.probabilities:
        return (
            "nothing is known yet: of the candidate poses, this one has the most information about "
            "whether anything is loose and where"
        )
    seen = expected_directions(nominal, known, pose, links, joints)
    ranked = sorted(known.probabilities.items(), key=lambda item: -item[1])
    # Play in a joint on whose axis the tool lies shows nothing, here or anywhere near.
    unseen = [n for n, p in ranked if p > MENTIONED and "backlash" in n and seen[n] is None]
    alive = [(name, p) for name, p in ranked if p > MENTIONED and name not in unseen]
    if unseen and len(alive) < 2:
        left = f"{alive[0][0]} is " if alive else "nothing is "
        return (
            f"{left}in question beside {', '.join(unseen)}, which moves nothing at the tool: the "
            "accelerometer lies on its axis; mount it beside the axis to tell"
        )
    if len(alive) < 2:
        return f"{alive[0][0]} is all but sure ({alive[0][1]:.1%}); this would confirm it"
    (one, p), (other, q) = alive[:2]
    said = f"it tells {one} ({p:.0%}) from {other} ({q:.0%})"
    first, second = seen[one], seen[other]
    if HEALTHY in (one, other):
        said += ": here a loose seat would be shaken hard beside its weight"
    elif first is not None and second is not None:
        now = _apart(first, second)
        said += f": the directions that they expect at the tool lie {now:.0f}° apart here"
        if here is not None and np.abs(here - pose).max() > 1e-3:
            before = expected_directions(nominal, known, here, links, joints)
            one_before, other_before = before[one], before[other]
            if one_before is not None and other_before is not None:
                said += f", {_apart(one_before, other_before):.0f}° in the pose before"
    rest = len(alive) - 2
    return said + (f"; {rest} more are in question" if rest else "")


def _apart(one: Array, other: Array) -> float:
    """Angle between two axial directions [degrees]."""
    return float(np.degrees(np.arccos(min(1.0, abs(float(one @ other))))))


def other_settings(chosen: NextMeasurement, choice: NextSettings) -> list[str]:
    """Names of the settings of a plan with which a measurement was not chosen.

    A measurement that does not say with which it was chosen, of an earlier version, is asked for
    its length, its rate and its ground alone.
    """
    before: Mapping[str, Any] = {
        "seconds": chosen.seconds,
        "rate_hz": chosen.rate_hz,
        "ground_m": None,
        **chosen.settings,
    }
    return [
        name
        for name, value in asdict(choice).items()
        if name in before and not _same(before[name], value)
    ]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return isclose(one, other, rel_tol=1e-6)  # files have seven digits
    return bool(one == other)


def why_not_reached(
    arm: InstrumentedArm, ground: Ground, here: Array | None, chosen: NextMeasurement
) -> str:
    """Say what is in the way of a measurement, by the arm's own model; "" if nothing is."""
    pose = _pose_in(arm, chosen)
    touching = arm.collisions.touch(pose)
    if touching:
        return f"in it the model's bodies touch: {', '.join(touching)}"
    if not ground.clear(pose):
        return "a part of the arm is below its base or the ground given"
    if here is None:
        return ""
    touching = arm.collisions.touch_between(here, pose)
    if touching:
        return f"on the way there the model's bodies touch: {', '.join(touching)}"
    if not ground.clear_between(here, pose):
        return "on the way there a part of the arm is below its base or the ground given"
    return ""


def _pose_in(arm: InstrumentedArm, chosen: NextMeasurement) -> Array:
    """The pose (n,) [rad or m], if the measurement fits the model."""
    lacking = [name for name in arm.joints if name not in chosen.pose]
    foreign = [name for name in (*chosen.joints, *chosen.pose) if name not in arm.joints]
    if lacking or foreign:
        raise InvalidData(
            f"the next measurement of the diagnosis is of another model: it has the joints "
            f"{', '.join(chosen.pose)}, the model {', '.join(arm.joints)}"
        )
    pose = np.array([chosen.pose[name] for name in arm.joints])
    if not arm.nominal.within_ranges(pose).all():
        raise InvalidData(
            f"the pose of the diagnosis, {dict(chosen.pose)}, is outside the ranges of the model's "
            f"joints: {arm.nominal.joint_ranges}"
        )
    return pose
