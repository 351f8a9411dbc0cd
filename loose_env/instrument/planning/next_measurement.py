"""Choice of the next measurement (pose, joint) by expected information; features of seats.

`next_measurement` serves the plan and the diagnosis alike. What is known is spread over locations,
directions and frictions; a few dozen imagined faults are drawn from it; and for each candidate the
nominal arm says what its record would show of each of them
(`loose_env.diagnosis.experiment_design.RecordInformation`): gravity that keeps
seats shut, torque that is left beside it, noise and errors of the model all count. Among the
candidates that are about as good the one that moves the arm least is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm, LinearArm, Mismatch
from loose_env.diagnosis import ImaginedFaults, Proposal, RecordInformation, SeatFeatures
from loose_env.errors import InvalidData, UnknownName
from loose_env.excitation import at_levels
from loose_env.instrument.planning.candidate_poses import Allowed, candidate_poses
from loose_env.instrument.planning.excitation import limited, proposed, torque_of
from loose_env.instrument.planning.prior_knowledge import Known, belief_of, names_of
from loose_env.instrument.planning.rationale import reason
from loose_env.instrument.result import NextMeasurement
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import EQUALLY_INFORMATIVE
from loose_env.typing import Array

_FRICTIONS = np.geomspace(0.02, 1.0, 8)
"""Assumed friction of seats over the drive of the top level [1]."""
_DIRECTIONS = 120
_SHORTLIST = 5
"""Poses for which band and levels are computed."""
_POINTS = 40
"""Frequencies of the score of a seat."""
_SKETCH_POINTS = 8
"""Frequencies of the coarse score of a pose."""


def next_measurement(
    arm: Arm,
    linear: LinearArm,
    known: Known | None = None,
    settings: NextSettings | None = None,
    *,
    links: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    allowed: Allowed | None = None,
    reachable: Callable[[Array, Array], bool] | None = None,
    start: ArrayLike | None = None,
    shakable: Collection[str] | None = None,
    only: str | None = None,
    pose: ArrayLike | None = None,
    cap: Callable[[Array, int, tuple[float, float]], float] | None = None,
) -> NextMeasurement:
    """Choose what to measure next.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm = planar(2)
    >>> first = next_measurement(arm, LinearArm(arm), settings=NextSettings(poses=4))
    >>> sorted(first.pose), first.joints[0] in first.pose
    (['joint1', 'joint2'], True)
    """
    rules = NextSettings() if settings is None else settings
    so_far = Known() if known is None else known
    links = tuple(arm.seat_bodies if links is None else links)
    joints = tuple(arm.joints if joints is None else joints)
    if only is not None and only not in joints:
        raise UnknownName(f"there is no driven joint {only!r}; the joints are {', '.join(joints)}")
    can = joints if shakable is None else tuple(name for name in joints if name in shakable)
    if not can or (only is not None and only not in can):
        raise InvalidData(
            f"arm {arm.name!r}: a signal can be given for joints with a motor or a position servo: "
            f"{', '.join(can) or 'none'}" + ("" if only is None else f", and not for {only!r}")
        )
    seed = np.random.SeedSequence([rules.seed, len(so_far.records)])
    rng_poses, rng_faults = (np.random.default_rng(s) for s in seed.spawn(2))
    arm, linear = limited(arm, linear, rules)
    features = seat_features(linear, rules)
    information = RecordInformation(features, _FRICTIONS)
    sketch = RecordInformation(
        SeatFeatures(
            features.linear,
            rules.sensors,
            Mismatch(),
            directions=_DIRECTIONS,
            points=_SKETCH_POINTS,
        ),
        _FRICTIONS,
    )
    belief = belief_of(
        so_far, arm, names_of(links, joints), links, features.directions, len(_FRICTIONS)
    )
    faults = information.imagine(belief, rng_faults)
    here = so_far.records[-1].pose if so_far.records else None
    here = here if start is None else np.asarray(start, dtype=float)
    if pose is not None:
        where = np.atleast_2d(np.asarray(pose, dtype=float))
    else:
        where = candidate_poses(
            arm,
            linear,
            count=rules.poses,
            margin=rules.margin,
            rng=rng_poses,
            here=here,
            allowed=allowed,
        )
    wanted = [k for k, name in enumerate(joints) if name in can and (only is None or name == only)]

    rough = np.array([_rough(sketch, faults, q, wanted, rules.seconds) for q in where])
    best: list[tuple[float, float, int, Array, Proposal]] = []
    for p in np.argsort(-rough, kind="stable"):
        if len(best) >= _SHORTLIST * len(wanted):
            break
        q = where[p]
        if here is not None and reachable is not None and not reachable(here, q):
            continue
        proposal = proposed(arm, q, rules)
        for j in wanted:
            torque = _capped(proposal, q, j, rules, cap)
            if not torque.any() or _taken(so_far, q, joints[j]):
                continue
            # Rounding of a record that says nothing may be below zero.
            found = max(information.of(faults, q, torque, rules.seconds).information, 0.0)
            best.append((found, _distance(arm, here, q), j, q, proposal))
    if not best:
        raise InvalidData(
            f"arm {arm.name!r}: of {len(where)} poses none leaves a joint free to shake the tool: "
            "either drives are used up by gravity, the tool lies on the joints' axes, or no pose "
            "can be reached without a collision; look at 'loose inspect', name another tool, or "
            "give the pose yourself"
        )
    top = max(found for found, *_ in best)
    good = [one for one in best if one[0] >= EQUALLY_INFORMATIVE * top]
    chosen = min(good, key=lambda one: (round(one[1], 6), -one[0]))
    there = sorted((one for one in best if one[3] is chosen[3]), key=lambda one: -one[0])
    played = [chosen[2], *(one[2] for one in there if one[2] != chosen[2])][: rules.in_turn]
    torques = [float(_capped(chosen[4], chosen[3], j, rules, cap)[j]) for j in played]
    return _written(
        arm, linear, so_far, chosen[3], chosen[4], played, torques, chosen[0], rules, links,
        joints, here,
    )  # fmt: skip


def seat_features(
    linear: LinearArm, settings: NextSettings, *, directions: int = _DIRECTIONS
) -> SeatFeatures:
    """Places of an arm, with the sensors of the settings and the usual errors of a model."""
    few = LinearArm(linear.arm, points=min(_POINTS, len(linear.frequency)))
    return SeatFeatures(few, settings.sensors, Mismatch(), directions=directions)


def _rough(
    information: RecordInformation,
    faults: ImaginedFaults,
    pose: Array,
    wanted: Sequence[int],
    seconds: float,
) -> float:
    """Information of the best joint at the arm's middle level."""
    arm = information.features.linear.arm
    at = information.features.linear.at(pose)
    top = 0.0
    for j in wanted:
        if np.linalg.norm(at.kinematic[:, j]) < 1e-6:
            continue
        levels = np.where(np.arange(arm.n) == j, arm.levels[-1], 0.0)
        torque = np.array(at_levels(at, levels, duration=seconds)[0].torque_rms)
        if torque[j] > 0:
            top = max(top, information.of(faults, pose, torque, seconds).information)
    return top


