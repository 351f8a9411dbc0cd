"""Expected information gain of a record about the hypotheses.

The belief is thinned to a few dozen simulated faults. For each of them the nominal arm says what
the record would show: how far the seat opens under that drive, friction and load, and what that
changes of the transmission, of the joints' inertias and of the motion that follows nothing. Faults
whose records lie many standard deviations apart will be told from each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.learned.features import SeatFeatures
from loose_env.diagnosis.likelihood.opening_table import OpeningTable, shipped_table
from loose_env.diagnosis.likelihood.posterior import Belief
from loose_env.diagnosis.likelihood.record_likelihood import LOOSE, OPENINGS
from loose_env.diagnosis.likelihood.seat_response import predict_seats
from loose_env.typing import Array

__all__ = [
    "USUAL_FACTORS",
    "Expectation",
    "ImaginedFaults",
    "InformationFactors",
    "InformationSettings",
    "RecordInformation",
]


_INERTIA_ERROR = 0.03
_POWER_ERROR = 0.35
_LINEAR_ERROR = 0.003


@dataclass(frozen=True, kw_only=True)
class InformationSettings:
    """Settings of the Monte Carlo estimate."""

    faults: int = 96
    """Number of simulated faults that represent the belief."""
    blur: float = 16.0
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

    def of(self, excited: NDArray[np.bool_], seconds: float) -> float:
        """Factor of a record that shakes some joints (n,) for some seconds.

        Examples
        --------
        >>> InformationFactors(joints=(0.0, 0.7)).of(np.array([False, True]), 1.0)
        2.01...
        """
        alone = 1 / len(excited)
        share = (float(np.mean(excited)) - alone) / max(1 - alone, alone)
        own = float(np.mean(np.array(self.joints)[excited])) if self.joints else 0.0
        return float(seconds**self.length * np.exp(self.together * share + own))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImaginedFaults:
    """Sample of M faults from a belief."""

    weight: Array
    """Probability of each (M,)."""
    hypothesis: NDArray[np.intp]
    """0 for healthy, else 1 + the hypothesis with a fault (M,)."""
    location: NDArray[np.intp]
    """Place of the seat; any for healthy (M,)."""
    friction: Array
    """Friction over the seat drive of the top level (M,)."""
    chance: Array
    """A uniform number each, which decides how its seat opens (M,)."""


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """Expected information gain of a record."""

    information: float
    """Expected fall of the log score [nat]."""
    sure: float
    """Expected probability of the most probable hypothesis after it [1]."""


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
    settings : InformationSettings, optional
        Settings of the simulated records.
    factors : InformationFactors, optional
        Realised share of the expected information; the usual one by default.
    table : OpeningTable, optional
        Opening table; the shipped one by default.
    """

    def __init__(
        self,
        features: SeatFeatures,
        frictions: Array,
        settings: InformationSettings | None = None,
        *,
        factors: InformationFactors | None = None,
        table: OpeningTable | None = None,
    ) -> None:
        self.features, self.frictions = features, frictions
        self.factors = USUAL_FACTORS if factors is None else factors
        self.settings = InformationSettings() if settings is None else settings
        self.table = shipped_table() if table is None else table
        shape = (-1, len(OPENINGS) * len(LOOSE))
        self._cumulative = {
            "slide": np.cumsum(self.table.slide.reshape(shape), axis=1),
            "hinge": np.cumsum(self.table.hinge.reshape(shape), axis=1),
        }

    def imagine(self, belief: Belief, rng: np.random.Generator) -> ImaginedFaults:
        """Thin a belief by systematic resampling."""
        nodes = belief.loose.shape[2]
        top = max(float(belief.healthy.max()), float(belief.loose.max()))
        healthy = np.exp(belief.healthy - top).sum()
        weight = np.concatenate([[healthy], np.exp(belief.loose - top).sum(0).ravel()])
        weight = weight / weight.sum()
        count = self.settings.faults
        ticks = (np.arange(count) + rng.random()) / count
        drawn, times = np.unique(
            np.minimum(np.searchsorted(np.cumsum(weight), ticks), len(weight) - 1),
            return_counts=True,
        )
        # A fault that is drawn often may still open in many ways.
        copies = np.repeat(drawn, np.minimum(times, 6))
        share = np.repeat(times / np.minimum(times, 6), np.minimum(times, 6)) / count
        loose = np.maximum(copies - 1, 0)
        location = np.where(copies > 0, loose // nodes, 0)
        return ImaginedFaults(
            weight=share,
            hypothesis=np.where(copies > 0, 1 + self.features.hypothesis[location], 0),
            location=location,
            friction=self.frictions[loose % nodes],
            chance=rng.random(len(copies)),
        )

    def of(
        self,
        faults: ImaginedFaults,
        pose: Array,
        torque: Array,
        duration: float,
        planned: Array | None = None,
    ) -> Expectation:
        """Expected information gain of a record.

        Parameters
        ----------
        faults : ImaginedFaults
            The belief, thinned.
        pose : ndarray (n,)
            Pose of the record [rad or m].
        torque : ndarray (n,)
            Rms torque of every joint [N·m]; at least one is on.
        duration : float
            Its length [s].
        planned : ndarray (M, M), optional
            Likelihood of records before it whose outcome is not known: the product of those of
            `likelihood`.
        """
        before = faults.weight if planned is None else faults.weight * planned
        likely = self.likelihood(faults, pose, torque, duration)
        score_now, _ = self._expected(faults, np.atleast_2d(before))
        score, sure = self._expected(faults, before * likely)
        factor = self.factors.of(torque > 0, duration)
        return Expectation(information=factor * (score - score_now), sure=sure)

    def _expected(self, faults: ImaginedFaults, near: Array) -> tuple[float, float]:
        """Log score [nat] and largest probability of weights after each fault's records (M, M).

        One row where they are the same after all of them.
        """
        labels = np.zeros((len(faults.weight), int(faults.hypothesis.max()) + 1))
        labels[np.arange(len(labels)), faults.hypothesis] = 1.0
        after = near @ labels
        after /= after.sum(1, keepdims=True)
        row = np.arange(len(near)) if len(near) > 1 else 0
        kept = np.log(np.maximum(after[row, faults.hypothesis], 1e-12))
        most = np.broadcast_to(after.max(1), len(labels))
        return float(faults.weight @ kept), float(faults.weight @ most)

    def likelihood(
        self, faults: ImaginedFaults, pose: Array, torque: Array, duration: float
    ) -> Array:
        """Likelihood of each simulated fault's record under each other fault (M, M).

        Row k is for a record of fault k; 1 where the other one would show the same.
        """
        shown = self.outcomes(faults, pose, torque, duration)
        square = (shown**2).sum(1)
        apart = square[:, None] + square[None] - 2 * shown @ shown.T
        # Two records of one fault differ too: each has its own errors.
        return np.asarray(np.exp(-np.maximum(apart, 0.0) / (4 * self.settings.blur)))

    def outcomes(
        self, faults: ImaginedFaults, pose: Array, torque: Array, duration: float
    ) -> Array:
        """Features of each simulated fault, in standard deviations (M, features)."""
        features = self.features
        linear, floor = features.linear, features.floor
        arm = linear.arm
        excited = torque > 0
        on = np.flatnonzero(excited)
        m, d = len(on), len(arm.axes)
        noise = np.concatenate([floor.joints(arm)[on], np.full(d, floor.tool)]) ** 2
        asked, at = np.unique(faults.location, return_inverse=True)
        seats = predict_seats(linear.at(pose), torque, features.directions, noise, locations=asked)
        x = seats.in_step[:m]
        b = seats.in_step[m:] @ np.linalg.inv(x)
        away = np.concatenate([-b, np.eye(d)], axis=1)
        total = float(np.trace(seats.in_step[m:] @ seats.in_step[m:].T))
        residual = away @ seats.rest @ away.T + _LINEAR_ERROR**2 * total * np.eye(d)
        white = features.whitening(pose, excited, b, residual, x, duration)
        samples = 2 * (arm.band[1] - arm.band[0]) * duration

        opening, loose = self._openings(faults, seats.force[at], seats.load[at])
        change = opening[:, None] * (features.open_change(seats)[at] @ white.T)
        nominal = np.diag(x)
        opened = np.diagonal(seats.in_step_open[:, :m], axis1=1, axis2=2)[at] / nominal
        error = np.sqrt(_INERTIA_ERROR**2 + 1 / samples)
        inertia = np.clip(opening[:, None] * opened / error, -10.0, 10.0)
        free = np.diagonal(away @ seats.loose[at] @ away.T, axis1=1, axis2=2)
        rest = np.diag(residual)
        error = np.sqrt(_POWER_ERROR**2 + 2 / samples)
        motion = np.log1p(loose[:, None] * np.maximum(free, 0.0) / rest) / error
        return np.concatenate([np.clip(change, -60.0, 60.0), inertia, motion], axis=1)

    def _openings(self, faults: ImaginedFaults, force: Array, load: Array) -> tuple[Array, Array]:
        """Opening and loose motion of every simulated fault's seat (M,) each.

        Force and gravity's load are those on the shut seats (M,) [N or N·m].
        """
        at = faults.location
        slides = self.features.locations - self.features.linear.arm.n
        friction = faults.friction * self.features.top[at]
        nodes = self.table.nodes(force, friction, load)
        pick = np.zeros(len(at), dtype=np.intp)
        for kind, chosen in (("slide", at < slides), ("hinge", at >= slides)):
            mixed = sum(weight[:, None] * self._cumulative[kind][node] for node, weight in nodes)
            cell = (np.asarray(mixed) < faults.chance[:, None]).sum(1)
            pick = np.where(chosen, cell, pick)
        pick = np.minimum(pick, len(OPENINGS) * len(LOOSE) - 1)
        loose = np.where(faults.hypothesis > 0, LOOSE[pick % len(LOOSE)], 0.0)
        opening = np.where(faults.hypothesis > 0, OPENINGS[pick // len(LOOSE)], 0.0)
        return opening, loose
