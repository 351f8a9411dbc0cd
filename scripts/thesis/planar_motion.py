"""Planar two-joint arm with a loose seat: kinematics, Monte Carlo draws of motion, histograms.

Angles are in radians and counter-clockwise; the tool is in the world frame. Arrays of joint
motions have shape (2, N), those of the seat (N,). The seat is at the proximal stop, free, or at the
distal stop; its displacement is measured from the middle of the gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.typing import Array

Regions = NDArray[np.int64]
PROXIMAL, FREE, DISTAL = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class LoosePlanarArm:
    """Two links in a plane; a slide sits at the proximal end of link 2."""

    length1: float = 0.40
    """Length of link 1 [m]."""
    length2: float = 0.40
    """Length of link 2 [m]."""
    beta: float = math.radians(60.0)
    """Angle of the slide from the x axis of link 2 [rad]."""


def looseness_direction(arm: LoosePlanarArm, theta: ArrayLike) -> Array:
    """Unit vector of the slide in the world (2, N), for joint angles [rad] (2, N) or (2,)."""
    return _along(np.asarray(theta, dtype=float).sum(axis=0) + arm.beta)


def tool_position(arm: LoosePlanarArm, theta: ArrayLike, d: ArrayLike) -> Array:
    """Position of the tool [m] (5.3); with the seat at zero that of the tight arm (6.1)."""
    q = np.asarray(theta, dtype=float)
    lever = np.asarray(d) * looseness_direction(arm, q) + arm.length2 * _along(q.sum(axis=0))
    return np.asarray(arm.length1 * _along(q[0]) + lever)


def tool_velocity(
    arm: LoosePlanarArm, theta: ArrayLike, theta_rate: ArrayLike, d: ArrayLike, d_rate: ArrayLike
) -> Array:
    """Velocity of the tool [m/s] (5.4); with the seat at rest and zero that of (3.71)."""
    q, rate = np.asarray(theta, dtype=float), np.asarray(theta_rate, dtype=float)
    out, along2 = looseness_direction(arm, q), _along(q.sum(axis=0))
    return np.asarray(
        rate[0] * arm.length1 * _left(_along(q[0]))
        + np.asarray(d_rate) * out
        + link_rate(rate) * (np.asarray(d) * _left(out) + arm.length2 * _left(along2))
    )


def link_rate(theta_rate: ArrayLike) -> Array:
    """Rate of turn of link 2 and of the part beyond its loose seat (5.5): a slide turns nothing."""
    return np.asarray(np.asarray(theta_rate, dtype=float).sum(axis=0))


def tool_acceleration(
    arm: LoosePlanarArm,
    theta: ArrayLike,
    theta_rate: ArrayLike,
    theta_acceleration: ArrayLike,
    d: ArrayLike,
    d_rate: ArrayLike,
    d_acceleration: ArrayLike,
) -> Array:
    """Acceleration of the tool [m/s²], with centripetal and Coriolis terms (5.6)."""
    q, rate = np.asarray(theta, dtype=float), np.asarray(theta_rate, dtype=float)
    growth = np.asarray(theta_acceleration, dtype=float)
    along1, out = _along(q[0]), looseness_direction(arm, q)
    turn, lever = link_rate(rate), np.asarray(d) * out + arm.length2 * _along(q.sum(axis=0))
    return np.asarray(
        arm.length1 * (growth[0] * _left(along1) - rate[0] ** 2 * along1)
        + link_rate(growth) * _left(lever)
        - turn**2 * lever
        + np.asarray(d_acceleration) * out
        + 2.0 * np.asarray(d_rate) * turn * _left(out)
    )


def _along(angle: ArrayLike) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)])


def _left(vector: Array) -> Array:
    """Turn vectors by a quarter, counter-clockwise."""
    return np.stack([-vector[1], vector[0]])


@dataclass(frozen=True, kw_only=True)
class SeatMotion:
    """Assumed motion of a loose seat."""

    gap: float = 2e-4
    """Travel between the stops [m]."""
    at_proximal: float = 0.25
    """Probability of contact with the proximal stop [1]."""
    at_distal: float = 0.25
    """Probability of contact with the distal stop [1]."""
    at_rest: float = 0.5
    """Probability that a seat in contact has no velocity, or no acceleration [1]."""
    timestep: float = 1e-3
    """Time in which the fastest seat crosses the gap [s]."""

    @property
    def fastest(self) -> float:
        """Velocity that crosses the gap in one time step [m/s]."""
        return self.gap / self.timestep


def draw_displacement(seat: SeatMotion, count: int, rng: np.random.Generator) -> Array:
    """Draw displacements [m] with point probabilities at the stops (figure 5.4).

    A uniform deviate wider than the gap is drawn; what falls beyond a stop is lumped there.
    """
    half = 0.5 * seat.gap
    width = seat.gap / (1.0 - seat.at_proximal - seat.at_distal)
    wide = rng.uniform(-half - seat.at_proximal * width, half + seat.at_distal * width, count)
    return np.clip(wide, -half, half)


def regions(seat: SeatMotion, d: ArrayLike) -> Regions:
    """Region of each displacement: 0 at the proximal stop, 1 free, 2 at the distal stop."""
    values, half = np.asarray(d, dtype=np.float64), 0.5 * seat.gap
    return np.where(values <= -half, PROXIMAL, np.where(values >= half, DISTAL, FREE))


def draw_seat_velocity(seat: SeatMotion, d: ArrayLike, rng: np.random.Generator) -> Array:
    """Draw a velocity for each displacement [m/s], by region (figure 5.7).

    Free, it is uniform between the two velocities that cross the gap in a time step. At a stop it
    is zero with probability `SeatMotion.at_rest`, else uniform, away from the stop (3.35, 3.36).
    """
    where = regions(seat, d)
    high = np.full(len(where), seat.fastest)
    return _by_region(seat, where, -high, high, rng)


def draw_seat_acceleration(
    seat: SeatMotion, d: ArrayLike, velocity: Array, rng: np.random.Generator
) -> Array:
    """Draw an acceleration for each displacement and velocity [m/s²], by region (5.1.5).

    The bounds are those that lead, in one time step, to the fastest velocity either way.
    """
    low = np.minimum((-seat.fastest - velocity) / seat.timestep, 0.0)
    high = np.maximum((seat.fastest - velocity) / seat.timestep, 0.0)
    return _by_region(seat, regions(seat, d), low, high, rng)


def _by_region(
    seat: SeatMotion, where: Regions, low: Array, high: Array, rng: np.random.Generator
) -> Array:
    share = rng.random(len(where))
    moves = np.maximum(share - seat.at_rest, 0.0) / (1.0 - seat.at_rest)
    away = moves * np.where(where == PROXIMAL, high, low)
    return np.where(where == FREE, low + share * (high - low), away)


@dataclass(frozen=True, kw_only=True)
class MonteCarlo:
    """A pose of the loose planar arm, Gaussian motion of its joints, assumed motion of its seat."""

    arm: LoosePlanarArm = field(default_factory=LoosePlanarArm)
    theta: tuple[float, float] = (0.0, math.pi / 2)
    """Nominal joint angles [rad]."""
    angle_sd: float = 2e-4
    """Standard deviation of each joint's angle [rad]."""
    rate_sd: float = 0.2
    """Standard deviation of each joint's rate [rad/s]."""
    acceleration_sd: float = 200.0
    """Standard deviation of each joint's acceleration [rad/s²]."""
    seat: SeatMotion | None = field(default_factory=SeatMotion)
    """Motion of the seat; None for the tight arm."""


