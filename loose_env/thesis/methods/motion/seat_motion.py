"""Assumed motion of a loose seat between its stops, and how it passes from region to region.

The seat is in one of three regions: at the proximal stop, free between the stops, or at the
distal stop (thesis 5.1). Its displacement is measured from the middle of the gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.thesis.methods.motion.loose_planar_arm import (
    LoosePlanarArm,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from loose_env.typing import Array

Regions = NDArray[np.int64]
PROXIMAL, FREE, DISTAL = 0, 1, 2


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
    """Draw displacements of the seat with point probabilities at the stops (figure 5.4).

    A uniform deviate wider than the gap is drawn; what falls beyond a stop is lumped there.

    ``seat``: gap [m] and probabilities of contact. Returns (N,): displacement from the middle of
    the gap, m, exactly a half gap at the stops.

    Examples
    --------
    >>> d = draw_displacement(SeatMotion(gap=2.0), 4000, np.random.default_rng(1))
    >>> bool(abs(np.mean(d == 1.0) - 0.25) < 0.03), float(d.max())
    (True, 1.0)
    """
    half = 0.5 * seat.gap
    width = seat.gap / (1.0 - seat.at_proximal - seat.at_distal)
    wide = rng.uniform(-half - seat.at_proximal * width, half + seat.at_distal * width, count)
    return np.clip(wide, -half, half)


def regions(seat: SeatMotion, d: ArrayLike) -> Regions:
    """Region of each displacement: 0 at the proximal stop, 1 free, 2 at the distal stop.

    ``seat``: the gap [m]. ``d`` (N,): displacement, m. Returns (N,): regions.

    Examples
    --------
    >>> regions(SeatMotion(gap=2.0), [-1.0, 0.3, 1.0]).tolist()
    [0, 1, 2]
    """
    values = np.asarray(d, dtype=np.float64)
    half = 0.5 * seat.gap
    return np.where(values <= -half, PROXIMAL, np.where(values >= half, DISTAL, FREE))


def draw_seat_velocity(seat: SeatMotion, d: ArrayLike, rng: np.random.Generator) -> Array:
    """Draw a velocity for each displacement, by region (figure 5.7).

    Free, it is uniform between the two velocities that cross the gap in a time step. At a stop
    it is zero with probability `SeatMotion.at_rest`, else uniform and away from the stop (3.35,
    3.36).

    ``seat``: gap [m], time step [s] and probability of rest. ``d`` (N,): displacement, m. Returns
    (N,): velocity, m/s, positive towards the distal stop.

    Examples
    --------
    >>> seat = SeatMotion(gap=1.0, timestep=1.0, at_rest=0.0)
    >>> v = draw_seat_velocity(seat, [-0.5, 0.5], np.random.default_rng(1))
    >>> np.sign(v).tolist()
    [1.0, -1.0]
    """
    where = regions(seat, d)
    high = np.full(len(where), seat.fastest)
    return _by_region(seat, where, -high, high, rng)


def draw_seat_acceleration(
    seat: SeatMotion, d: ArrayLike, velocity: ArrayLike, rng: np.random.Generator
) -> Array:
    """Draw an acceleration for each displacement and velocity, by region (5.1.5).

    The bounds are the accelerations that lead, in one time step, to the fastest velocity either
    way. With a velocity of zero the distribution has the shape of the velocity's.

    ``seat``: gap [m], time step [s] and probability of rest. ``d``, ``velocity`` (N,): displacement
    [m] and velocity [m/s]. Returns (N,): acceleration, m/s^2.

    Examples
    --------
    >>> seat = SeatMotion(gap=1.0, timestep=1.0, at_rest=0.0)
    >>> a = draw_seat_acceleration(seat, [0.0], [1.0], np.random.default_rng(1))
    >>> bool(-2.0 <= a[0] <= 0.0)
    True
    """
    where = regions(seat, d)
    v = np.asarray(velocity, dtype=np.float64)
    low = np.minimum((-seat.fastest - v) / seat.timestep, 0.0)
    high = np.maximum((seat.fastest - v) / seat.timestep, 0.0)
    return _by_region(seat, where, low, high, rng)


def _by_region(
    seat: SeatMotion, where: Regions, low: Array, high: Array, rng: np.random.Generator
) -> Array:
    share = rng.random(len(where))
    moves = np.maximum(share - seat.at_rest, 0.0) / (1.0 - seat.at_rest)
    return np.where(
        where == FREE, low + share * (high - low), moves * np.where(where == PROXIMAL, high, low)
    )


def displacement_chain(seat: SeatMotion, count: int, rng: np.random.Generator) -> Array:
    """Integrate drawn velocities to a sequence of displacements that stops at the stops.

    The first displacement is drawn by `draw_displacement`; each next one is the last plus the
    velocity of its region times the time step, lumped at a stop that it would cross. With
    probability r of rest, each stop holds the seat for the share 1 / (6 - 4 r) of the time,
    which is 1/4 for r = 1/2, and free displacements are uniform: the assumed velocities and the
    assumed displacements agree.

    ``seat``: gap [m] and probability of rest. Returns (N,): displacement, m.

    Examples
    --------
    >>> seat = SeatMotion()
    >>> d = displacement_chain(seat, 20_000, np.random.default_rng(1))
    >>> bool(abs(np.mean(regions(seat, d) == FREE) - 0.5) < 0.02)
    True
    """
    half, rest = 0.5 * seat.gap, seat.at_rest
    chain = np.empty(count)
    d = chain[0] = float(draw_displacement(seat, 1, rng)[0])
    for k, share in enumerate(rng.random(count - 1).tolist(), start=1):
        if -half < d < half:
            d += (2.0 * share - 1.0) * seat.gap
        elif share > rest:
            d -= math.copysign(seat.gap * (share - rest) / (1.0 - rest), d)
        d = min(max(d, -half), half)
        chain[k] = d
    return chain


def transition_table(sequence: ArrayLike) -> Array:
    """Estimate the joint probabilities of the region now and the region before (table 5.1).

    ``sequence`` (N,): regions in order of time, 0, 1 or 2. Returns (3, 3): row: region now; column:
    region before. The sum is 1 (5.2).

    Examples
    --------
    >>> transition_table([0, 1, 1, 2, 1]).tolist()
    [[0.0, 0.0, 0.0], [0.25, 0.25, 0.25], [0.0, 0.25, 0.0]]
    """
    where = np.asarray(sequence)
    pairs = 3 * where[1:].astype(np.int64) + where[:-1].astype(np.int64)
    return np.bincount(pairs, minlength=9).reshape(3, 3) / len(pairs)


def region_probabilities(table: ArrayLike) -> Array:
    """Probability of each region now: the row sums of the transition table (5.1, 5.2).

    ``table`` (3, 3): joint probabilities, as `transition_table` returns them. Returns (3,):
    probabilities at the proximal stop, free and at the distal stop.

    Examples
    --------
    >>> region_probabilities([[0.125, 0.125, 0], [0.125, 0.25, 0.125], [0, 0.125, 0.125]]).tolist()
    [0.25, 0.5, 0.25]
    """
    return np.asarray(np.sum(table, axis=1))


@dataclass(frozen=True, kw_only=True)
class MonteCarlo:
    """A pose of the loose planar arm, Gaussian motion of its joints, assumed motion of its seat."""

    arm: LoosePlanarArm = field(default_factory=LoosePlanarArm)
    """Lengths and the slide's angle."""
    theta: tuple[float, float] = (0.0, math.pi / 2)
    """Nominal joint angles [rad]."""
    angle_sd: float = 2e-4
    """Standard deviation of each joint's angle [rad]."""
    rate_sd: float = 0.2
    """Standard deviation of each joint's rate [rad/s]."""
    acceleration_sd: float = 200.0
    """Standard deviation of each joint's acceleration [rad/s^2]."""
    seat: SeatMotion | None = field(default_factory=SeatMotion)
    """Motion of the seat; None for the tight arm."""


