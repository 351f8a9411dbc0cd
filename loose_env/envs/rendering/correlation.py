"""Correlation of the tool with the shaken joints, by direction: in the plane and in space."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import eigh

from loose_env.diagnosis import Prediction
from loose_env.rig import Measurement
from loose_env.statistics import (
    Covariances,
    acceleration_from_angle,
    axial_angle,
    bandpass,
    correlation_loop_from,
    covariances,
    lowest_coherence_direction_from,
)
from loose_env.typing import Array

__all__ = [
    "Loop",
    "Pair",
    "Section",
    "Surface",
    "loop_of",
    "measured_loop",
    "measured_surface",
    "predicted_loop",
    "predicted_surface",
    "surface_of",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The correlation loop of one record, in the plane of the tool."""

    points: Array
    """r(phi) along every direction phi of the tool frame [1] (K, 2)."""
    lowest: Array
    """Direction of lowest correlation, tool frame, unit vector (2,)."""
    maximum: float
    """Highest correlation over directions [1]."""
    peak: Array
    """Covariance with the excitation: the side to which the loop lies (2,)."""

    def facing(self, other: Loop) -> Loop:
        """Turn the loop to the same side as another one."""
        if self.peak @ other.peak >= 0:
            return self
        return Loop(points=-self.points, lowest=self.lowest, maximum=self.maximum, peak=-self.peak)


def loop_of(cov: Covariances) -> Loop:
    """Trace the loop of a record with one or several shaken joints.

    Of several joints, the sum that correlates highest with the tool counts: the first
    canonical variate. It is uncorrelated with the tool along the direction of lowest
    coherence, so the loop has its notch there.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> loop = loop_of(covariances(x, a))
    >>> loop.lowest.tolist(), loop.maximum
    ([0.0, 1.0], 1.0)
    """
    lowest = lowest_coherence_direction_from(cov)
    # The canonical directions of the tool are perpendicular under its covariance.
    across = cov.aa @ lowest.direction
    weights = np.linalg.solve(cov.xx, cov.xa @ np.array([across[1], -across[0]]))
    weights = _upward(weights, cov)
    one = Covariances(
        xx=np.array([[weights @ cov.xx @ weights]]),
        xa=(weights @ cov.xa)[None],
        aa=cov.aa,
        count=cov.count,
    )
    angles = axial_angle(lowest.direction) + _half_turn()
    radius = correlation_loop_from(one, angles)
    return Loop(
        points=radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1),
        lowest=lowest.direction,
        maximum=float(np.sqrt(lowest.coherences.max())),
        peak=one.xa[0],
    )


def _half_turn() -> Array:
    """Angles from 0 to pi, dense near both ends, where the correlation passes zero [rad]."""
    near = np.geomspace(1e-5, 0.1, 60)
    return np.unique(np.concatenate([np.linspace(0.0, np.pi, 361), near, np.pi - near]))


def _upward(weights: Array, cov: Covariances) -> Array:
    """Sign of a weighted sum of joints in which most of its power counts as positive."""
    return -weights if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0 else weights


def _measured(measurement: Measurement) -> Covariances:
    """Covariances of the shaken joints' accelerations and the tool's, in the band."""
    on = np.flatnonzero(measurement.excited)
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    return covariances(joint, bandpass(measurement.tool, rate, band))


def _predicted(prediction: Prediction) -> Covariances:
    return Covariances(xx=prediction.joint, xa=prediction.joint_tool, aa=prediction.tool, count=0)


def measured_loop(measurement: Measurement) -> Loop:
    """Trace the loop of a measurement in the plane."""
    return loop_of(_measured(measurement))


def predicted_loop(prediction: Prediction) -> Loop:
    """Trace the loop that the nominal, healthy arm would show."""
    return loop_of(_predicted(prediction))


