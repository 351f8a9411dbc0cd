"""The posterior over faults: what all records so far say about each hypothesis.

Nuisances are carried on a grid: the direction of the slide, the friction of the guide, and the
stiffness of the arm's bending modes, if it has any. The opening of the seat differs from
record to record; it is summed out with the probabilities that its drive and friction give.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_env.arms.linear import LinearArm
from loose_env.arms.mismatch import Mismatch
from loose_env.diagnosis.likelihood import SHUT, Fit, fit_record
from loose_env.diagnosis.opening import OpeningTable, shipped_table
from loose_env.diagnosis.prediction import SensorFloor
from loose_env.diagnosis.record import RecordStatistics
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatDrive
from loose_env.faults import hypotheses
from loose_env.sensors import SensorSuite

__all__ = ["Belief", "FaultPosterior", "PosteriorSettings", "slide_directions", "variants"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PosteriorSettings:
    """What is taken for granted about the hidden faults."""

    friction: tuple[float, float] = (0.02, 1.0)
    """Range of guide friction over the seat drive of the top level, log-uniform [1]."""
    frictions: int = 8
    """Nodes of friction."""
    directions: int = 18
    """Sliding directions tried over half a turn."""
    mismatch: Mismatch = field(default_factory=Mismatch)
    """How far the nominal model may be off."""
    kinds: Mapping[str, float] = field(
        default_factory=lambda: {"healthy": 1 / 3, "structural_looseness": 1 / 3, "backlash": 1 / 3}
    )
    """Prior probability of each kind of fault."""
    temper: float = 0.8
    """Exponent on each record's likelihood: records of one arm share their mismatch."""

    def __post_init__(self) -> None:
        if not 0 < self.friction[0] <= self.friction[1] < np.inf:
            raise InvalidSetting(f"friction must be 0 < low <= high, got {self.friction}")
        if self.frictions < 1 or self.directions < 2:
            raise InvalidSetting(
                "at least one friction and two directions are needed, got "
                f"{self.frictions} and {self.directions}"
            )
        if not 0 < self.temper <= 1:
            raise InvalidSetting(f"temper must be above 0 and at most 1, got {self.temper}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Log-weights of everything that is in question."""

    healthy: Array
    """Of the healthy arm, by variant of the arm (V,)."""
    loose: Array
    """Of each place and friction, by variant (V, P, F)."""
    links: int
    """Number of links."""

    @property
    def probabilities(self) -> Array:
        """Probability of each hypothesis, in the order of `loose_env.faults.hypotheses`."""
        slides = self.loose.shape[1] - self.links
        by_place = logsumexp(self.loose, axis=(0, 2))
        by_link = logsumexp(by_place[:slides].reshape(self.links, -1), axis=1)
        log = np.concatenate([[logsumexp(self.healthy)], by_link, by_place[slides:]])
        return np.asarray(np.exp(log - logsumexp(log)))

    def direction(self, link: int) -> float:
        """Most probable sliding direction of a link in its frame [rad], axial."""
        slides = self.loose.shape[1] - self.links
        by_place = logsumexp(self.loose, axis=(0, 2))[:slides].reshape(self.links, -1)
        return float(np.pi * np.argmax(by_place[link - 1]) / by_place.shape[1])


class FaultPosterior:
    """Bayes' rule over faults, with the nominal arm as the only model.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm; it must move in a plane.
    sensors : SensorSuite
        Figures of the sensors.
    settings : PosteriorSettings, optional
        Ranges and priors.
    table : OpeningTable, optional
        How seats open; the shipped one by default.

    Raises
    ------
    InvalidSetting
        If the arm does not move in a plane.

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
        if len(arm.axes) != 2:
            raise InvalidSetting(f"arm {arm.name!r} does not move in a plane")
        self.linear, self.hypotheses = linear, hypotheses(arm)
        self.table = shipped_table() if table is None else table
        self.floor = SensorFloor.of(sensors, arm.band)
        self.directions = slide_directions(self.settings.directions)
        self.variants, self._weights = variants(linear, self.settings.mismatch.stiffness)
        drive = SeatDrive(linear)
        places = [
            drive.slide(link, (*u, 0.0)) for link in range(1, arm.n + 1) for u in self.directions
        ]
        places += [drive.hinge(joint) for joint in range(1, arm.n + 1)]
        low, high = np.log(self.settings.friction)
        middle = (np.arange(self.settings.frictions) + 0.5) / self.settings.frictions
        self._friction = np.array(places)[:, None] * np.exp(low + (high - low) * middle)  # (P, F)

    def start(self) -> Belief:
        """Return the prior."""
        n, kinds = self.linear.arm.n, self.settings.kinds
        slides = n * len(self.directions)
        nodes = self.settings.frictions

        def log(p: float) -> float:
            return float(np.log(p)) if p > 0 else -np.inf

        loose = np.empty((len(self.variants), slides + n, nodes))
        loose[:, :slides] = log(kinds.get("structural_looseness", 0.0)) - np.log(slides * nodes)
        loose[:, slides:] = log(kinds.get("backlash", 0.0)) - np.log(n * nodes)
        return Belief(
            healthy=log(kinds.get("healthy", 0.0)) + self._weights,
            loose=loose + self._weights[:, None, None],
            links=n,
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
        )

    def _summed(self, fit: Fit) -> Array:
        """Sum a record's likelihood over openings and loose motion (P, F)."""
        slides = self.linear.arm.n * len(self.directions)
        top = fit.log.max()
        likelihood = np.exp(fit.log - top).reshape(len(fit.log), -1)
        result = np.empty(self._friction.shape)
        lower, share = self.table.nodes(fit.force[:, None] / self._friction)
        for table, places in (
            (self.table.slide, slice(0, slides)),
            (self.table.hinge, slice(slides, None)),
        ):
            by_node = likelihood[places] @ table.reshape(len(table), -1).T
            at = np.arange(len(by_node))[:, None]
            below, above = by_node[at, lower[places]], by_node[at, lower[places] + 1]
            mixed = (1 - share[places]) * below + share[places] * above
            result[places] = np.log(np.maximum(mixed, 1e-300)) + top
        return result


def slide_directions(count: int) -> Array:
    """Unit vectors over half a turn in the plane of a link (count, 2)."""
    angle = np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


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
