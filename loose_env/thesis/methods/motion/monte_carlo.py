"""Monte Carlo kinematics of a loose arm: assumed motions in, distributions at the tool out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.thesis.methods.motion.loose_planar_arm import (
    LoosePlanarArm,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from loose_env.thesis.methods.motion.seat_motion import (
    SeatMotion,
    draw_displacement,
    draw_seat_acceleration,
    draw_seat_velocity,
    whole_count,
)
from loose_env.typing import Array

__all__ = [
    "MonteCarlo",
    "draw_tool_acceleration",
    "draw_tool_displacement",
    "draw_tool_velocity",
]


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

    def __post_init__(self) -> None:
        if len(self.theta) != 2 or not all(math.isfinite(angle) for angle in self.theta):
            raise InvalidSetting(f"theta is {self.theta}; a pose is two finite angles in rad")
        for name in ("angle_sd", "rate_sd", "acceleration_sd"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidSetting(f"{name} is {value}; it must be finite and not negative")


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
    n = whole_count(count)
    theta = np.asarray(setting.theta)[:, None] + rng.normal(0.0, setting.angle_sd, (2, n))
    if setting.seat is None:
        return theta, np.zeros(n), np.zeros(n)
    d = draw_displacement(setting.seat, n, rng)
    return theta, d, draw_seat_velocity(setting.seat, d, rng)
