"""Kinematics of the planar arm with two revolute joints and a loose seat in link 2 (thesis 5.1).

Angles are in radians and counter-clockwise; the tool is in the world frame. Arrays of joint
motions have shape (2, N), those of the seat (N,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.typing import Array


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
    """Unit vector of the slide in the world (2, N), for joint angles [rad] (2, N) or (2,).

    Examples
    --------
    >>> arm = LoosePlanarArm(beta=np.pi / 2)
    >>> looseness_direction(arm, [0.0, 0.0]).round(6).tolist()
    [0.0, 1.0]
    """
    turned = np.asarray(theta, dtype=float).sum(axis=0) + arm.beta
    return np.stack([np.cos(turned), np.sin(turned)])


def tool_position(arm: LoosePlanarArm, theta: ArrayLike, d: ArrayLike) -> Array:
    """Position of the tool (5.3); with the seat at zero that of the tight arm (6.1).

    ``theta`` (2, N) or (2,): joint angles, rad. ``d`` (N,) or (): displacement of the seat, m.
    Returns (2, N) or (2,): position in the world frame, m.

    Examples
    --------
    >>> arm = LoosePlanarArm(length1=1.0, length2=1.0, beta=0.0)
    >>> tool_position(arm, [0.0, np.pi / 2], 0.1).round(6).tolist()
    [1.0, 1.1]
    """
    q, slide = np.asarray(theta, dtype=float), np.asarray(d, dtype=float)
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
    q, rate = np.asarray(theta, dtype=float), np.asarray(theta_rate, dtype=float)
    slide, slide_rate = np.asarray(d, dtype=float), np.asarray(d_rate, dtype=float)
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
    q, rate = np.asarray(theta, dtype=float), np.asarray(theta_rate, dtype=float)
    growth = np.asarray(theta_acceleration, dtype=float)
    slide, slide_rate = np.asarray(d, dtype=float), np.asarray(d_rate, dtype=float)
    slide_growth = np.asarray(d_acceleration, dtype=float)
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
    q = np.asarray(theta, dtype=float)
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
