"""How well the tool follows the shaken joints along every direction in space."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import eigh

from loose_env.diagnosis import Prediction
from loose_env.envs.rendering.correlation_loop import record_of
from loose_env.rig import Measurement
from loose_env.statistics import Covariances, covariances
from loose_env.typing import Array

__all__ = [
    "Section",
    "Surface",
    "SurfacePair",
    "measured_surface",
    "predicted_surface",
    "surface_of",
]


_STILL = 1e-12
"""Share of the largest variance below which the tool counts as still along a direction."""
_FAINT = 0.05
"""Correlation below which a section shows no direction of its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """The surface cut by a plane through two axes of the tool frame."""

    axes: tuple[int, int]
    """Which of the measured axes span the plane."""
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
        # Close to the notch the correlation turns fast, so the angles crowd there.
        near = np.geomspace(1e-5, 0.1, 60)
        turn = np.unique(np.concatenate([np.linspace(0.0, np.pi, 361), near, np.pi - near]))
        flat = np.stack([np.cos(start + turn), np.sin(start + turn)], axis=1)
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


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePair:
    """What a record shows, and what it would show on the healthy arm."""

    measured: Surface
    healthy: Surface


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
        weights = by_joint @ vectors[:, -1]
        # The sign of a sum is free: take the one in which most of it counts upwards.
        if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0:
            weights = -weights
    return Surface(peak=weights @ cov.xa / np.sqrt(weights @ cov.xx @ weights), tool=cov.aa)


def measured_surface(measurement: Measurement) -> Surface:
    """Take the surface of a measurement."""
    return surface_of(covariances(*record_of(measurement)))


def predicted_surface(prediction: Prediction) -> Surface:
    """Take the surface that the nominal, healthy arm would show."""
    return surface_of(
        Covariances(xx=prediction.joint, xa=prediction.joint_tool, aa=prediction.tool, count=0)
    )


def _widened(tool: Array) -> Array:
    """Add what keeps a covariance invertible where the tool does not move along some axis."""
    return np.asarray(tool + _STILL * float(np.trace(tool)) * np.eye(len(tool)))
