"""Kinematics of the planar arm with two revolute joints and a loose seat in link 2 (thesis 5.1).

Angles are in radians and counter-clockwise; the tool is in the world frame. Arrays of joint
motions have shape (2, N), those of the seat (N,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = [
    "LoosePlanarArm",
    "link_rate",
    "looseness_direction",
    "nominal_jacobian",
    "tool_acceleration",
    "tool_position",
    "tool_velocity",
]


@dataclass(frozen=True, kw_only=True)
class LoosePlanarArm:
    """Two links in a plane; a slide sits at the proximal end of link 2."""

    length1: float = 0.40
    """Length of link 1 [m]."""
    length2: float = 0.40
    """Length of link 2 [m]."""
    beta: float = math.radians(60.0)
    """Angle of the slide from the x axis of link 2 [rad]."""

    def __post_init__(self) -> None:
        for name in ("length1", "length2"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidSetting(f"{name} is {value} m; it must be finite and above zero")
        if not math.isfinite(self.beta):
            raise InvalidSetting(f"beta is {self.beta} rad; it must be finite")


def looseness_direction(arm: LoosePlanarArm, theta: ArrayLike) -> Array:
    """Unit vector of the slide in the world (2, N), for joint angles [rad] (2, N) or (2,).

    Examples
    --------
    >>> arm = LoosePlanarArm(beta=np.pi / 2)
    >>> looseness_direction(arm, [0.0, 0.0]).round(6).tolist()
    [0.0, 1.0]
    """
    turned = _pair(theta, "theta").sum(axis=0) + arm.beta
    return np.stack([np.cos(turned), np.sin(turned)])


def tool_position(arm: LoosePlanarArm, theta: ArrayLike, d: ArrayLike) -> Array:
    """Position of the tool (5.3).

    ``theta`` (2, N) or (2,): joint angles, rad. ``d`` (N,) or (): displacement of the seat, m.
    Returns (2, N) or (2,): position in the world frame, m.

    Examples
    --------
    >>> arm = LoosePlanarArm(length1=1.0, length2=1.0, beta=0.0)
    >>> tool_position(arm, [0.0, np.pi / 2], 0.1).round(6).tolist()
    [1.0, 1.1]
    """
    q, slide = _pair(theta, "theta"), _seat(d, "d")
    along1, along2, out = _axes(arm, q)
    position: Array = arm.length1 * along1 + slide * out + arm.length2 * along2
    return position


def tool_velocity(
    arm: LoosePlanarArm, theta: ArrayLike, theta_rate: ArrayLike, d: ArrayLike, d_rate: ArrayLike
) -> Array:
    """Velocity of the tool (5.4).

    ``theta``, ``theta_rate`` (2, N) or (2,): joint angles [rad] and rates [rad/s]. ``d``,
    ``d_rate`` (N,) or (): displacement [m] and rate [m/s] of the seat. Returns (2, N) or (2,):
    velocity in the world frame, m/s.

    Examples
    --------
    >>> arm = LoosePlanarArm(length1=1.0, length2=1.0, beta=0.0)
    >>> tool_velocity(arm, [0.0, 0.0], [1.0, 0.0], 0.0, 0.5).round(6).tolist()
    [0.5, 2.0]
    """
    q, rate = _pair(theta, "theta"), _pair(theta_rate, "theta_rate")
    slide, slide_rate = _seat(d, "d"), _seat(d_rate, "d_rate")
    along1, along2, out = _axes(arm, q)
    turn = link_rate(rate)
    velocity: Array = (
        rate[0] * arm.length1 * _left(along1)
        + slide_rate * out
        + turn * (slide * _left(out) + arm.length2 * _left(along2))
    )
    return velocity


def link_rate(theta_rate: ArrayLike) -> Array:
    """Rate of turn of link 2 and of the part beyond its loose seat (5.5).

    A slide turns nothing, so both turn alike.

    ``theta_rate`` (2, N) or (2,): joint rates, rad/s. Returns (N,) or (): rate of turn about the
    world's z axis, rad/s.

    Examples
    --------
    >>> float(link_rate([0.5, -0.2]))
    0.3
    """
    return np.asarray(_pair(theta_rate, "theta_rate").sum(axis=0))


def tool_acceleration(
    arm: LoosePlanarArm,
    theta: ArrayLike,
    theta_rate: ArrayLike,
    theta_acceleration: ArrayLike,
    d: ArrayLike,
    d_rate: ArrayLike,
    d_acceleration: ArrayLike,
) -> Array:
    """Acceleration of the tool, with centripetal and Coriolis terms (5.6).

    ``theta``, ``theta_rate``, ``theta_acceleration`` (2, N) or (2,): joint angles [rad], rates
    [rad/s] and accelerations [rad/s^2]. ``d``, ``d_rate``, ``d_acceleration`` (N,) or ():
    displacement [m], rate [m/s] and acceleration [m/s^2] of the seat. Returns (2, N) or (2,):
    acceleration in the world frame, m/s^2.

    Examples
    --------
    The seat moves at 0.5 m/s along a link that turns at 1 rad/s: 1 m/s^2 across it.

    >>> arm = LoosePlanarArm(length1=1.0, length2=1.0, beta=0.0)
    >>> still = [0.0, 0.0]
    >>> tool_acceleration(arm, still, [0.0, 1.0], still, 0.0, 0.5, 0.0).round(6).tolist()
    [-1.0, 1.0]
    """
    q, rate = _pair(theta, "theta"), _pair(theta_rate, "theta_rate")
    growth = _pair(theta_acceleration, "theta_acceleration")
    slide, slide_rate = _seat(d, "d"), _seat(d_rate, "d_rate")
    slide_growth = _seat(d_acceleration, "d_acceleration")
    along1, along2, out = _axes(arm, q)
    turn, turn_growth = link_rate(rate), link_rate(growth)
    lever = slide * out + arm.length2 * along2
    acceleration: Array = (
        arm.length1 * (growth[0] * _left(along1) - rate[0] ** 2 * along1)
        + turn_growth * _left(lever)
        - turn**2 * lever
        + slide_growth * out
        + 2.0 * slide_rate * turn * _left(out)
    )
    return acceleration


def nominal_jacobian(arm: LoosePlanarArm, theta: ArrayLike) -> Array:
    """Jacobian of the tight arm, which takes joint rates to the tool's velocity (3.71).

    ``theta`` (2,): joint angles, rad. Returns (2, 2): metres per radian, world frame.

    Examples
    --------
    >>> nominal_jacobian(LoosePlanarArm(), [0.0, 0.0]).round(6).tolist()
    [[-0.0, -0.0], [0.8, 0.4]]
    """
    q = _pair(theta, "theta")
    if q.ndim != 1:
        raise InvalidData(f"theta has shape {q.shape}; one pose is (2,)")
    along1, along2, _ = _axes(arm, q)
    second = arm.length2 * _left(along2)
    return np.column_stack([arm.length1 * _left(along1) + second, second])


def _axes(arm: LoosePlanarArm, q: Array) -> tuple[Array, Array, Array]:
    """Unit vectors along link 1, link 2 and the slide."""
    turned = q.sum(axis=0)
    return (
        np.stack([np.cos(q[0]), np.sin(q[0])]),
        np.stack([np.cos(turned), np.sin(turned)]),
        looseness_direction(arm, q),
    )


def _left(vector: Array) -> Array:
    """Turn vectors by a quarter, counter-clockwise."""
    return np.stack([-vector[1], vector[0]])


def _pair(values: ArrayLike, name: str) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.ndim not in (1, 2) or found.shape[0] != 2:
        raise InvalidData(f"{name} has shape {found.shape}; two joints are (2,) or (2, N)")
    if not np.isfinite(found).all():
        raise InvalidData(f"{name} holds NaN or infinite values; every value must be finite")
    return found


def _seat(values: ArrayLike, name: str) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.ndim > 1:
        raise InvalidData(f"{name} has shape {found.shape}; one seat is () or (N,)")
    if not np.isfinite(found).all():
        raise InvalidData(f"{name} holds NaN or infinite values; every value must be finite")
    return found