def draw_tool_displacement(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw differential displacements of the tool (5.3, figure 5.6).

    Returns (2, N): displacement from the nominal tool point, m, world frame.

    Examples
    --------
    >>> draw_tool_displacement(MonteCarlo(), 10, np.random.default_rng(1)).shape
    (2, 10)
    """
    theta, d, _ = _pose(setting, count, rng)
    nominal = tool_position(setting.arm, setting.theta, 0.0)
    return tool_position(setting.arm, theta, d) - nominal[:, None]


def draw_tool_velocity(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw velocities of the tool (5.4, figure 5.8); parameters as `draw_tool_displacement`.

    Returns (2, N): velocity, m/s, world frame.

    Examples
    --------
    >>> draw_tool_velocity(MonteCarlo(seat=None), 10, np.random.default_rng(1)).shape
    (2, 10)
    """
    theta, d, v = _pose(setting, count, rng)
    return tool_velocity(setting.arm, theta, rng.normal(0.0, setting.rate_sd, theta.shape), d, v)


def draw_tool_acceleration(setting: MonteCarlo, count: int, rng: np.random.Generator) -> Array:
    """Draw accelerations of the tool (5.6); parameters as `draw_tool_displacement`.

    Returns (2, N): acceleration, m/s^2, world frame.

    Examples
    --------
    >>> draw_tool_acceleration(MonteCarlo(), 10, np.random.default_rng(1)).shape
    (2, 10)
    """
    theta, d, v = _pose(setting, count, rng)
    rate = rng.normal(0.0, setting.rate_sd, theta.shape)
    growth = rng.normal(0.0, setting.acceleration_sd, theta.shape)
    still = np.zeros_like(d)
    seat = setting.seat
    a = still if seat is None else draw_seat_acceleration(seat, d, v, rng)
    return tool_acceleration(setting.arm, theta, rate, growth, d, v, a)


def _pose(setting: MonteCarlo, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Joint angles (2, N), and displacement and velocity of the seat (N,)."""
    theta = np.asarray(setting.theta)[:, None] + rng.normal(0.0, setting.angle_sd, (2, count))
    if setting.seat is None:
        return theta, np.zeros(count), np.zeros(count)
    d = draw_displacement(setting.seat, count, rng)
    return theta, d, draw_seat_velocity(setting.seat, d, rng)
