"""Design of one record: band and level by joint, information, seats shown; fewest records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from loose_env.arms import LinearArm, distinct
from loose_env.diagnosis.features import SeatFeatures
from loose_env.diagnosis.posterior import (
    LOOSE,
    OPENINGS,
    Belief,
    OpeningTable,
    away_from,
    shipped_table,
)
from loose_env.diagnosis.prediction import (
    INERTIA_ERROR,
    LINEAR_ERROR,
    POWER_ERROR,
    channel_noise,
    independent_samples,
    joints_on,
    predict_seats,
    seat_drives,
    shut_seats,
)
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import SeatReference, at_levels
from loose_env.inference import expected_log_score, overlap, squared_distances, whitener
from loose_env.statistics import axes_grid
from loose_env.typing import Array, IndexArray

SEAT_AXES = {2: 12, 3: 40}
"""Sliding directions that stand for all of a link, by dimension."""


_FAULTS = 96
"""Simulated faults that represent a belief."""
_BLUR = 16.0
"""Variance of everything predicted, over what errors and sampling leave [1]."""


@dataclass(frozen=True, kw_only=True)
class InformationFactors:
    """Realised over expected information, by kind of record."""

    length: float = 0.0
    """Exponent of the record's length over a second."""
    together: float = 0.0
    """Logarithm of the factor where all joints are shaken, none where one is."""
    joints: tuple[float, ...] = ()
    """Logarithm of the factor of each joint; of several that are shaken, their mean. None: 0."""

    def of(self, excited: NDArray[np.bool_], seconds: Array) -> Array:
        """Factors of C records that shake some joints (C, n) for some seconds (C,)."""
        alone = 1 / excited.shape[1]
        share = (excited.mean(axis=1) - alone) / max(1 - alone, alone)
        own = excited @ np.array(self.joints or np.zeros(excited.shape[1])) / excited.sum(axis=1)
        return np.asarray(seconds**self.length * np.exp(self.together * share + own))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImaginedFaults:
    """Samples of M faults from each of A beliefs; some may have no weight."""

    weight: Array
    """Probability of each (A, M)."""
    hypothesis: NDArray[np.intp]
    """0 for healthy, else 1 + the hypothesis with a fault (A, M)."""
    location: NDArray[np.intp]
    """Place of the seat; any for healthy (A, M)."""
    friction: Array
    """Friction over the seat drive of the top level (A, M)."""
    chance: Array
    """A uniform number each, which decides how its seat opens (A, M)."""

    def __getitem__(self, rows: Any) -> ImaginedFaults:
        """Those of some beliefs."""
        return ImaginedFaults(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class Expectation:
    """Expected information gain of C records."""

    information: Array
    """Expected fall of the log score [nat] (C,)."""
    sure: Array
    """Expected probability of the most probable hypothesis after it [1] (C,)."""


USUAL_FACTORS = InformationFactors(length=0.06, together=-0.46)
"""Fitted on records of planar4; `loose_agents.posterior_training` fits
those of other arms."""


class RecordInformation:
    """Expected information gain of candidate records.

    Parameters
    ----------
    features : SeatFeatures
        The nominal arm and its locations.
    frictions : ndarray (F,)
        Nodes of friction of the beliefs, over the seat drive of the top level [1].
    factors : InformationFactors, optional
        Realised share of the expected information; the usual one by default.
    """

    def __init__(
        self,
        features: SeatFeatures,
        frictions: Array,
        *,
        factors: InformationFactors | None = None,
    ) -> None:
        self.features, self.frictions = features, frictions
        self.factors = USUAL_FACTORS if factors is None else factors
        self.table = shipped_table()
        both = np.stack([self.table.slide, self.table.hinge])
        self._cumulative = np.cumsum(both.reshape(-1, len(OPENINGS) * len(LOOSE)), axis=1)
        self._hypotheses = 2 + int(features.hypothesis.max())

    def imagine(
        self, beliefs: Sequence[Belief], rngs: Sequence[np.random.Generator]
    ) -> ImaginedFaults:
        """Thin beliefs by systematic resampling, each by its own generator."""
        every = [self._thinned(*each) for each in zip(beliefs, rngs, strict=True)]
        return ImaginedFaults(**{name: np.stack([own[name] for own in every]) for name in every[0]})

    def _thinned(self, belief: Belief, rng: np.random.Generator) -> dict[str, Any]:
        """Faults as of `ImaginedFaults`, filled up with the first one without weight."""
        nodes = belief.loose.shape[2]
        top = max(float(belief.healthy.max()), float(belief.loose.max()))
        healthy = np.exp(belief.healthy - top).sum()
        weight = np.concatenate([[healthy], np.exp(belief.loose - top).sum(0).ravel()])
        weight = weight / weight.sum()
        count = _FAULTS
        ticks = (np.arange(count) + rng.random()) / count
        drawn, times = np.unique(
            np.minimum(np.searchsorted(np.cumsum(weight), ticks), len(weight) - 1),
            return_counts=True,
        )
        # A fault that is drawn often may still open in many ways.
        copies = np.repeat(drawn, np.minimum(times, 6))
        share = np.repeat(times / np.minimum(times, 6), np.minimum(times, 6)) / count
        chance, rest = rng.random(len(copies)), count - len(copies)
        copies = np.pad(copies, (0, rest), constant_values=copies[0])
        loose = np.maximum(copies - 1, 0)
        location = np.where(copies > 0, loose // nodes, 0)
        return {
            "weight": np.pad(share, (0, rest)),
            "hypothesis": np.where(copies > 0, 1 + self.features.hypothesis[location], 0),
            "location": location,
            "friction": self.frictions[loose % nodes],
            "chance": np.pad(chance, (0, rest), constant_values=chance[0]),
        }

    def of(
        self,
        faults: ImaginedFaults,
        poses: Array,
        torque: Array,
        durations: Any,
        planned: Array | None = None,
        *,
        beliefs: IndexArray | None = None,
    ) -> Expectation:
        """Expected information gain of C records at poses (C, n) by rms torques (C, n) [N·m].

        Parameters
        ----------
        faults : ImaginedFaults
            The beliefs, thinned.
        poses, torque : ndarray (C, n)
            Poses [rad or m] and rms torques [N·m]; at least one joint is on in every record.
        durations : ndarray (C,)
            Lengths [s].
        planned : ndarray (A, M, M), optional
            Likelihood of records before it whose outcome is not known: products of `likelihoods`.
        beliefs : ndarray of int (C,), optional
            The belief that each record is taken under; the first by default.
        """
        of, count = _first(poses) if beliefs is None else beliefs, self._hypotheses
        before = faults.weight[:, None]
        if planned is not None:
            before = before * planned
        score_now, _ = expected_log_score(faults.weight, faults.hypothesis, before, count=count)
        information, sure = np.zeros((2, len(poses)))
        for rows, likely in self._likely(faults, poses, torque, durations, of):
            own = of[rows]
            likely *= before[own]
            score, sure[rows] = expected_log_score(
                faults.weight[own], faults.hypothesis[own], likely, count=count
            )
            information[rows] = score - score_now[own]
        factors = self.factors.of(torque > 0, durations)
        return Expectation(information=factors * information, sure=sure)

    def likelihoods(
        self,
        faults: ImaginedFaults,
        poses: Array,
        torque: Array,
        durations: Any,
        *,
        beliefs: IndexArray | None = None,
    ) -> Array:
        """Likelihood of the record of fault k, by row, under each other fault (C, M, M).

        Of C records, as `of` takes them.
        """
        found = np.empty((len(poses), faults.weight.shape[1], faults.weight.shape[1]))
        of = _first(poses) if beliefs is None else beliefs
        for rows, likely in self._likely(faults, poses, torque, durations, of):
            found[rows] = likely
        return found

    def _likely(
        self, faults: ImaginedFaults, poses: Array, torque: Array, durations: Any, of: IndexArray
    ) -> Iterator[tuple[IndexArray, Array]]:
        """Likelihoods of records with as many joints on, a few at a time, with their rows."""
        excited = np.count_nonzero(torque, axis=1)
        for count in np.unique(excited):
            rows = np.flatnonzero(excited == count)
            for own in np.array_split(rows, -(-len(rows) // _TOGETHER)):
                shown = self.outcomes(faults[of[own]], poses[own], torque[own], durations[own])
                # Two records of one fault differ too: each has its own errors.
                yield own, overlap(squared_distances(shown @ shown.mT), _BLUR / 2)

    def outcomes(
        self, faults: ImaginedFaults, poses: Array, torque: Array, durations: Any
    ) -> Array:
        """Features of simulated faults, one row for each record, in deviations (C, M, features)."""
        features = self.features
        linear, floor = features.linear, features.floor
        arm, on = linear.arm, joints_on(torque)
        m, d = on.shape[1], len(arm.axes)
        noise = channel_noise(floor, arm, on)
        different, back = distinct(poses)
        there = linear.at_all(different).some(back)
        seats = predict_seats(
            there, torque, features.directions, noise, locations=faults.location, free=True
        )
        x = seats.in_step[:, :m]
        b = seats.in_step[:, m:] @ np.linalg.inv(x)
        away = away_from(b)
        total = (seats.in_step[:, m:] ** 2).sum((1, 2))
        residual = away @ seats.rest @ away.mT
        residual += LINEAR_ERROR**2 * total[:, None, None] * np.eye(d)
        errors = features.errors(there, torque > 0, b)
        white = whitener(features.covariance(errors, residual, x, durations))
        samples = independent_samples(arm, durations)

        opening, loose = self._openings(faults, seats.force, seats.load)
        change = opening[..., None] * (features.open_change(seats) @ white.mT)
        nominal = np.diagonal(x, axis1=1, axis2=2)[:, None]
        opened = np.diagonal(seats.in_step_open[:, :, :m], axis1=2, axis2=3) / nominal
        error = np.sqrt(INERTIA_ERROR**2 + 1 / samples)[:, None, None]
        inertia = np.clip(opening[..., None] * opened / error, -10.0, 10.0)
        free = (away[:, None] @ seats.loose * away[:, None]).sum(-1)
        rest = np.diagonal(residual, axis1=1, axis2=2)[:, None]
        error = np.sqrt(POWER_ERROR**2 + 2 / samples)[:, None, None]
        motion = np.log1p(loose[..., None] * np.maximum(free, 0.0) / rest) / error
        return np.concatenate([np.clip(change, -60.0, 60.0), inertia, motion], axis=-1)

    def _openings(self, faults: ImaginedFaults, force: Array, load: Array) -> tuple[Array, Array]:
        """Opening and loose motion of the seat of every simulated fault (C, M) each."""
        at = faults.location
        friction = faults.friction * self.features.top[at]
        nodes = self.table.nodes(force, friction, load)
        # Plays follow the slides in one table of cumulative probabilities, which only rise.
        plays = at >= self.features.locations - self.features.linear.arm.n
        first = np.where(plays, len(self._cumulative) // 2, 0)
        pick, last = np.zeros(force.shape, dtype=np.intp), len(OPENINGS) * len(LOOSE) - 1
        for step in 2 ** np.arange(last.bit_length() - 1, -1, -1):
            cell = pick + step - 1
            inside = np.minimum(cell, last)
            mixed = sum(weight * self._cumulative[first + node, inside] for node, weight in nodes)
            pick += step * ((np.asarray(mixed) < faults.chance) & (cell <= last))
        pick = np.minimum(pick, last)
        loose = np.where(faults.hypothesis > 0, LOOSE[pick % len(LOOSE)], 0.0)
        opening = np.where(faults.hypothesis > 0, OPENINGS[pick // len(LOOSE)], 0.0)
        return opening, loose


def _first(poses: Array) -> IndexArray:
    return np.zeros(len(poses), dtype=np.intp)


_TOGETHER = 64
"""Records worked out at once: what the processor's cache holds."""

_STEPS = 7
"""Frictions across their range."""
_SHOWS = 0.08
"""Opening, toward either side, from which a seat shows: that of the first node beside shut [1]."""


class SeatCoverage:
    """Probability that a record shows each seat, if that is the loose one.

    A seat shows where it opens. How far it does was measured on simulated
    arms (`OpeningTable`): it follows from the rms force that drives it, gravity's load and its
    friction. The friction is known by its range alone, log-uniform over the drive of the strongest
    excitation, and is the same in every record.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    friction : (float, float)
        Range of the friction over the seat's drive by the top level [1].
    over : {"median", "best"}
        Pose whose drive that is, see `loose_env.excitation.SeatDrive`.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> seats = SeatCoverage(LinearArm(planar(2)), (0.02, 1.0))
    >>> weak, strong = (seats.shown(np.array([0.0, 1.0]), np.full(2, a)) for a in (0.5, 4.0))
    >>> weak.shape, bool(weak.mean() < strong.mean())
    ((26, 7), True)
    """

    def __init__(
        self, linear: LinearArm, friction: tuple[float, float], over: SeatReference = "median"
    ) -> None:
        arm, table = linear.arm, shipped_table()
        self.linear = linear
        self.axes = axes_grid(SEAT_AXES[len(arm.axes)], len(arm.axes))
        """Sliding directions in a link's frame (A, d)."""
        self._friction = seat_drives(linear, self.axes, over)[:, None] * np.geomspace(
            *friction, _STEPS
        )
        wide = np.abs(OPENINGS) > _SHOWS - 0.01
        self._shows = [part[:, :, wide].sum(axis=(2, 3)).ravel() for part in
                       (table.slide, table.hinge)]  # fmt: skip

    @property
    def frictions(self) -> int:
        """Number of frictions, F."""
        return int(self._friction.shape[1])

    def shown(self, pose: Array, levels: Array) -> Array:
        """Probability that a record shows each seat, by its possible frictions (n A + n, F).

        Joints move the tool with rms accelerations ``levels`` (n,) [m/s²]; 0 holds one. Seats are
        the sliding directions of each link, then the play of each joint.
        """
        at = self.linear.at(pose)
        excitation, _ = at_levels(at, levels, duration=1.0)
        force, load = shut_seats(at, np.asarray(excitation.torque_rms), self.axes)
        found = np.zeros(self._friction.shape)
        first = len(found) - self.linear.arm.n
        for node, weight in OpeningTable.nodes(force[:, None], self._friction, load[:, None]):
            found[:first] += weight[:first] * self._shows[0][node[:first]]
            found[first:] += weight[first:] * self._shows[1][node[first:]]
        return found


def needed_information(prior: ArrayLike, error: ArrayLike) -> Array:
    """Least information about the hypothesis that an error rate takes, by Fano [nat].

    Zero where a guess errs as little as that bound can tell.
    """
    delta = np.asarray(error, dtype=float)
    if not ((delta >= 0) & (delta <= 1)).all():
        raise InvalidSetting(f"an error rate is 0 to 1, got {error!r}")
    most, count = float(stats.entropy(prior)), int(np.count_nonzero(np.asarray(prior, dtype=float)))
    if count < 2:
        return np.zeros_like(delta)
    # Beyond this error, that of a guess among equals, the right side falls again.
    delta = np.minimum(delta, (count - 1) / count)
    inside = np.clip(delta, 1e-300, 1.0)
    binary = -inside * np.log(inside) - (1 - delta) * np.log1p(-delta)
    return np.asarray(np.maximum(most - binary - delta * np.log(count - 1), 0.0))


def least_records(
    error: ArrayLike,
    prior: ArrayLike,
    *,
    information: float | None = None,
    success: ArrayLike | None = None,
) -> Array:
    """Fewest records, on average, that an error rate takes: the larger of the two bounds.

    Information (Fano): to err on a share δ of the arms the records must bring H(prior) - h(δ) - δ
    ln(K - 1) nat about the hypothesis (Cover and Thomas, Elements of Information Theory, 2nd
    edition, theorem 2.10.1); with at most I nat a record that takes as many as it goes into this.
    Success: let s_k be the highest share of right verdicts that k records allow; then P(records >
    k) >= 1 - δ - s_k. Both count "unsure" as an error, and hold for any choice of records and any
    stopping rule.

    Parameters
    ----------
    error : array_like
        Share of wrong verdicts, "unsure" among them, 0 to 1.
    prior : array_like (K,)
        Probability of each hypothesis beforehand.
    information : float, optional
        Most that one record says about the hypothesis on average [nat], above 0.
    success : array_like (R,), optional
        Highest share of right verdicts after 1 to R records, never falling.

    Returns
    -------
    ndarray, as ``error``
        At least 1: the environment takes no verdict before the first record.

    Examples
    --------
    Nine hypotheses, records of at most 0.5 nat, right on 60, 80 and 85 % after 1 to 3 of them.

    >>> prior = np.full(9, 1 / 9)
    >>> least_records([0.1, 0.3], prior, information=0.5).round(2).tolist()
    [3.33, 1.93]
    >>> least_records([0.1, 0.3], prior, success=[0.6, 0.8, 0.85]).round(2).tolist()
    [1.45, 1.1]
    """
    needed = needed_information(prior, error)
    found = np.ones_like(needed)
    if information is not None:
        if not information > 0:
            raise InvalidSetting(f"the information of a record is above 0 nat, got {information!r}")
        found = np.maximum(found, needed / information)
    if success is not None:
        s = np.asarray(success, dtype=float)
        if s.ndim != 1 or not ((s >= 0) & (s <= 1)).all() or (np.diff(s) < 0).any():
            raise InvalidData(f"success after 1, 2, ... records is 0 to 1 and never falls: {s!r}")
        short = np.maximum(1.0 - np.asarray(error, dtype=float)[..., None] - s, 0.0)
        # P(records > 0) is 1: there is no verdict before the first record.
        found = np.maximum(found, 1.0 + short.sum(-1))
    return np.asarray(found)