def draw_tool_displacement(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw displacements of the tool from its nominal point [m] (2, N) (5.3, figure 5.6)."""
    theta, d, _ = _pose(setting, count, rng)
    nominal = tool_position(setting.arm, setting.theta, 0.0)
    return tool_position(setting.arm, theta, d) - nominal[:, None]


def draw_tool_velocity(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw velocities of the tool [m/s] (2, N) (5.4, figure 5.8)."""
    theta, d, v = _pose(setting, count, rng)
    return tool_velocity(setting.arm, theta, rng.normal(0.0, setting.rate_sd, theta.shape), d, v)


def draw_tool_acceleration(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw accelerations of the tool [m/s²] (2, N) (5.6)."""
    theta, d, v = _pose(setting, count, rng)
    rate = rng.normal(0.0, setting.rate_sd, theta.shape)
    growth = rng.normal(0.0, setting.acceleration_sd, theta.shape)
    seat = setting.seat
    a = np.zeros_like(d) if seat is None else draw_seat_acceleration(seat, d, v, rng)
    return tool_acceleration(setting.arm, theta, rate, growth, d, v, a)


def _pose(setting: MonteCarlo, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Joint angles (2, N), and displacement and velocity of the seat (N,)."""
    theta = np.asarray(setting.theta)[:, None] + rng.normal(0.0, setting.angle_sd, (2, count))
    if setting.seat is None:
        return theta, np.zeros(count), np.zeros(count)
    d = draw_displacement(setting.seat, count, rng)
    return theta, d, draw_seat_velocity(setting.seat, d, rng)


@dataclass(frozen=True, kw_only=True, eq=False)
class Histogram:
    """Counts of samples in bins that are as wide in every direction (4.1.1)."""

    counts: NDArray[np.float64]
    """Samples in each bin, shape (B,) * d; axis k of the array is direction k."""
    low: Array
    """Lower edge of the first bin in each direction, shape (d,), unit of the data."""
    width: float
    """Width of a bin, unit of the data."""

    def centres(self, axis: int) -> Array:
        """Centres of the bins in a direction (B,), unit of the data."""
        bins = self.counts.shape[axis]
        return np.asarray(self.low[axis] + self.width * (np.arange(bins) + 0.5))

    def points(self) -> Array:
        """Centres of all bins (d, B**d), in the order of ``counts.ravel()``."""
        axes = [self.centres(k) for k in range(self.counts.ndim)]
        return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")])


def histogram(samples: ArrayLike, bins: int = 120) -> Histogram:
    """Sort samples (N,) or (d, N) into bins; the largest range is used in all directions.

    Each direction is centred on the middle of its own range.
    """
    values = np.atleast_2d(np.asarray(samples, dtype=float))
    lowest, highest = values.min(axis=1), values.max(axis=1)
    largest = float((highest - lowest).max())
    low, width = 0.5 * (lowest + highest) - 0.5 * largest, largest / bins
    # The highest sample lies on the upper edge and belongs to the last bin.
    index = np.clip(np.floor((values - low[:, None]) / width), 0, bins - 1).astype(np.int64)
    shape = (bins,) * len(values)
    flat = np.ravel_multi_index(tuple(index), shape)
    counts = np.bincount(flat, minlength=bins ** len(values)).astype(np.float64)
    return Histogram(counts=counts.reshape(shape), low=low, width=width)


def contour_levels(found: Histogram, shares: Sequence[float] = (0.5, 0.9, 0.99)) -> Array:
    """Count down to which bins must be laid, fullest first, to hold each share of the data."""
    layers = np.sort(found.counts, axis=None)[::-1]
    laid = np.cumsum(layers)
    # A share that is met exactly must not ask for one more layer because of rounding.
    first = np.searchsorted(laid, np.asarray(shares) * laid[-1] * (1.0 - 1e-12))
    return np.asarray(layers[np.minimum(first, len(layers) - 1)])
