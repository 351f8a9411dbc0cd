"""Link lengths and joint offsets of a planar arm from tool velocities (thesis 3.3.1).

One joint after the other is turned; each time the tool's velocity tells where that joint lies.
The links are the differences between neighbouring joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.kinematics import JointKind
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanarParameters:
    """Geometry of a planar serial arm, as the recursion finds it."""

    lengths: Array
    """Length of each link, base first [m] (n,); the last one ends at the tool."""
    directions: Array
    """Direction of each link in the frame of the velocities [rad] (n,)."""
    offsets: Array
    """Offsets of joints 2 to n: angle between the links less the joint's reading [rad] (n-1,).

    In (-pi, pi]. Joint 1's offset and place need a base frame and stay unknown.
    """


def velocity_components(jacobian: ArrayLike, rates: ArrayLike) -> Array:
    """Tool velocity from each joint alone (3.51, 3.52).

    ``jacobian`` (d, n): rows of the Jacobian. ``rates`` (n,): joint velocities. Returns (n, d):
    component of joint i in row i.

    Examples
    --------
    >>> velocity_components([[0.0, 0.0], [0.6, 0.3]], [1.0, 2.0])
    array([[0. , 0.6],
           [0. , 0.6]])
    """
    j, q = np.asarray(jacobian, dtype=float), np.asarray(rates, dtype=float)
    return np.asarray((j * q).T)


def rotation_arms(velocities: ArrayLike, rates: ArrayLike) -> Array:
    """Vector from each revolute joint to the tool (3.58-3.60), all axes along z (3.56).

    ``velocities`` (n, 2): tool velocity while joint i alone turns [m/s], all in one frame.
    ``rates`` (n,): velocity of that joint [rad/s]. Returns (n, 2): vectors [m].

    Examples
    --------
    >>> rotation_arms([[0.0, 0.5]], [2.0])
    array([[ 0.25, -0.  ]])
    """
    v, w = np.asarray(velocities, dtype=float), np.asarray(rates, dtype=float)
    if (w == 0).any():
        raise InvalidData(
            f"joint {int(np.flatnonzero(w == 0)[0]) + 1} has a rate of zero: turn every joint"
        )
    return np.asarray(np.column_stack([v[:, 1], -v[:, 0]]) / w[:, None])


def identify_planar(
    velocities: ArrayLike,
    rates: ArrayLike,
    angles: ArrayLike,
    *,
    kinds: Sequence[JointKind] | None = None,
) -> PlanarParameters:
    """Find lengths and offsets from the tool to the base (3.49, 3.50, 3.63, 3.64, 3.66, 3.67).

    The joint angle is taken as the angle between link i and link i-1. The thesis prints
    (3.65) instead, the angle between link i and the vector from its end to the tool, which
    changes with the joints beyond; see `distended_angles`.

    ``velocities`` (n, 2): tool velocity while joint i alone turns [m/s], in the world's or the
    tool's frame. ``rates`` (n,): velocity of that joint [rad/s]. ``angles`` (n,): joint readings in
    the pose [rad].

    Examples
    --------
    >>> found = identify_planar([[0.0, 0.7], [0.0, 0.3]], [1.0, 1.0], [0.0, 0.1])
    >>> found.lengths, found.offsets
    (array([0.4, 0.3]), array([-0.1]))
    """
    arms = rotation_arms(velocities, rates)
    q = np.asarray(angles, dtype=float)
    if kinds is not None:
        sliding = [i for i, kind in enumerate(kinds, start=1) if kind == "prismatic"]
        if sliding:
            raise InvalidData(
                f"joint {sliding[0]} is prismatic: its velocity is a free vector, the same "
                "wherever the slide lies, so it has no rotation arm and the recursion ends. "
                "Take its direction from slide_direction and find its link from several poses"
            )
    links = arms - np.vstack([arms[1:], np.zeros((1, 2))])
    # The law of cosines (3.63) is the norm of this difference.
    lengths = np.linalg.norm(links, axis=1)
    if (lengths <= 1e-12 * np.linalg.norm(arms, axis=1).max()).any():
        raise InvalidData(
            f"link {int(np.argmin(lengths)) + 1} has no length, so it has no direction: two "
            "joints, or the last joint and the tool, lie on one point"
        )
    directions = np.arctan2(links[:, 1], links[:, 0])
    return PlanarParameters(
        lengths=lengths, directions=directions, offsets=_wrap(np.diff(directions) - q[1:])
    )


def distended_angles(velocities: ArrayLike, rates: ArrayLike) -> Array:
    """Angles of links 1 to n-1 as printed in (3.65): to the arm R of the next joint (3.61).

    Only the last of them is a joint angle, that of joint n; the others turn with every joint
    beyond.

    Returns (n-1,): angles in (-pi, pi] [rad].

    Examples
    --------
    >>> distended_angles([[0.0, 0.7], [0.0, 0.3]], [1.0, 1.0])
    array([0.])
    """
    arms = rotation_arms(velocities, rates)
    links = arms[:-1] - arms[1:]
    to_tool = np.arctan2(arms[1:, 1], arms[1:, 0])
    return _wrap(to_tool - np.arctan2(links[:, 1], links[:, 0]))


def parameter_deviations(
    velocities: ArrayLike, rates: ArrayLike, noise: float
) -> tuple[Array, Array]:
    """Propagate white velocity noise to lengths and offsets, to first order.

    ``velocities``, ``rates`` (n, 2), (n,): as for `identify_planar`. ``noise``: standard deviation
    of every velocity component [m/s], independent of each other. Returns ``lengths`` (n,): standard
    deviations of the lengths [m]; ``offsets`` (n-1,): standard deviations of the offsets [rad].

    Examples
    --------
    >>> lengths, _ = parameter_deviations([[0.0, 0.7], [0.0, 0.3]], [1.0, 1.0], 0.003)
    >>> float(lengths[1])
    0.003
    """
    arms = rotation_arms(velocities, rates)
    n = len(arms)
    place = noise / np.abs(np.asarray(rates, dtype=float))  # sd of a joint's place [m]
    links = arms - np.vstack([arms[1:], np.zeros((1, 2))])
    size = np.linalg.norm(links, axis=1)
    lengths = np.sqrt(place**2 + np.append(place[1:], 0.0) ** 2)
    across = np.column_stack([-links[:, 1], links[:, 0]]) / size[:, None] ** 2
    gradient = np.zeros((n, n, 2))  # of each link's direction in each joint's place
    gradient[np.arange(n), np.arange(n)] = across
    gradient[np.arange(n - 1), np.arange(1, n)] = -across[:-1]
    offset = np.diff(gradient, axis=0)
    return lengths, np.sqrt(np.einsum("kja,j->k", offset**2, place**2))


def slide_direction(velocity: ArrayLike) -> Array:
    """Direction of a slide from the tool velocity it causes (3.55, 3.57, 3.68, 3.69).

    The direction is all there is: its sign is that of an unknown rate.

    ``velocity`` (2,) or (3,): velocity of the tool [m/s].

    Examples
    --------
    >>> slide_direction([0.0, 0.02])
    array([0., 1.])
    """
    v = np.asarray(velocity, dtype=float)
    return np.asarray(v / np.linalg.norm(v))


def _wrap(angle: Array) -> Array:
    return np.asarray(np.pi - (np.pi - angle) % (2 * np.pi))
