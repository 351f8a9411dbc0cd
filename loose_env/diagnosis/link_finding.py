"""Link finding by turns of direction: tests, search over links, next poses, motion shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm, LinearArm, LinearPose
from loose_env.diagnosis.directions import (
    DirectionSighting,
    LinkPosterior,
    ToolFrames,
)
from loose_env.diagnosis.prediction import RecordStatistics, SensorFloor, predict, shut_seats
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation, at_levels
from loose_env.inference import overlap
from loose_env.io import Checked, Count, NonNegative, NonNegativeCount
from loose_env.statistics import ComparativeIndex, axial_difference, comparative_index
from loose_env.typing import Array

Order = Literal["outward", "inward", "bisection"]
Finding = Literal["still", "turned", "unclear"]


@dataclass(frozen=True, kw_only=True)
class LinkFindingSettings(Checked):
    """Thresholds and excitation of the method; the thesis prints no thresholds."""

    order: Order = "outward"
    """Order of the joints: from the base out, from the tool in, or halving."""
    joint: Count = 1
    """Joint that is excited, from 1."""
    level: Count = 3
    """Excitation level, from 1."""
    still: NonNegative = 0.35
    """Threshold e_min on abs(z*): below it the direction stayed (step 6)."""
    turned: NonNegative = 0.35
    """Threshold e_max on abs(abs(z*) - 1): below it the direction turned (step 7)."""
    retries: NonNegativeCount = 1
    """Further moves of one joint when neither threshold decides (step 8)."""
    index: Literal["d", "e"] = "d"
    """Comparative index that is asked about healthy: D (6.18) or E (6.17)."""
    healthy_index: NonNegative = 0.01
    """Comparative index up to which the arm looks healthy."""
    healthy_poses: Count = 2
    """Poses that must look healthy before the verdict healthy."""
    backlash_angle: NonNegative = 20.0
    """Rms angle to a joint's own line up to which play in that joint explains it [deg]."""
    backlash_kurtosis: float = 0.5
    """Excess kurtosis along that line above which the motion is not normal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """Direction of looseness in one record, in the plane."""

    pose: Array
    """Pose [rad] (n,)."""
    direction: float
    """Direction of lowest correlation in the tool frame [rad], axial."""
    correlation: float
    """Maximum correlation [1]."""
    kurtosis: float
    """Excess kurtosis along the direction [1]."""
    nominal_direction: float
    """Direction of lowest correlation of the nominal healthy arm [rad], axial."""
    nominal_correlation: float
    """Maximum correlation of the nominal healthy arm [1]."""

    @property
    def index(self) -> ComparativeIndex:
        """Comparative index against the nominal healthy arm (6.15 to 6.18)."""
        return comparative_index(
            self.nominal_correlation, self.nominal_direction, self.correlation, self.direction
        )


def judge_axes(
    before: ArrayLike,
    after: ArrayLike,
    *,
    move: float,
    settings: LinkFindingSettings,
    axis: ArrayLike = (0.0, 0.0, 1.0),
) -> Finding:
    """Say whether the direction turned when one joint moved (steps 5 to 8 of 4.2.2).

    The axis of the rotation between the directions is estimated by z* = (p x p*) / sin(-move)
    (4.31). In the plane it is a number times the normal: 0 if the direction stayed, 1 if it turned
    by the whole move. As the sign of a direction is unknown, so is that of z*: both z* and -z* are
    held against the axis of the joint. In space z* has the length of the axis only for a direction
    across it: at an angle b from the axis it is off by e, tan(e) = cot(b) / cos(move / 2).
    """
    if abs(np.sin(move)) < 1e-6:
        return "unclear"
    p, turned = (np.append(np.asarray(v, dtype=float), [0.0])[:3] for v in (before, after))
    estimate = np.cross(p, turned) / np.sin(-move)
    if np.linalg.norm(estimate) < settings.still:
        return "still"
    line = np.asarray(axis, dtype=float)
    off = min(np.linalg.norm(estimate - line), np.linalg.norm(estimate + line))
    return "turned" if off < settings.turned else "unclear"


def judge_turn(
    before: Sighting, after: Sighting, joint: int, settings: LinkFindingSettings
) -> Finding:
    """Say whether the planar direction turned when a joint moved (4.31), see `judge_axes`.

    Parameters
    ----------
    before, after : Sighting
        Records in two poses that differ in ``joint`` alone.
    joint : int
        The joint that moved, from 1.
    settings : LinkFindingSettings
        Holds the two thresholds.
    """
    axes = [(np.cos(seen.direction), np.sin(seen.direction)) for seen in (before, after)]
    move = float(after.pose[joint - 1] - before.pose[joint - 1])
    return judge_axes(*axes, move=move, settings=settings)


def next_joint(order: Order, low: int, high: int) -> int:
    """Joint to move next while the loose link lies in low..high.

    A move of joint j that turns the direction says that the link is below j; one that leaves
    it says j or above.

    Examples
    --------
    >>> next_joint("outward", 1, 6), next_joint("inward", 1, 6), next_joint("bisection", 1, 6)
    (2, 6, 4)
    """
    if order == "outward":
        return low + 1
    if order == "inward":
        return high
    return (low + high + 1) // 2


def looks_healthy(sightings: Sequence[Sighting], settings: LinkFindingSettings) -> bool:
    """True if the comparative index is below its threshold in every record."""
    values = [s.index.mag_d if settings.index == "d" else s.index.mag_e for s in sightings]
    return max(values) <= settings.healthy_index


def backlash_joint(
    linear: LinearArm, sightings: Sequence[Sighting], settings: LinkFindingSettings
) -> int | None:
    """Joint whose line all directions keep to, with motion that is not normal; None without."""
    if max(s.kurtosis for s in sightings) < settings.backlash_kurtosis:
        return None
    rms = []
    for j in range(linear.arm.n):
        off = []
        for s in sightings:
            line = linear.at(s.pose).kinematic[:, j]
            off.append(axial_difference(s.direction, float(np.arctan2(line[1], line[0]))))
        rms.append(float(np.sqrt(np.mean(np.square(off)))))
    best = int(np.argmin(rms))
    return best + 1 if np.degrees(rms[best]) <= settings.backlash_angle else None


JointChoice = Literal["one", "all"]


def blind_joints(
    frames: ToolFrames,
    pose: ArrayLike,
    direction: ArrayLike,
    *,
    moves: ArrayLike = (np.pi / 2,),
    least: float = np.radians(20.0),
) -> NDArray[np.bool_]:
    """Joints whose own move cannot visibly turn a direction seen in a pose (n,).

    Those are joints that slide, and hinges with an axis along the direction: at an angle b from the
    axis, a move D turns it by 2 asin(sin(b) sin(D / 2)). Of several moves [rad] the one counts that
    turns it most; ``least`` is some three standard deviations of the difference of two directions.
    """
    p = np.zeros(3)
    p[list(frames.arm.axes)] = np.asarray(direction, dtype=float)
    along = frames.axes(pose)[0] @ (p / np.linalg.norm(p))
    sine = np.sqrt(np.maximum(0.0, 1 - along**2))
    turn = 2 * np.arcsin(np.abs(np.outer(sine, np.sin(np.asarray(moves, dtype=float) / 2))))
    turn = np.minimum(turn, np.pi - turn).max(axis=1)  # axial
    return np.asarray(frames.slides | (turn < least))


def candidate_poses(
    arm: Arm,
    pose: ArrayLike,
    moves: ArrayLike,
    *,
    joints: JointChoice,
    sliding: Sequence[bool] | NDArray[np.bool_],
    most: int = 2048,
    rng: np.random.Generator | None = None,
) -> Array:
    """Poses that one move reaches within the ranges (C, n); the first is the pose itself.

    Joints that slide stay: they cannot turn a direction. So does joint 1, which carries the
    whole arm along and changes nothing in the tool frame.

    Parameters
    ----------
    arm : Arm
        The arm, for its ranges.
    pose, moves : array_like (n,), (m,)
        Current pose [rad, or m], and moves of one hinge [rad]; staying is always among them.
    joints : {"one", "all"}
        Joints that move.
    sliding : sequence of bool (n,)
        Joints that slide.
    most : int
        With more combinations than this, as many are drawn, beside the moves of single joints.
    rng : numpy.random.Generator, optional
        Source of that draw; always the same one by default.
    """
    q = np.asarray(pose, dtype=float)
    options: list[Array] = []
    for j, limits in enumerate(arm.joint_ranges):
        steps = np.zeros(1)
        if j > 0 and not sliding[j]:
            steps = np.concatenate([steps, np.asarray(moves, dtype=float)])
            steps = steps[np.sort(np.unique(steps, return_index=True)[1])]  # zero stays first
            if limits is not None:
                there = q[j] + steps
                fits = (there >= limits[0] - 1e-9) & (there <= limits[1] + 1e-9)
                fits[0] = True
                steps = steps[fits]
        options.append(q[j] + steps)
    single = [q]
    for j, choices in enumerate(options):
        for value in choices[1:]:
            single.append(np.where(np.arange(arm.n) == j, value, q))
    if joints == "one":
        return np.array(single)
    if np.prod([float(len(o)) for o in options]) <= most:
        grid = np.meshgrid(*options, indexing="ij")
        return np.stack([g.ravel() for g in grid], axis=1)
    generator = np.random.default_rng(0) if rng is None else rng
    drawn = np.stack([generator.choice(o, size=most) for o in options], axis=1)
    return np.vstack([single, drawn])


def choose_move(
    frames: ToolFrames,
    posterior: LinkPosterior,
    candidates: ArrayLike,
    *,
    sd: float | ArrayLike,
    count: int = 1,
    chunk: int = 1024,
) -> tuple[NDArray[np.intp], Array]:
    """Choose the poses whose next direction tells the remaining hypotheses best apart.

    Each hypothesis predicts a direction in each candidate. Two of them, an angle d apart, are
    confused no more often than exp(-d² / 8 s²), with s the standard deviation of measurement and
    prediction together (Bhattacharyya's bound). The candidate with the least confusion over all
    pairs wins, pairs weighted by their probabilities.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    posterior : LinkPosterior
        Prior knowledge.
    candidates : array_like (C, n)
        Poses to choose from, ``chunk`` of them weighted at once.
    sd : float or array_like (C, 2 n)
        Standard deviation that the next direction is expected to have, in each pose under each
        hypothesis [rad].
    count : int
        Number of the best candidates to return.

    Returns
    -------
    index : ndarray of int (count,)
        The best candidates, best first; among equals the order of the candidates.
    confusion : ndarray (count,)
        Their remaining share of confusion, 0 to 1; 1: nothing can be told apart.
    """
    spread = np.asarray(sd, dtype=float)
    rows, n = np.atleast_2d(np.asarray(candidates, dtype=float)), frames.arm.n
    weight = posterior.probabilities
    alive = np.flatnonzero(weight > 1e-4 * weight.max())
    one, other = np.triu_indices(len(alive), 1)
    if not len(one):
        return np.arange(min(count, len(rows))), np.zeros(min(count, len(rows)))
    pair = weight[alive][one] * weight[alive][other]
    own = np.concatenate([posterior.direction_sd**2, np.zeros(n)])[alive]
    own = 0.5 * (own[one] + own[other])
    spread = np.broadcast_to(spread, (len(rows), len(weight)))[:, alive]
    confusion = np.empty(len(rows))
    for start in range(0, len(rows), chunk):
        part = rows[start : start + chunk]
        slide = np.einsum("ckij,kj->cki", frames.images(part), posterior.directions)
        seen = np.concatenate([slide, frames.unit_lines(part)], axis=1)[:, alive]
        cosine = np.abs(np.einsum("cpi,cpi->cp", seen[:, one], seen[:, other]))
        angle = np.arccos(np.minimum(cosine, 1.0))
        errors = spread[start : start + chunk] ** 2
        variance = 0.5 * (errors[:, one] + errors[:, other]) + own
        confusion[start : start + chunk] = overlap(angle**2, variance) @ pair
    best = np.argsort(confusion, kind="stable")[:count]
    return best, confusion[best] / pair.sum()


@dataclass(frozen=True, kw_only=True)
class TurnSearch:
    """Links in question: low..high. Each judged move gives a new search.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> frames = ToolFrames(planar(3))
    >>> search = TurnSearch.over(3)
    >>> poses = np.array([[0.0, 0.4, 0.1], [0.0, 1.9, 0.1]])
    >>> seen = frames.images(poses)[:, 1] @ [0.6, 0.8]  # a slide at link 2
    >>> before, after = (DirectionSighting.of(q, p, 0.05) for q, p in zip(poses, seen))
    >>> found = search.after(frames, before, after, joint=2, rules=LinkFindingSettings())
    >>> found.low, found.high
    (2, 3)
    """

    low: int
    """Lowest link in question."""
    high: int
    """Highest link in question."""
    tries: int = 0
    """Moves of the present joint that decided nothing."""

    @classmethod
    def over(cls, links: int) -> TurnSearch:
        """Begin with every link of an arm in question."""
        return cls(low=1, high=links)

    def joint(
        self,
        frames: ToolFrames,
        seen: DirectionSighting,
        *,
        moves: Array,
        rules: LinkFindingSettings,
        can_move: NDArray[np.bool_] | None = None,
    ) -> int | None:
        """Joint to move next from where a direction was seen; None if nothing is left to do.

        Joints that cannot turn the direction by one of the moves [rad], or that their ranges hold,
        are passed over for the nearest other one. Where only those are left, the links in question
        cannot be told apart from this pose.
        """
        if self.low >= self.high:
            return None
        blind = blind_joints(frames, seen.pose, seen.direction, moves=moves)
        if can_move is not None:
            blind = blind | ~can_move
        wanted = next_joint(rules.order, self.low, self.high)
        seeing = [j for j in range(self.low + 1, self.high + 1) if not blind[j - 1]]
        return min(seeing, key=lambda j: abs(j - wanted)) if seeing else None

    def after(
        self,
        frames: ToolFrames,
        before: DirectionSighting,
        after: DirectionSighting,
        *,
        joint: int,
        rules: LinkFindingSettings,
        visible: bool = True,
    ) -> TurnSearch:
        """Narrow the links by what the move of a joint did (steps 5 to 8 of 4.2.2).

        ``before`` and ``after`` are directions in two poses that differ in that joint, from 1,
        alone, else InvalidData. Without a visible direction the move is one more try; out of
        retries, the nearer threshold decides.
        """
        moved = after.pose - before.pose
        if np.abs(np.delete(moved, joint - 1)).max(initial=0.0) > 1e-6:
            raise InvalidData(
                f"a turn is judged by the move of joint {joint} alone; the poses differ by {moved}"
            )
        judged = partial(
            judge_axes,
            before.direction,
            after.direction,
            move=float(moved[joint - 1]),
            axis=frames.axes(after.pose)[0, joint - 1] if frames.dimension == 3 else (0, 0, 1),
        )
        finding = judged(settings=rules) if visible else "unclear"
        if finding == "unclear":
            if self.tries < rules.retries:
                return replace(self, tries=self.tries + 1)
            nearer = LinkFindingSettings(still=0.5, turned=np.finfo(float).max)
            finding = judged(settings=nearer)
        if finding == "turned":
            return TurnSearch(low=self.low, high=max(self.low, joint - 1))
        return TurnSearch(low=min(self.high, joint), high=self.high)

    def link(self, rules: LinkFindingSettings) -> int:
        """Link to name now: the end at which the order of the search began."""
        return self.high if rules.order == "inward" else self.low


_LEAST = 0.05
"""Openness below which a seat counts as shut."""


def expected_openness(
    linear: LinearArm, posterior: LinkPosterior, poses: ArrayLike, *, level: float
) -> Array:
    """Expected openness of seats in several poses, all joints excited (C, 2 n), 0 shut to 1 free.

    Gravity along a slide holds it shut until the excitation overcomes it. With F the rms force that
    the shut seat transmits along its slide and G the weight it carries along it, the share is
    F / sqrt(F² + G²). Friction is unknown, and the same in all poses.
    """
    shares = []
    for row in np.atleast_2d(np.asarray(poses, dtype=float)):
        at = linear.at(row)
        excitation, _ = at_levels(at, np.full(linear.arm.n, level), duration=1.0)
        torque = np.array(excitation.torque_rms)
        force, load = shut_seats(at, torque, posterior.directions[:, None])
        size = np.hypot(force, load)
        shares.append(np.divide(force, size, out=np.zeros_like(size), where=size > 0))
    return np.array(shares)


def choose_open_move(
    frames: ToolFrames,
    linear: LinearArm,
    posterior: LinkPosterior,
    candidates: ArrayLike,
    *,
    sd: float,
    level: float,
    shortlist: int = 12,
) -> Array:
    """Choose the pose that discriminates best between seats, gravity considered (n,).

    The ``shortlist`` best candidates by direction alone are looked at again with each hypothesis's
    standard deviation divided by how open its seat would be there.

    Parameters
    ----------
    frames, linear
        The arm's rotations and its linear model.
    posterior : LinkPosterior
        Prior knowledge.
    candidates : array_like (C, n)
        Poses to choose from.
    sd : float
        Standard deviation of the direction of an open seat [rad].
    level : float
        Excitation: rms acceleration of the tool from each joint [m/s²].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis import DirectionSighting, link_posterior
    >>> arm = planar(2)
    >>> frames = ToolFrames(arm)
    >>> known = link_posterior(frames, [DirectionSighting.of([0, 0.5], [0.6, 0.8], 0.05)])
    >>> where = candidate_poses(arm, [0, 0.5], [-1.0, 1.5], joints="one", sliding=frames.slides)
    >>> where[choose_move(frames, known, where, sd=0.05)[0]].tolist()
    [[0.0, 2.0]]
    >>> choose_open_move(frames, LinearArm(arm), known, where, sd=0.05, level=4.0).tolist()
    [0.0, 2.0]
    """
    rows = np.atleast_2d(np.asarray(candidates, dtype=float))
    best, _ = choose_move(frames, posterior, rows, sd=sd, count=shortlist)
    shares = expected_openness(linear, posterior, rows[best], level=level)
    again, _ = choose_move(frames, posterior, rows[best], sd=sd / np.maximum(shares, _LEAST))
    return np.asarray(rows[best[again[0]]])


@dataclass(frozen=True, kw_only=True)
class MotionShape:
    """Shape of the tool's motion in a record with one joint driven."""

    across: float
    """Second largest variance over the one of the nominal arm [1]; about 1 on one line."""
    kurtosis: float
    """Largest excess kurtosis along the tool axes [1]; about 0 if normal."""

    def is_play(self, *, across: float = 5.0, kurtosis: float = 0.3) -> bool:
        """Tell whether the motion is one-dimensional and not normal.

        Examples
        --------
        >>> MotionShape(across=1.1, kurtosis=1.5).is_play()
        True
        >>> MotionShape(across=90.0, kurtosis=1.5).is_play()  # a slide beyond the joint
        False
        """
        return self.across <= across and self.kurtosis >= kurtosis


def shape_of_motion(
    record: RecordStatistics, nominal: LinearPose, floor: SensorFloor
) -> MotionShape:
    """Shape of the tool's motion with one joint driven.

    Parameters
    ----------
    record : RecordStatistics
        Record with exactly one joint excited.
    nominal : LinearPose
        The nominal arm in the record's pose.
    floor : SensorFloor
        Noise of the sensors in the arm's band.

    Raises
    ------
    InvalidData
        If not exactly one joint was excited.
    """
    driven = np.flatnonzero(record.excited)
    if len(driven) != 1:
        raise InvalidData(
            "the shape of the motion tells play in one driven joint; joints "
            f"{(driven + 1).tolist()} were excited: excite one alone"
        )
    shake = Excitation(
        torque_rms=tuple(float(t) for t in record.torque),
        duration=record.duration,
        band=nominal.linear.arm.band,
    )
    expected = np.linalg.eigvalsh(predict(nominal, shake, floor).tool)[-2]
    found = np.linalg.eigvalsh(record.tool_covariance)[-2]
    return MotionShape(across=float(found / expected), kurtosis=float(record.kurtosis.max()))