_STILL = 1e-12
"""Share of the largest variance below which the tool counts as still along a direction."""
_FAINT = 0.05
"""Correlation below which a section shows no direction of its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """The surface cut by a plane through two axes of the tool frame."""

    axes: tuple[int, int]
    """Measured axes that span the plane."""
    points: Array
    """r(u) u for directions u in the plane [1] (K, 2)."""
    lowest: Array | None
    """Direction in the plane without correlation, unit vector (2,); None where the whole
    section is all but zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Correlation along u, r(u) = u.c / (sigma_x sqrt(u.S u)), over all directions."""

    peak: Array
    """c / sigma_x: covariance of the tool with the excitation of unit power [m/s²] (d,)."""
    tool: Array
    """S: covariance of the tool acceleration [m²/s⁴] (d, d)."""

    @property
    def maximum(self) -> float:
        """Highest correlation over directions [1]."""
        best = np.linalg.solve(_widened(self.tool), self.peak)
        return float(np.sqrt(np.clip(self.peak @ best, 0.0, 1.0)))

    def along(self, directions: Array) -> Array:
        """Correlation along directions (K, d) of any length [1] (K,); zero where all is still."""
        power = np.einsum("ki,ij,kj->k", directions, self.tool, directions)
        length = np.einsum("ki,ki->k", directions, directions)
        moving = power > _STILL * float(np.trace(self.tool)) * length
        spread = np.sqrt(np.where(moving, power, 1.0))
        return np.where(moving, directions @ self.peak / spread, 0.0)

    def section(self, first: int, second: int) -> Section:
        """Cut the surface by the plane of two measured axes."""
        across = np.array([-self.peak[second], self.peak[first]])
        start = float(np.arctan2(across[1], across[0])) if across.any() else 0.0
        angles = start + _half_turn()
        flat = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        directions = np.zeros((len(flat), len(self.peak)))
        directions[:, [first, second]] = flat
        radius = self.along(directions)
        clear = np.abs(radius).max() > _FAINT
        return Section(
            axes=(first, second), points=radius[:, None] * flat, lowest=flat[0] if clear else None
        )

    @property
    def sections(self) -> tuple[Section, ...]:
        """The cuts by all planes of two measured axes: x-y, x-z, y-z of three."""
        return tuple(self.section(i, j) for i, j in combinations(range(len(self.peak)), 2))

    def facing(self, other: Surface) -> Surface:
        """Turn the surface to the same side as another one."""
        if self.peak @ other.peak >= 0:
            return self
        return Surface(peak=-self.peak, tool=self.tool)


Shape = TypeVar("Shape", Loop, Surface)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair(Generic[Shape]):
    """Correlation that a record shows, and that the nominal healthy arm would show."""

    measured: Shape
    healthy: Shape


def surface_of(cov: Covariances) -> Surface:
    """Take the surface of a record with one or several shaken joints.

    Of several joints, the sum that correlates highest with the tool counts: the first canonical
    variate. Three axes and one sum leave a plane without correlation; it shows as a line in
    every section.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [0.0, 0.0, 0.0, 0.0]]
    >>> surface = surface_of(covariances(x, a))
    >>> surface.along(np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])).round(
    ...     3
    ... ).tolist()
    [1.0, 0.707, 0.0]
    """
    weights = np.ones(1)
    if len(cov.xx) > 1:
        by_joint = np.linalg.solve(cov.xx, cov.xa)
        _, vectors = eigh(cov.xa.T @ by_joint, _widened(cov.aa))
        weights = _upward(by_joint @ vectors[:, -1], cov)
    return Surface(peak=weights @ cov.xa / np.sqrt(weights @ cov.xx @ weights), tool=cov.aa)


def measured_surface(measurement: Measurement) -> Surface:
    """Take the surface of a measurement."""
    return surface_of(_measured(measurement))


def predicted_surface(prediction: Prediction) -> Surface:
    """Take the surface that the nominal, healthy arm would show."""
    return surface_of(_predicted(prediction))


def _widened(tool: Array) -> Array:
    """Add what keeps a covariance invertible where the tool does not move along some axis."""
    return np.asarray(tool + _STILL * float(np.trace(tool)) * np.eye(len(tool)))
