"""Why a pose: what the hypotheses in question are expected to show there, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.diagnosis.likelihood.axial_likelihood import precision_of
from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.link_finding.spatial import DirectionSighting, link_posterior
from loose_env.instrument.known import Known, names_of
from loose_env.instrument.result import HEALTHY

__all__ = ["expected_directions", "reason"]

Array = NDArray[np.float64]

_IN_QUESTION = 0.02
"""Probability below which a hypothesis is not mentioned [1]."""


def expected_directions(
    arm: Arm, known: Known, pose: Array, links: Sequence[str], joints: Sequence[str]
) -> Mapping[str, Array | None]:
    """Direction in the tool frame that each hypothesis expects to see in a pose.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    known : Known
        Directions that were seen so far.
    pose : ndarray (n,)
        The pose [rad or m].
    links, joints : sequence of str
        Names of the model, base first.

    Returns
    -------
    mapping
        Hypothesis -> unit vector, axial (d,); None where any direction is possible, or nothing
        is to be seen.
    """
    frames = ToolFrames(arm)
    names = names_of(links, joints)
    found: dict[str, Array | None] = dict.fromkeys(names)
    lines = frames.unit_lines(pose)[0]
    for name, line in zip(names[arm.n + 1 :], lines, strict=True):
        found[name] = line if line.any() else None
    images = frames.images(pose)[0]
    sightings = []
    for record in known.records:
        if record.direction is not None:
            seen = record.direction[list(arm.axes)]
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
        for k, name in enumerate(names[1 : arm.n + 1]):
            found[name] = images[k] @ directions[k]
    for link, axis in known.directions.items():
        if link in links:
            k = list(links).index(link)
            found[f"structural_looseness@{link}"] = images[k] @ axis[: images.shape[-1]]
    return found


def reason(
    arm: Arm,
    known: Known,
    pose: Array,
    links: Sequence[str],
    joints: Sequence[str],
    here: Array | None,
) -> str:
    """One or two sentences: why this pose."""
    if not known.probabilities:
        return (
            "nothing is known yet: of the poses weighed, this one is expected to tell most about "
            "whether anything is loose and where"
        )
    seen = expected_directions(arm, known, pose, links, joints)
    ranked = sorted(known.probabilities.items(), key=lambda item: -item[1])
    # Play in a joint on whose axis the tool lies shows nothing, here or anywhere near.
    unseen = [n for n, p in ranked if p > _IN_QUESTION and "backlash" in n and seen[n] is None]
    alive = [(name, p) for name, p in ranked if p > _IN_QUESTION and name not in unseen]
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
            before = expected_directions(arm, known, here, links, joints)
            one_before, other_before = before[one], before[other]
            if one_before is not None and other_before is not None:
                said += f", {_apart(one_before, other_before):.0f}° in the pose before"
    rest = len(alive) - 2
    return said + (f"; {rest} more are in question" if rest else "")


def _apart(one: Array, other: Array) -> float:
    """Angle between two axial directions [degrees]."""
    return float(np.degrees(np.arccos(min(1.0, abs(float(one @ other))))))
