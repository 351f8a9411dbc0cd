"""Posterior over faults, given all records so far.

Nuisances are carried on a grid: the direction of the slide, the friction of the guide, and the
stiffness of the arm's bending modes, if it has any. The opening of the seat differs from
record to record; it is summed out with the probabilities that its drive, friction and load give.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.likelihood.opening_table import OpeningTable, shipped_table
from loose_env.diagnosis.likelihood.record_likelihood import SHUT, Fit, fit_record
from loose_env.diagnosis.records.prediction import SensorFloor
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatDrive, SeatReference
from loose_env.faults import DEFAULT_KINDS, hypotheses, places_of_kind
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid
from loose_env.typing import Array

__all__ = ["Belief", "FaultPosterior", "PosteriorSettings", "slide_directions", "variants"]


@dataclass(frozen=True, kw_only=True)
class PosteriorSettings:
    """Prior over faults and grid of the posterior."""

    friction: tuple[float, float] = (0.02, 1.0)
    """Range of guide friction over the seat drive of the top level, log-uniform [1]."""
    friction_over: SeatReference = "median"
    """Pose whose seat drive friction is compared to."""
    frictions: int = 8
    """Nodes of friction."""
    directions: int = 18
    """Sliding directions tried over half a turn, for an arm that moves in a plane."""
    space_directions: int = 200
    """Sliding directions tried over the half sphere, for an arm in space."""
    mismatch: Mismatch = field(default_factory=Mismatch)
    """Standard deviations of the nominal model's errors."""
    kinds: Mapping[str, float] = field(
        default_factory=lambda: {"healthy": 1 / 3, "structural_looseness": 1 / 3, "backlash": 1 / 3}
    )
    """Prior probability of each kind of fault."""
    temper: float = 0.8
    """Exponent on each record's likelihood: records of one arm share their mismatch."""

    def __post_init__(self) -> None:
        if not 0 < self.friction[0] <= self.friction[1] < np.inf:
            raise InvalidSetting(f"friction must be 0 < low <= high, got {self.friction}")
        if self.frictions < 1 or self.directions < 2 or self.space_directions < 3:
            raise InvalidSetting(
                "at least one friction, two directions in the plane and three in space are "
                f"needed, got {self.frictions}, {self.directions} and {self.space_directions}"
            )
        beyond = [k for k, share in self.kinds.items() if k not in DEFAULT_KINDS and share > 0]
        if beyond:
            raise InvalidSetting(
                f"the posterior has no model of {beyond}, only of {list(DEFAULT_KINDS)}: keep to "
                "these kinds, or use an agent that works without it"
            )
        if not 0 < self.temper <= 1:
            raise InvalidSetting(f"temper must be above 0 and at most 1, got {self.temper}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Log-weights of all hypotheses and their parameters."""

    healthy: Array
    """Of the healthy arm, by variant of the arm (V,)."""
    loose: Array
    """Of each location and friction, by variant (V, P, F)."""
    links: int
    """Number of links."""
    directions: Array
    """Sliding directions of a link in its frame, unit vectors (A, axes)."""

    @property
    def probabilities(self) -> Array:
        """Probability of each of the posterior's hypotheses, in their order."""
        slides = self.loose.shape[1] - self.links
        by_place = logsumexp(self.loose, axis=(0, 2))
        by_link = logsumexp(by_place[:slides].reshape(self.links, -1), axis=1)
        log = np.concatenate([[logsumexp(self.healthy)], by_link, by_place[slides:]])
        return np.asarray(np.exp(log - logsumexp(log)))

    def by_direction(self, link: int) -> Array:
        """Probability of each sliding direction, if that link is loose (A,)."""
        slides = self.loose.shape[1] - self.links
        log = logsumexp(self.loose, axis=(0, 2))[:slides].reshape(self.links, -1)[link - 1]
        return np.asarray(np.exp(log - logsumexp(log)))

    def direction(self, link: int) -> float:
        """Most probable sliding direction of a link in its plane [rad], axial.

        Raises
        ------
        InvalidSetting
            If the arm does not move in a plane: an angle cannot say the direction.
        """
        if self.directions.shape[1] != 2:
            raise InvalidSetting("the arm moves in space: ask for axis(link), a unit vector")
        x, y = self.directions[np.argmax(self.by_direction(link))]
        return float(np.arctan2(y, x))

    def axis(self, link: int) -> Array:
        """Mean sliding direction of a link in its frame, a unit vector without sign (3,).

        Directions count by their probability if that link is loose; the mean is the leading
        eigenvector of the sum of their outer products.
        """
        u = self.directions
        mean = np.linalg.eigh(np.einsum("a,ai,aj->ij", self.by_direction(link), u, u))[1][:, -1]
        return np.concatenate([mean, np.zeros(3 - len(mean))])


class FaultPosterior:
    """Bayes' rule over faults, with the nominal arm as the only model.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm, in a plane or in space.
    sensors : SensorSuite
        Figures of the sensors.
    settings : PosteriorSettings, optional
        Ranges and priors.
    table : OpeningTable, optional
        Opening table; the shipped one by default.

    Raises
    ------
    InvalidSetting
        If the tool is read along one axis only.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> posterior = FaultPosterior(LinearArm(planar(2)), SensorSuite())
    >>> posterior.start().probabilities.round(3).tolist()
    [0.333, 0.167, 0.167, 0.167, 0.167]
    """

    def __init__(
        self,
        linear: LinearArm,
        sensors: SensorSuite,
        settings: PosteriorSettings | None = None,
        *,
        table: OpeningTable | None = None,
    ) -> None:
        self.settings = PosteriorSettings() if settings is None else settings
        arm = linear.arm
        axes = linear.slide_dofs.shape[1]
        if axes not in (2, 3):
            raise InvalidSetting(
                f"arm {arm.name!r} reads {axes} axis at its tool; the posterior needs 2, for "
                "an arm that moves in a plane, or 3"
            )
        self.linear, self.hypotheses = linear, hypotheses(arm, DEFAULT_KINDS, everywhere=True)
        self.table = shipped_table() if table is None else table
        self.floor = SensorFloor.of(sensors, arm.band)
        count = self.settings.directions if axes == 2 else self.settings.space_directions
        self.directions = slide_directions(count, axes)
        self.variants, self._weights = variants(linear, self.settings.mismatch.stiffness)
        drive = SeatDrive(linear, over=self.settings.friction_over)
        locations = [
            drive.slide(link, tuple(u)) for link in range(1, arm.n + 1) for u in self.directions
        ]
        locations += [drive.hinge(joint) for joint in range(1, arm.n + 1)]
        # Some motions of a seat no joint drives, such as those across a plane of motion.
        driven = np.maximum(locations, 1e-9 * max(locations))
        low, high = np.log(self.settings.friction)
        middle = (np.arange(self.settings.frictions) + 0.5) / self.settings.frictions
        self.frictions = np.exp(low + (high - low) * middle)
        """Nodes of friction over the seat drive of the top level [1] (F,)."""
        self._friction = driven[:, None] * self.frictions  # (P, F)

    def start(self) -> Belief:
        """Return the prior."""
        n, kinds = self.linear.arm.n, self.settings.kinds
        slides = n * len(self.directions)
        nodes = self.settings.frictions

        def log(p: float) -> float:
            return float(np.log(p)) if p > 0 else -np.inf

        loose = np.empty((len(self.variants), slides + n, nodes))
        loose[:, :slides] = log(kinds.get("structural_looseness", 0.0)) - np.log(slides * nodes)
        felt = np.isin(np.arange(1, n + 1), places_of_kind(self.linear.arm, "backlash"))
        loose[:, slides:] = log(kinds.get("backlash", 0.0)) - np.log(max(felt.sum(), 1) * nodes)
        loose[:, slides:][:, ~felt] = -np.inf
        return Belief(
            healthy=log(kinds.get("healthy", 0.0)) + self._weights,
            loose=loose + self._weights[:, None, None],
            links=n,
            directions=self.directions,
        )

    def update(self, belief: Belief, record: RecordStatistics) -> Belief:
        """Take in one record; the order of records does not matter."""
        fits = [
            fit_record(arm, record, self.directions, self.floor, self.settings.mismatch)
            for arm in self.variants
        ]
        temper = self.settings.temper
        healthy = np.array([fit.log[0, SHUT, 0] for fit in fits])
        loose = np.stack([self._summed(fit) for fit in fits])
        return Belief(
            healthy=belief.healthy + temper * healthy,
            loose=belief.loose + temper * loose,
            links=belief.links,
            directions=belief.directions,
        )

    def _summed(self, fit: Fit) -> Array:
        """Sum a record's likelihood over openings and loose motion (P, F)."""
        slides = self.linear.arm.n * len(self.directions)
        top = fit.log.max()
        likelihood = np.exp(fit.log - top).reshape(len(fit.log), -1)
        nodes = self.table.nodes(fit.force[:, None], self._friction, fit.load[:, None])
        mixed = np.zeros(self._friction.shape)
        for table, locations in (
            (self.table.slide, slice(0, slides)),
            (self.table.hinge, slice(slides, None)),
        ):
            by_node = likelihood[locations] @ table.reshape(-1, likelihood.shape[1]).T
            for node, weight in nodes:
                mixed[locations] += weight[locations] * np.take_along_axis(
                    by_node, node[locations], 1
                )
        return np.asarray(np.log(np.maximum(mixed, 1e-300)) + top)


def slide_directions(count: int, axes: int = 2) -> Array:
    """Even grid of directions without sign: over half a turn, or over the half sphere.

    Parameters
    ----------
    count : int
        Number of directions.
    axes : int
        2 for the plane; 3 for space, where the directions are a Fibonacci lattice.

    Returns
    -------
    ndarray (count, axes)
        Unit vectors.

    Examples
    --------
    >>> slide_directions(4).round(2).tolist()
    [[1.0, 0.0], [0.71, 0.71], [0.0, 1.0], [-0.71, 0.71]]
    >>> slide_directions(96, 3).shape
    (96, 3)
    """
    return axes_grid(count, axes)


def variants(linear: LinearArm, stiffness: float) -> tuple[list[LinearArm], Array]:
    """Arms whose bending modes are softer and stiffer than nominal, with their log-weights.

    An arm without bending modes has one variant: itself.
    """
    if not len(linear.flexible_dofs) or stiffness == 0:
        return [linear], np.zeros(1)
    offsets = np.linspace(-1.8, 1.8, 6)
    arms = []
    for offset in offsets:
        spec = linear.arm.spec.copy()
        for joint in spec.joints:
            if joint.name not in linear.arm.joints:
                joint.stiffness = joint.stiffness * np.exp(stiffness * offset)
        arms.append(LinearArm(dataclasses.replace(linear.arm, spec=spec), points=120, remember=16))
    log = -0.5 * offsets**2
    return arms, np.asarray(log - logsumexp(log))