def _capped(
    proposal: Proposal,
    pose: Array,
    joint: int,
    rules: NextSettings,
    cap: Callable[[Array, int, tuple[float, float]], float] | None,
) -> Array:
    """Torque of the proposed level (n,), within what a controller allows."""
    torque = torque_of(proposal, joint, rules)
    if cap is None or not torque[joint] > 0:
        return torque
    return torque * min(1.0, cap(pose, joint, proposal.band) / float(torque[joint]))


def _taken(known: Known, pose: Array, joint: str) -> bool:
    """True if a joint was excited in a pose before: repeating it is uninformative."""
    return any(
        joint in record.excited and np.abs(record.pose - pose).max() < 1e-2
        for record in known.records
    )


def _distance(arm: Arm, here: Array | None, pose: Array) -> float:
    """Largest move of a joint, over half a turn or a slide's range [1]."""
    if here is None:
        return 0.0
    scale = np.full(arm.n, np.pi)
    for j in np.flatnonzero(arm.sliding):
        limits = arm.joint_ranges[j]
        scale[j] = 1.0 if limits is None else max(limits[1] - limits[0], 1e-6)
    return float((np.abs(pose - here) / scale).max())


def _written(
    arm: Arm,
    linear: LinearArm,
    known: Known,
    pose: Array,
    proposal: Proposal,
    played: Sequence[int],
    torques: Sequence[float],
    nats: float,
    rules: NextSettings,
    links: Sequence[str],
    joints: Sequence[str],
    here: Array | None,
) -> NextMeasurement:
    levels = []
    inner = (
        linear if proposal.band == arm.band else linear.variant(replace(arm, band=proposal.band))
    )
    for j, torque in zip(played, torques, strict=True):
        answer = inner.at(pose).response(np.arange(arm.n) == j).joint[:, j, 0]
        levels.append(torque * float(np.sqrt(np.mean(np.abs(answer) ** 2))))
    return NextMeasurement(
        pose={name: float(q) for name, q in zip(joints, pose, strict=True)},
        joints=tuple(joints[j] for j in played),
        band_hz=(float(proposal.band[0]), float(proposal.band[1])),
        levels=tuple(levels),
        torques=tuple(torques),
        seconds=rules.seconds,
        rate_hz=rules.rate_hz,
        reason=reason(arm, known, pose, links, joints, here),
        gain=float(nats / np.log(2)),
        settings=asdict(rules),
    )
