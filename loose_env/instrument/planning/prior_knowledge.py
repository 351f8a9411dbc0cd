"""Prior belief over faults for the next measurement, taken from the last diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from loose_env.arms import Arm
from loose_env.diagnosis import Belief, ToolFrames
from loose_env.errors import InvalidData
from loose_env.instrument.result import HEALTHY, Diagnosis
from loose_env.instrument.settings.thresholds import CONE_95
from loose_env.recording import nearest
from loose_env.typing import Array

_USUAL_SD = 0.2
"""Standard deviation of a direction of which none is given [rad]."""
_LEAST_SD = float(np.radians(6.0))
"""Directions are told no finer than the grid they are looked for on [rad]."""
_DOUBT = 0.02
"""Weight of a direction that was seen wrongly, over that of one seen exactly [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """One record that was taken."""

    pose: Array
    """Joint positions [rad or m] (n,)."""
    excited: tuple[str, ...]
    """Joints that were shaken."""
    direction: Array | None = None
    """Direction of looseness in the tool frame, axial (3,); None where none was seen."""
    sd: float = 0.1
    """Its standard deviation [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Known:
    """Result of the last diagnosis; none by default."""

    probabilities: Mapping[str, float] = field(default_factory=dict)
    """Probability of every hypothesis, as `names_of` has them; none: each kind as probable as
    another, and each location within it."""
    records: tuple[Seen, ...] = ()
    """Records of the suspect arm, the last one last."""
    directions: Mapping[str, Array] = field(default_factory=dict)
    """Link -> direction of the slide in the link's frame (3,), where one is known."""
    direction_sd: Mapping[str, float] = field(default_factory=dict)
    """Link -> standard deviation of that [rad]; 0.2 where none is given."""


def names_of(links: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Names of all hypotheses of an arm, in the order of `loose_env.faults.hypotheses`.

    Examples
    --------
    >>> names_of(["forearm"], ["elbow"])
    ('healthy', 'structural_looseness@forearm', 'backlash@elbow')
    """
    return (
        HEALTHY,
        *(f"structural_looseness@{name}" for name in links),
        *(f"backlash@{name}" for name in joints),
    )


def known_of(diagnosis: Diagnosis, links: Sequence[str], joints: Sequence[str]) -> Known:
    """Take over what a diagnosis knows."""
    names = names_of(links, joints)
    foreign = [name for name in diagnosis.posterior if name not in names]
    lacking = [name for name in names if name not in diagnosis.posterior]
    if foreign or lacking:
        what = foreign[0] if foreign else lacking[0]
        has = "the model does not have" if foreign else "the diagnosis does not have"
        raise InvalidData(
            f"the diagnosis is of another model, or of another tool: {has} {what!r}; the model's "
            f"links are {', '.join(links)} and its joints {', '.join(joints)}"
            f"{nearest(what, names) if foreign else ''}"
        )
    fault, along, sds = diagnosis.fault, {}, {}
    for link, slide in diagnosis.directions.items():
        along[link] = np.array(slide.axis, dtype=float)
        sds[link] = _sd_of(slide.half_angle_deg)
    if not along and fault.where is not None and fault.direction is not None:
        along[fault.where] = np.array(fault.direction, dtype=float)
        sds[fault.where] = _sd_of(fault.direction_half_angle_deg)
    records: list[Seen] = []
    last = None
    for record in diagnosis.records:
        if record.condition != "suspect" or set(joints) - set(record.pose):
            continue
        if not record.probabilities:  # it could not be used, and may be taken again
            continue
        last = record
        records.append(
            Seen(
                pose=np.array([record.pose[joint] for joint in joints], dtype=float),
                excited=record.excited,
            )
        )
    if not along and last is not None and last.direction_tool is not None:
        # Of an earlier version: what its records show is one direction, told in every pose anew.
        seen = np.array(last.direction_tool, dtype=float)
        records[-1] = replace(records[-1], direction=seen, sd=_sd_of(last.half_angle_deg))
    total = sum(diagnosis.posterior.values())
    return Known(
        probabilities={name: diagnosis.posterior[name] / total for name in names},
        records=tuple(records),
        directions=along,
        direction_sd=sds,
    )


def _sd_of(half_angle_deg: float | None) -> float:
    """Standard deviation of a direction from its 95 % cone [rad]."""
    if half_angle_deg is None:
        return _LEAST_SD
    return float(max(np.radians(half_angle_deg) / CONE_95, 1e-3))


def belief_of(
    known: Known,
    arm: Arm,
    names: Sequence[str],
    links: Sequence[str],
    directions: Array,
    frictions: int,
) -> Belief:
    """Spread what is known over the directions and frictions of a belief.

    The hypotheses keep their probabilities. Within a link, directions are weighted by the one that
    all runs together have for it, or by what was seen in each pose where records say that.
    """
    n, count = arm.n, len(directions)
    prior = dict.fromkeys(names[1 : n + 1], 1 / (3 * n)) | dict.fromkeys(
        names[n + 1 :], 1 / (3 * n)
    )
    prior[HEALTHY] = 1 / 3
    share = {name: max(known.probabilities.get(name, 0.0), 1e-9) for name in names}
    share = share if known.probabilities else prior
    log = np.zeros((n, count))
    frames = ToolFrames(arm)
    for record in known.records:
        if record.direction is None:
            continue
        seen = record.direction[list(arm.axes)]
        seen = seen / max(float(np.linalg.norm(seen)), 1e-9)
        images = frames.images(record.pose)[0] @ directions.T  # (n, d, A)
        log += _log_near(np.einsum("idk,d->ik", images, seen), record.sd)
    for link, axis in known.directions.items():
        if link in links and not any(r.direction is not None for r in known.records):
            own = directions @ axis[: directions.shape[1]]
            sd = known.direction_sd.get(link, _USUAL_SD)
            log[list(links).index(link)] += _log_near(own, sd)
    log -= np.logaddexp.reduce(log, axis=1, keepdims=True)
    slides = np.log([share[name] for name in names[1 : n + 1]])[:, None] + log
    plays = np.log([share[name] for name in names[n + 1 :]])
    loose = np.concatenate([slides.ravel(), plays])
    return Belief(
        healthy=np.log([share[HEALTHY]]),
        loose=np.repeat(loose[:, None], frictions, axis=1)[None] - np.log(frictions),
        links=n,
        directions=directions,
    )


def _log_near(cosine: Array, sd: float) -> Array:
    """Log-density of an axial direction seen at an angle from where it should be."""
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    spread = np.hypot(sd, _LEAST_SD)
    return np.asarray(np.log(np.exp(-0.5 * (angle / spread) ** 2) + _DOUBT))
